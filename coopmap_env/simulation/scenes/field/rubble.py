"""Rubble: a dense pile of blocks that hide each other.

The target is the core of the pile: the blocks that were dropped first, around its middle. It is
what a search would look for, and mostly covered by the other blocks.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.elementary import exp_array, log, sin_cos_array
from coopmap_env.core.linear_algebra import length, product
from coopmap_env.core.settings import Positive, PositiveInt, Settings
from coopmap_env.geometry import Z_AXIS, random_rotation, rotation_about_axis
from coopmap_env.mapping import VoxelGrid
from coopmap_env.simulation.scenes.field._layout import SceneLayout
from coopmap_env.simulation.scenes.field._pile import Pile
from coopmap_env.simulation.scenes.field.base_poses import BasePlacement, sample_base_poses
from coopmap_env.simulation.scenes.field.solid import Solid, box_corners, solid_from_boxes
from coopmap_env.simulation.scenes.field.world import (
    BASE_CLEARANCE,
    FIELD_GRID,
    CountRange,
    FieldWorld,
    check_counts,
    check_field_grid,
    make_ground,
)

TARGET = "core"

_PLACEMENT = BasePlacement(min_distance=3.2)
_N_DROPS = 4
"""Places where a block may be dropped: it takes the lowest of them, as if it rolled there."""
_FLAT_FRACTION = 0.7
"""Fraction of blocks that lie nearly flat; the others have any orientation."""


@dataclass(frozen=True)
class Rubble(Settings):
    """Worlds of one pile of blocks."""

    grid: VoxelGrid = FIELD_GRID
    blocks: CountRange = (40, 90)
    """Fewest and most blocks drawn, the core included; those without room are left out."""
    core: PositiveInt = 12
    """Blocks of the core."""
    core_radius: Positive = 0.9
    """Metres from the middle within which the core's blocks are dropped."""
    radius: Positive = 2.5
    """Metres from the middle within which all blocks are dropped."""
    side_min: Positive = 0.2
    """Shortest side of a block in metres."""
    side_max: Positive = 1.0
    """Longest side of a block in metres."""
    height_max: Positive = 1.9
    """Metres above the ground that no block exceeds: the pile stays below a mast."""
    base_placement: BasePlacement = _PLACEMENT
    """Vehicles keep further away, so that blocks may lie on all sides of the core."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_field_grid(self.grid)
        check_counts(self, "blocks")
        if not self.core <= self.blocks[0]:
            raise ValueError(
                f"Rubble.core must be at most the fewest blocks, {self.blocks[0]}, "
                f"got {self.core!r}"
            )
        if not self.core_radius <= self.radius:
            raise ValueError(
                f"Rubble needs core_radius <= radius, got {self.core_radius!r}, {self.radius!r}"
            )
        if not self.side_min <= self.side_max:
            raise ValueError(
                f"Rubble needs side_min <= side_max, got {self.side_min!r}, {self.side_max!r}"
            )
        if not self.side_max * math.sqrt(3.0) <= self.height_max:
            raise ValueError(
                f"Rubble.height_max must be at least the diagonal of the largest block, "
                f"{self.side_max * math.sqrt(3.0):.2f} m, got {self.height_max!r}"
            )

    @property
    def name(self) -> str:
        """What the scene is called in reports."""
        return "rubble"

    def world(
        self, rng: np.random.Generator, n_robots: int, footprint: float = BASE_CLEARANCE
    ) -> FieldWorld:
        """Draw base poses, then drop blocks where they leave them room."""
        bases = sample_base_poses(rng, n_robots, self.base_placement, footprint, self.grid, ())
        pile = Pile(self.radius + self.side_max)
        core: list[Solid] = []
        empty_layout = SceneLayout(self.grid, bases, footprint, ())
        layout = SceneLayout(self.grid, bases, footprint, core)
        for k in range(rng.integers(self.blocks[0], self.blocks[1] + 1)):
            is_core = k < self.core
            size = self.side_min * exp_array(log(self.side_max / self.side_min) * rng.random(3))
            rotation = _random_orientation(rng)
            drop_points = self._drop_points(rng, self.core_radius if is_core else self.radius)
            disc_radius = 0.5 * length(product(np.abs(rotation[:2]), size))
            rests = [
                pile.find_rest(size, point, rotation)
                for point in drop_points
                if empty_layout.is_free(point, disc_radius)
            ]
            rest = min(rests, key=lambda rest: rest.top, default=None)
            if rest is None or rest.top > self.height_max:
                continue
            pile.add(len(core) + len(layout.solids), rest)
            solid = solid_from_boxes(
                f"core_{k}" if is_core else f"block_{k}",
                [box_corners(size, rest.center, rotation)],
                is_target=is_core,
            )
            if is_core:
                core.append(solid)
            else:
                layout.add(solid, max(rest.support - len(core), -1))
        solids = (make_ground(self.grid), *core, *layout.remove_occluders())
        return FieldWorld(self.name, solids, TARGET, self.grid, bases)

    def _drop_points(self, rng: np.random.Generator, max_distance: float) -> NDArray[np.float64]:
        """Draw points (n, 2) where a block may be dropped."""
        distances = max_distance * np.sqrt(rng.random(_N_DROPS))
        angles = rng.uniform(-math.pi, math.pi, _N_DROPS)
        return distances[:, None] * np.stack(sin_cos_array(angles)[::-1], axis=-1)


def _random_orientation(rng: np.random.Generator) -> NDArray[np.float64]:
    """Draw an orientation: within a few degrees of flat, or any."""
    if rng.random() >= _FLAT_FRACTION:
        return random_rotation(rng)
    axis = rotation_about_axis(Z_AXIS, rng.uniform(-math.pi, math.pi))[0]
    tilt = rotation_about_axis(axis, rng.normal(0.0, math.radians(8.0)))
    return product(tilt, rotation_about_axis(Z_AXIS, rng.uniform(-math.pi, math.pi)))
