"""Features extractors: what the networks see of one robot's observation.

`RobotFeatures` takes all of it, for "pose" mode; `SituationFeatures` all but the candidates, which
`coopmap_agents.candidate_scorer` sees one by one.

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
    time here, not the simulation.

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


class SituationFeatures(BaseFeaturesExtractor):
    """What is around a robot, whichever candidates are on offer and however teammates are ordered.

    The map and the robot's own state as in `RobotFeatures`; each teammate goes through one shared
    layer, and the mean and the maximum over them count. So neither their order nor, as long as
    there is one, their number is built in.

    Parameters
    ----------
    observation_space : gymnasium.spaces.Dict
        In "candidates" mode; see `coopmap_env.envs.planar.observations` and those of the field.
    image_features : int
        Length of the map's feature vector.
    teammate_features : int
        Width of the layer for teammates.
    """

    def __init__(
        self,
        observation_space: spaces.Dict,
        image_features: int = 128,
        teammate_features: int = 16,
    ) -> None:
        apart = ("candidates", "action_mask", "teammates", "located")
        own = {k: box for k, box in observation_space.spaces.items() if k not in apart}
        tells_located = int("located" in observation_space.spaces)
        robot = RobotFeatures(spaces.Dict(own), image_features) if own else None
        n = (robot.features_dim if robot else 0) + tells_located
        if "teammates" in observation_space.spaces:
            n += 2 * teammate_features
        super().__init__(observation_space, n)
        self.robot = robot
        self.teammate: nn.Module | None = None
        if "teammates" in observation_space.spaces:
            shape = observation_space["teammates"].shape
            assert shape is not None
            self.teammate = nn.Sequential(
                nn.Linear(shape[-1] + tells_located, teammate_features), nn.ReLU()
            )

    def forward(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        """Features (n, features_dim) of n observations."""
        parts = [self.robot(observations)] if self.robot else []
        located = observations.get("located")  # the own flag, then one for each teammate
        if located is not None:
            parts.append(located[:, :1])
        if self.teammate is not None:
            teammates = observations["teammates"]
            if located is not None:
                teammates = torch.cat([teammates, located[:, 1:, None]], dim=-1)
            each = self.teammate(teammates)
            parts += [each.mean(dim=1), each.amax(dim=1)]
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
