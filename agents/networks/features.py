"""Features extractor: the input of the networks, from the observation of one robot.

Stable-Baselines3 converts all entries to float32; the map, from 0 to 255, is scaled here.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.preprocessing import get_flattened_obs_dim, is_image_space
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import nn

from coopmap_agents.architecture import IMAGE_CONVOLUTIONS, TEAMMATE_FEATURES, n_image_values
from coopmap_agents.observations import SPECIAL_KEYS


def as_tensors(
    space: spaces.Space[Any], observation: Mapping[str, NDArray[Any]], device: torch.device
) -> tuple[dict[str, torch.Tensor], bool]:
    """Tensors of one observation, or of n stacked ones; and whether they were stacked.

    Stable-Baselines3 requires the shapes of training. Here the number of candidates and teammates
    may differ, the state may be missing, and entries that are not of the space are left out.
    """
    assert isinstance(space, spaces.Dict)
    known = {key: values for key, values in observation.items() if key in space.spaces}
    key, values = next(iter(known.items()))
    rows = np.ndim(values) == len(space[key].shape or ()) + 1
    tensors = {
        key: torch.as_tensor(np.array(values if rows else values[None]), device=device)
        for key, values in known.items()
    }
    return tensors, rows


class ObservationFeatures(BaseFeaturesExtractor):
    """Features of an observation, without the candidates; invariant to the order of teammates.

    The map goes through a small convolutional network; the robot's own vectors are used as they
    are. Each teammate goes through one shared layer, and the features are the mean and the maximum
    over teammates, whose number may differ from training; they are zeros without teammates.

    The state of the team, where it is observed, is an input of the critic only: its features are
    the last `state_dim`. For acting it may be missing.

    Parameters
    ----------
    observation_space : gymnasium.spaces.Dict
        Image entries (channels first) and any others; see the module `observations` of
        `coopmap_env.envs.planar` and of `coopmap_env.envs.field`.
    image_features : int
        Length of the map's feature vector, and of the state's.
    teammate_features : int
        Width of the layer for teammates.
    """

    def __init__(
        self,
        observation_space: spaces.Dict,
        image_features: int = 64,
        teammate_features: int = TEAMMATE_FEATURES,
    ) -> None:
        parts = observation_space.spaces
        images = {k: box for k, box in parts.items() if is_image_space(box)}
        flat = {k: box for k, box in parts.items() if k not in images and k not in SPECIAL_KEYS}
        include_located = int("located" in parts)
        self.state_dim = image_features if "state" in parts else 0
        self.widths: dict[str, int] = {
            **dict.fromkeys(images, image_features),
            **{key: get_flattened_obs_dim(space) for key, space in flat.items()},
            **({"located": 1} if include_located else {}),
            **({"teammates": 2 * teammate_features} if "teammates" in parts else {}),
        }
        """How many features each entry has, in their order; without the state."""
        self.actor_dim = sum(self.widths.values())
        super().__init__(observation_space, self.actor_dim + self.state_dim)
        self.robot = nn.ModuleDict(
            {
                **{key: _image_encoder(_shape(box), image_features) for key, box in images.items()},
                **{key: nn.Flatten() for key in flat},
            }
        )
        self.teammate: nn.Module | None = None
        if "teammates" in parts:
            n_inputs = _shape(parts["teammates"])[-1] + include_located
            self.teammate = nn.Sequential(nn.Linear(n_inputs, teammate_features), nn.ReLU())
            self._n_teammate_features = 2 * teammate_features
        self.state: nn.Module | None = None
        if "state" in parts:
            self.state = nn.Sequential(
                nn.Linear(_shape(parts["state"])[0], image_features), nn.ReLU()
            )

    def forward(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        """Features (n, features_dim) of n observations, in any order of the entries."""
        parts = [part(observations[key]) for key, part in self.robot.items()]
        if "located" in observations:  # the flag of the robot, then one for each teammate
            parts.append(observations["located"][:, :1])
        if self.teammate is not None:
            parts.append(self._teammate_features(observations, len(parts[0])))
        if self.state is not None:
            state = observations.get("state")
            zeros = parts[0].new_zeros(len(parts[0]), self.state_dim)
            parts.append(zeros if state is None else self.state(state))
        return torch.cat(parts, dim=1)

    def _teammate_features(self, observations: dict[str, torch.Tensor], n: int) -> torch.Tensor:
        """Mean and maximum over teammates, shape (n, 2 teammate_features)."""
        assert self.teammate is not None
        teammates = observations.get("teammates")
        if teammates is None:
            return torch.zeros(n, self._n_teammate_features, device=next(self.parameters()).device)
        if "located" in observations:
            teammates = torch.cat([teammates, observations["located"][:, 1:, None]], dim=-1)
        each = self.teammate(teammates)
        return torch.cat([each.mean(dim=1), each.amax(dim=1)], dim=1)


def _shape(space: spaces.Space[Any]) -> tuple[int, ...]:
    assert space.shape is not None
    return space.shape


class ChannelsLast(nn.Module):
    """The same images in another memory layout, in which CPUs convolve twice as fast."""

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        """Images (n, channels, height, width), unchanged in value."""
        # `vmap` has no rule for `contiguous(memory_format=torch.channels_last)`
        return images.permute(0, 2, 3, 1).contiguous().permute(0, 3, 1, 2)


class ByteConv2d(nn.Conv2d):
    """A convolution of images of bytes, as if these were scaled from 0 ... 255 to 0 ... 1.

    The weights are scaled instead: a copy of all images would take as long as the convolution.
    """

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        """The convolution of float32 images (n, channels, height, width) from 0 to 255."""
        return self._conv_forward(images, self.weight / 255, self.bias)


def _image_encoder(shape: tuple[int, ...], n_features: int) -> nn.Sequential:
    """Two padded convolutions, for images of any size."""
    channels, height, width = shape
    first, second = IMAGE_CONVOLUTIONS
    return nn.Sequential(
        ChannelsLast(),
        ByteConv2d(channels, *first, padding=first.padding),
        nn.ReLU(),
        nn.Conv2d(first.channels, *second, padding=second.padding),
        nn.ReLU(),
        nn.Flatten(),
        nn.Linear(n_image_values(height, width), n_features),
        nn.ReLU(),
    )
