"""A worksite: a solar-panel structure of known geometry, with rocks and crates around it."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.linear_algebra import length, product
from coopmap_env.core.settings import Settings, UnitInterval
from coopmap_env.geometry import Z_AXIS, random_rotation, rotation_about_axis
from coopmap_env.mapping import VoxelGrid
from coopmap_env.simulation.scenes.field._layout import SceneLayout
from coopmap_env.simulation.scenes.field.base_poses import (
    DEFAULT_PLACEMENT,
    BasePlacement,
    sample_base_poses,
)
from coopmap_env.simulation.scenes.field.solid import (
    Solid,
    box_corners,
    solid_from_boxes,
    solid_from_hull,
)
from coopmap_env.simulation.scenes.field.world import (
    BASE_CLEARANCE,
    FIELD_GRID,
    CountRange,
    FieldWorld,
    check_counts,
    check_field_grid,
    make_ground,
)

TARGET = "solar_panel"

_TILT = math.radians(40.0)
_PANEL = (1.56, 0.77, 0.05)
"""Length up the slope, width and thickness of a panel."""


def target_solids() -> tuple[Solid, ...]:
    """Make the solar-panel structure, which is always the same; its front is +x.

    Three panels, 2.4 m wide together, lean back by 40 degrees from 0.85 m above the ground in
    front to 1.9 m at the back. Four legs on two skids carry them, and two bars along y. A strut
    crosses the back from the foot of the right rear leg (-y) to the top of the left one (+y), and
    a junction box hangs at the left one: front, back, left and right all look different.
    """
    legs = [(0.53, 0.93), (-0.53, 1.73)]
    boxes = [_bar((x, y, 0.0), (x, y, top), 0.08) for y in (-0.97, 0.97) for x, top in legs]
    boxes += [_bar((-0.73, y, 0.04), (0.73, y, 0.04), 0.08) for y in (-0.97, 0.97)]
    boxes += [_bar((x, -1.13, top), (x, 1.13, top), 0.08) for x, top in legs]
    boxes.append(_bar((-0.53, -0.97, 0.13), (-0.53, 0.97, 1.63), 0.06))
    lean = rotation_about_axis([0.0, 1.0, 0.0], _TILT)
    boxes += [box_corners(_PANEL, (0.0, y, 1.40), lean) for y in (-0.81, 0.0, 0.81)]
    boxes.append(box_corners((0.22, 0.36, 0.46), (-0.67, 0.97, 0.83)))
    return (solid_from_boxes(TARGET, boxes, is_target=True),)


def _bar(start: ArrayLike, end: ArrayLike, width: float) -> NDArray[np.float64]:
    """Corners of a square bar from one point to another, in a plane x = const or y = const."""
    start, end = np.asarray(start), np.asarray(end)
    along = (end - start) / (length := math.dist(start, end))
    side = np.array([1.0, 0.0, 0.0]) if abs(along[0]) < 0.5 else np.array([0.0, 1.0, 0.0])
    rotation = np.column_stack([along, side, np.cross(along, side)])
    return box_corners((length, width, width), (start + end) / 2, rotation)


@dataclass(frozen=True)
class Worksite(Settings):
    """Worlds of the solar panel among random rocks and crates."""

    grid: VoxelGrid = FIELD_GRID
    rocks: CountRange = (6, 14)
    """Fewest and most rocks drawn; those without room or that hide the panel are left out."""
    crates: CountRange = (4, 10)
    """Fewest and most crates drawn, those on top of another included."""
    stacked_fraction: UnitInterval = 0.3
    """Chance that a crate goes on top of the one before it."""
    base_placement: BasePlacement = DEFAULT_PLACEMENT

    def __post_init__(self) -> None:
        super().__post_init__()
        check_field_grid(self.grid)
        check_counts(self, "rocks", "crates")

    @property
    def name(self) -> str:
        """What the scene is called in reports."""
        return "worksite"

    def world(
        self, rng: np.random.Generator, n_robots: int, footprint: float = BASE_CLEARANCE
    ) -> FieldWorld:
        """Draw base poses around the panel, then rocks and crates that leave them room."""
        target = target_solids()
        bases = sample_base_poses(rng, n_robots, self.base_placement, footprint, self.grid, target)
        layout = SceneLayout(self.grid, bases, footprint, target)
        n_rocks = rng.integers(self.rocks[0], self.rocks[1] + 1)
        n_crates = rng.integers(self.crates[0], self.crates[1] + 1)
        for k in range(n_crates):
            _add_crate(rng, layout, f"crate_{k}", self.stacked_fraction)
        for k in range(n_rocks):
            _add_rock(rng, layout, f"rock_{k}")
        solids = (make_ground(self.grid), *target, *layout.remove_occluders())
        return FieldWorld(self.name, solids, TARGET, self.grid, bases)


_MIN_DISTANCE, _MAX_DISTANCE = 1.0, 6.0
"""Metres from the middle of the target, between which rocks and crates lie."""


def _add_crate(
    rng: np.random.Generator, layout: SceneLayout, name: str, stacked_fraction: float
) -> None:
    """Place a crate on the one before it, if that stands on the ground, or on a free disc."""
    size, yaw = rng.uniform(0.3, 0.8, 3), rng.uniform(-math.pi, math.pi)
    on_top = rng.random() < stacked_fraction
    if on_top and layout.solids and layout.support[-1] == -1:
        lower = layout.solids[-1]
        middle, floor = lower.bounds.mean(axis=0)[:2], lower.bounds[1, 2]
        reach = np.linalg.norm(lower.vertices[:, :2] - middle, axis=1).max()
        size[:2] *= min(1.0, 2.0 * reach / length(size[:2]))  # stays within its disc
        support = len(layout.solids) - 1
    else:
        radius = 0.5 * length(size[:2])
        center = layout.sample_free_disc(rng, radius, _MIN_DISTANCE, _MAX_DISTANCE)
        if center is None:
            return
        middle, floor, support = center, 0.0, -1
    corners = box_corners(size, (*middle, floor + size[2] / 2), rotation_about_axis(Z_AXIS, yaw))
    layout.add(solid_from_boxes(name, [corners]), support)


def _add_rock(rng: np.random.Generator, layout: SceneLayout, name: str) -> None:
    """Place a rock on a free disc, a sixth of its height in the ground."""
    points = rng.normal(size=(16, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    points *= rng.uniform(0.8, 1.0, (16, 1)) * rng.uniform(0.6, 1.0, 3)
    points = product(points, random_rotation(rng).T)
    points -= (points.min(axis=0) + points.max(axis=0)) / 2
    points *= rng.uniform(0.2, 0.9) / np.ptp(points, axis=0).max()
    radius = float(np.linalg.norm(points[:, :2], axis=1).max())
    center = layout.sample_free_disc(rng, radius, _MIN_DISTANCE, _MAX_DISTANCE)
    if center is not None:
        height = float(np.ptp(points[:, 2]))
        layout.add(solid_from_hull(name, points + np.array([*center, height / 3])))
