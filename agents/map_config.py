"""What decides the result of a training of a map network; needs no torch."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Annotated, Any, Literal

from coopmap_env.core.settings import (
    Bounds,
    NonNegative,
    NonNegativeInt,
    Positive,
    PositiveInt,
    Settings,
    checked_value,
)

EnvName = Literal["planar", "field"]
ChannelWidth = Annotated[int, Bounds(at_least=1, at_most=1024)]
Widths = tuple[ChannelWidth, ChannelWidth, ChannelWidth]
Stride = Annotated[int, Bounds(at_least=1, at_most=16)]


@dataclass(frozen=True)
class MapNetworkOptions(Settings):
    """Size of a `MapNetwork`; None stands for that of the network that ships with coopmap."""

    widths: Widths | None = None
    """Channels of the three levels."""
    stride: Stride | None = None
    """Cells along the side of a pixel of the first level."""


@dataclass(frozen=True)
class MapNetworkSettings(MapNetworkOptions):
    """Size of a `MapNetwork`."""

    widths: Widths = (16, 40, 56)
    stride: Stride = 2
    dimension: Literal[2, 3] = 2
    """Of the maps."""


@dataclass(frozen=True)
class UsualMapTraining:
    """The training of the network that ships with coopmap for the maps of an environment."""

    example_policies: tuple[str, ...]
    """Policies that make the maps to learn from, in turns: good ones, as the network serves good
    ones, and others, so that it has seen what good ones leave out."""
    network: MapNetworkSettings
    families: tuple[str, ...]
    scenes: tuple[str, ...]
    episodes: int
    validation_episodes: int
    maps_per_episode: int
    total_steps: int
    segment_steps: int
    batch_size: int


USUAL_TRAININGS: dict[str, UsualMapTraining] = {
    "planar": UsualMapTraining(
        example_policies=(
            "lookahead:horizon=1",
            "lookahead:horizon=1+search=30",
            "lookahead:horizon=1",
            "rating_function:search=100",
        ),
        network=MapNetworkSettings(),
        families=("crowded", "long", "motion-budget", "narrow"),
        scenes=("obstacles",),
        episodes=250,
        validation_episodes=30,
        maps_per_episode=8,
        total_steps=4_000,
        segment_steps=500,
        batch_size=8,
    ),
    "field": UsualMapTraining(
        example_policies=("surface", "surface:search=10", "surface", "rating_function:search=30"),
        # blocks of 0.4 m are sharp enough: `docs/what_was_tried.md`
        network=MapNetworkSettings(widths=(12, 20, 32), stride=4, dimension=3),
        families=("occluded",),
        scenes=("worksite", "clutter", "rubble"),
        episodes=60,
        validation_episodes=8,
        maps_per_episode=4,
        total_steps=1_000,
        segment_steps=100,
        batch_size=4,
    ),
}
"""By the name of the environment, which is also that of the network's files."""


@dataclass(frozen=True, kw_only=True)
class MapTrainingOptions(Settings):
    """Options of a training of a map network, in segments as `coopmap_agents.config` describes.

    None stands for what made the network that ships with coopmap for the environment.
    """

    env_name: EnvName = "planar"
    """Environment of the worlds."""
    families: tuple[str, ...] | None = None
    """Families on whose training worlds it learns."""
    scenes: tuple[str, ...] | None = None
    """Scenes, with the default team and budget, on whose training worlds it learns too."""
    seed: NonNegativeInt = 0
    """Seed of the worlds, the weights and the order of the examples."""
    episodes: PositiveInt | None = None
    """Training episodes of each family and scene."""
    validation_episodes: PositiveInt | None = None
    """Validation episodes of each."""
    maps_per_episode: PositiveInt | None = None
    """Maps that are kept of an episode. All stay in memory: 0.24 MB each with 200 x 200 cells,
    3.9 MB with 128 x 128 x 40."""
    total_steps: PositiveInt | None = None
    """Gradient steps; each is of one family or scene, in turns."""
    segment_steps: PositiveInt | None = None
    """Gradient steps from one checkpoint to the next."""
    batch_size: PositiveInt | None = None
    """Maps of a gradient step."""
    learning_rate: Positive = 2e-3
    """Largest learning rate of AdamW. It rises over the first `warmup_steps` and falls, linearly,
    to zero at the end."""
    warmup_steps: PositiveInt = 50
    weight_decay: NonNegative = 1e-4
    max_gradient_norm: Positive = 1.0
    """Gradients with a larger norm are clipped to it."""
    shift: Annotated[int, Bounds(at_least=0, at_most=64)] = 8
    """Maps are cut by up to this many cells on two sides. That shifts the network's blocks."""
    network: MapNetworkOptions = MapNetworkOptions()
    """Size of the network."""


@dataclass(frozen=True, kw_only=True)
class MapTrainingConfig(MapTrainingOptions):
    """Everything that decides the result of a training of a map network.

    Options that are left out, or None, are those of the environment's usual training.
    """

    families: tuple[str, ...]
    scenes: tuple[str, ...]
    episodes: PositiveInt
    validation_episodes: PositiveInt
    maps_per_episode: PositiveInt
    total_steps: PositiveInt
    segment_steps: PositiveInt
    batch_size: PositiveInt
    network: MapNetworkSettings

    def __post_init__(self) -> None:
        self._fill_in(
            USUAL_TRAININGS[checked_value("MapTrainingConfig.env_name", self.env_name, EnvName)]
        )
        super().__post_init__()
        if not self.families and not self.scenes:
            raise ValueError("MapTrainingConfig needs families or scenes to learn from, got none")
        needed = USUAL_TRAININGS[self.env_name].network.dimension
        if self.network.dimension != needed:
            raise ValueError(
                f"MapTrainingConfig.network.dimension must be {needed} for {self.env_name} maps, "
                f"got {self.network.dimension}"
            )

    def _fill_in(self, usual: UsualMapTraining) -> None:
        network: Any = self.network
        if type(network) is MapNetworkOptions:
            given = {k: v for k, v in vars(network).items() if v is not None}
            object.__setattr__(self, "network", replace(usual.network, **given))
        for option in fields(self):
            if getattr(self, option.name) is None and hasattr(usual, option.name):
                object.__setattr__(self, option.name, getattr(usual, option.name))

    @property
    def worlds(self) -> tuple[str, ...]:
        """Names of all families and scenes."""
        return self.families + self.scenes


def usual_environment(dimension: int) -> str:
    """Name of the environment whose maps have 2 or 3 dimensions."""
    return next(k for k, v in USUAL_TRAININGS.items() if v.network.dimension == dimension)
