"""What decides the result of a training of a map network; needs no torch."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from coopmap_env.core.settings import (
    Bounds,
    NonNegative,
    NonNegativeInt,
    Positive,
    PositiveInt,
    Settings,
)

ChannelWidth = Annotated[int, Bounds(at_least=1, at_most=1024)]


@dataclass(frozen=True)
class MapNetworkSettings(Settings):
    """Size of a `MapNetwork`."""

    dimension: Literal[2, 3] = 2
    """Of the maps."""
    widths: tuple[ChannelWidth, ChannelWidth, ChannelWidth] = (16, 40, 56)
    """Channels of the three levels."""
    stride: Annotated[int, Bounds(at_least=1, at_most=16)] = 2
    """Cells along the side of a pixel of the first level."""


FIELD_NETWORK = MapNetworkSettings(dimension=3, widths=(12, 20, 32), stride=4)
"""Blocks of 0.4 m are sharp enough: `docs/what_was_tried.md`."""
PLAYED_POLICIES = {
    "planar": (
        "lookahead:horizon=1",
        "lookahead:horizon=1+search=30",
        "lookahead:horizon=1",
        "rating_function:search=100",
    ),
    "field": ("surface", "surface:search=10", "surface", "rating_function:search=30"),
}
"""Policies that make the maps to learn from, in turns: good ones, as the network serves good ones,
and others, so that it has seen what good ones leave out. By the kind of environment."""


@dataclass(frozen=True, kw_only=True)
class MapTrainingConfig(Settings):
    """A training of a map network, in segments as `coopmap_agents.config` describes them."""

    env_name: Literal["planar", "field"] = "planar"
    """Environment of the worlds."""
    families: tuple[str, ...] = ("crowded", "long", "motion-budget", "narrow")
    """Families on whose training worlds it learns."""
    scenes: tuple[str, ...] = ("obstacles",)
    """Scenes, with the default team and budget, on whose training worlds it learns too."""
    seed: NonNegativeInt = 0
    """Seed of the worlds, the weights and the order of the examples."""
    episodes: PositiveInt = 250
    """Training episodes of each family and scene."""
    validation_episodes: PositiveInt = 30
    """Validation episodes of each."""
    maps_per_episode: PositiveInt = 8
    """Maps that are kept of an episode. All stay in memory: 0.24 MB each with 200 x 200 cells,
    3.9 MB with 128 x 128 x 40."""
    total_steps: PositiveInt = 4_000
    """Gradient steps; each is of one family or scene, in turns."""
    segment_steps: PositiveInt = 500
    """Gradient steps from one checkpoint to the next."""
    batch_size: PositiveInt = 8
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
    network: MapNetworkSettings = field(default_factory=MapNetworkSettings)
    """Size of the network."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.families and not self.scenes:
            raise ValueError("a map network needs families or scenes to learn from, got none")
        needed = {"planar": 2, "field": 3}[self.env_name]
        if self.network.dimension != needed:
            raise ValueError(
                f"network.dimension must be {needed} for {self.env_name} maps, got "
                f"{self.network.dimension}"
            )

    @classmethod
    def of_field(cls, **changes: Any) -> MapTrainingConfig:
        """The training of the network of field maps that ships with coopmap, with some changes."""
        usual: dict[str, Any] = {
            "env_name": "field",
            "families": ("occluded",),
            "scenes": ("worksite", "clutter", "rubble"),
            "episodes": 60,
            "validation_episodes": 8,
            "maps_per_episode": 4,
            "total_steps": 1_000,
            "segment_steps": 100,
            "batch_size": 4,
            "network": FIELD_NETWORK,
        }
        return cls(**{**usual, **changes})

    @property
    def worlds(self) -> tuple[str, ...]:
        """Names of all families and scenes."""
        return self.families + self.scenes
