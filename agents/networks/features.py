"""Features extractor: what the networks see of one robot's observation.

Stable-Baselines3 hands over the map with its 0 ... 255 scaled to 0 ... 1, and all else as float32.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from coopmap_agents import RL_EXTRA_HINT
from gymnasium import spaces
from numpy.typing import NDArray

try:
    import torch
    from stable_baselines3.common.preprocessing import get_flattened_obs_dim, is_image_space
    from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
    from torch import nn
except ImportError as error:
    raise ImportError(RL_EXTRA_HINT) from error

SPECIAL_KEYS = ("candidates", "action_mask", "teammates", "located", "state")
"""Entries of an observation that are not simply appended."""


def as_tensors(
    space: spaces.Space[Any], observation: Mapping[str, NDArray[Any]], device: torch.device
) -> tuple[dict[str, torch.Tensor], bool]:
    """One observation or n of them as tensors of n rows, and whether they came as rows.

    Stable-Baselines3 does so for the very shapes of training only; here, candidates and teammates
    may be of another number, and the state may be missing.
    """
    assert isinstance(space, spaces.Dict)
    key, values = next(iter(observation.items()))
    rows = np.ndim(values) == len(space[key].shape or ()) + 1
    tensors = {
        key: torch.as_tensor(np.array(values if rows else values[None]), device=device)
        for key, values in observation.items()
    }
    return tensors, rows


class ObservationFeatures(BaseFeaturesExtractor):
    """What is around a robot, whichever candidates are on offer and however teammates are ordered.

    A small convolutional network for the map, and the robot's own numbers as they are. Each
    teammate goes through one shared layer, and the mean and the maximum over them count: neither
    their order nor their number is built in. Without teammates these features are zeros.

    The state of the whole team, where it is observed, is for the critic alone: its features are the
    last `state_dim`. Whoever only acts need not observe it.

    Parameters
    ----------
    observation_space : gymnasium.spaces.Dict
        Image entries (channels first) and any others; see `coopmap_env.envs.planar.observations`
        and those of the field.
    image_features : int
        Length of the map's feature vector, and of the state's.
    teammate_features : int
        Width of the layer for teammates.
    """

    def __init__(
        self,
        observation_space: spaces.Dict,
        image_features: int = 64,
        teammate_features: int = 16,
    ) -> None:
        parts = observation_space.spaces
        images = {k: box for k, box in parts.items() if is_image_space(box)}
        flat = {k: box for k, box in parts.items() if k not in images and k not in SPECIAL_KEYS}
        include_located = int("located" in parts)
        self.state_dim = image_features if "state" in parts else 0
        self.actor_dim = image_features * len(images) + include_located
        self.actor_dim += sum(get_flattened_obs_dim(space) for space in flat.values())
        self.actor_dim += 2 * teammate_features if "teammates" in parts else 0
        super().__init__(observation_space, self.actor_dim + self.state_dim)
        self.robot = nn.ModuleDict(
            {
                **{key: _image_encoder(_shape(box), image_features) for key, box in images.items()},
                **{key: nn.Flatten() for key in flat},
            }
        )
        self.teammate: nn.Module | None = None
        if "teammates" in parts:
            told = _shape(parts["teammates"])[-1] + include_located
            self.teammate = nn.Sequential(nn.Linear(told, teammate_features), nn.ReLU())
            self._n_teammate_features = 2 * teammate_features
        self.state: nn.Module | None = None
        if "state" in parts:
            self.state = nn.Sequential(
                nn.Linear(_shape(parts["state"])[0], image_features), nn.ReLU()
            )

    def forward(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        """Features (n, features_dim) of n observations, whatever the order of their entries."""
        parts = [part(observations[key]) for key, part in self.robot.items()]
        if "located" in observations:  # the own flag, then one for each teammate
            parts.append(observations["located"][:, :1])
        if self.teammate is not None:
            parts.append(self._teammate_features(observations, len(parts[0])))
        if self.state is not None:
            told = observations.get("state")
            empty = parts[0].new_zeros(len(parts[0]), self.state_dim)
            parts.append(empty if told is None else self.state(told))
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
    """The same images in the order of memory in which CPUs convolve them twice as fast."""

    def forward(self, images: torch.Tensor) -> torch.Tensor:
        """Images (n, channels, height, width), as given."""
        return images.contiguous(memory_format=torch.channels_last)


def _image_encoder(shape: tuple[int, ...], n_features: int) -> nn.Sequential:
    """Two convolutions with a margin, so that any side will do.

    Stable-Baselines3's NatureCNN fails below 36 pixels; three finer ones take twice the time, and
    learning is what takes time here, not the simulation.
    """
    channels, height, width = shape
    for stride in (4, 2):  # the convolutions below divide a side by this, rounded up
        height, width = -(-height // stride), -(-width // stride)
    return nn.Sequential(
        ChannelsLast(),
        nn.Conv2d(channels, 16, kernel_size=5, stride=4, padding=2),
        nn.ReLU(),
        nn.Conv2d(16, 32, kernel_size=3, stride=2, padding=1),
        nn.ReLU(),
        nn.Flatten(),
        nn.Linear(32 * height * width, n_features),
        nn.ReLU(),
    )
