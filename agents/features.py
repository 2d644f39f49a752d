"""Features extractor: what the networks see of one robot's observation.

Stable-Baselines3 hands over the map with its 0 ... 255 scaled to 0 ... 1, and all else as float32.
"""

from __future__ import annotations

from gymnasium import spaces

from . import NEEDS_RL

try:
    import torch
    from stable_baselines3.common.preprocessing import get_flattened_obs_dim, is_image_space
    from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
    from torch import nn
except ImportError as error:
    raise ImportError(NEEDS_RL) from error


class RobotFeatures(BaseFeaturesExtractor):
    """A small convolutional network for the map; everything else is appended flat.

    Two convolutions with a margin, so that any `view_cells` will do: Stable-Baselines3's NatureCNN
    fails below 36 pixels. They take half the time of three finer ones, and learning is what takes
    time here, not the simulation. Candidates are flat too: the network has to learn anew for each
    index what a good candidate looks like.

    Parameters
    ----------
    observation_space : gymnasium.spaces.Dict
        Image entries (channels first) and any others; see `coopmap_env.envs.planar.observations`.
    image_features : int
        Length of the map's feature vector.
    """

    def __init__(self, observation_space: spaces.Dict, image_features: int) -> None:
        images = {k: box for k, box in observation_space.spaces.items() if is_image_space(box)}
        others = {k: space for k, space in observation_space.spaces.items() if k not in images}
        n_flat = sum(get_flattened_obs_dim(space) for space in others.values())
        super().__init__(observation_space, image_features * len(images) + n_flat)
        self.parts = nn.ModuleDict(
            {
                **{key: _image_network(box.shape, image_features) for key, box in images.items()},
                **{key: nn.Flatten() for key in others},
            }
        )

    def forward(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        """Features (n, features_dim) of n observations, whatever the order of their entries."""
        parts = [part(observations[key]) for key, part in self.parts.items()]
        return torch.cat(parts, dim=1)


def _image_network(shape: tuple[int, ...] | None, n_features: int) -> nn.Sequential:
    assert shape is not None
    channels, height, width = shape
    for stride in (4, 2):  # the convolutions below divide a side by this, rounded up
        height, width = -(-height // stride), -(-width // stride)
    return nn.Sequential(
        nn.Conv2d(channels, 16, kernel_size=5, stride=4, padding=2),
        nn.ReLU(),
        nn.Conv2d(16, 32, kernel_size=3, stride=2, padding=1),
        nn.ReLU(),
        nn.Flatten(),
        nn.Linear(32 * height * width, n_features),
        nn.ReLU(),
    )
