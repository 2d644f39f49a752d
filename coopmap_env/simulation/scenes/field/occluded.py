"""Occluded: the solar panel behind screens, seen from bases that all stand on one side.

Screens (walls, boards on posts, piles of crates) stand where they hide from a base what it would
see of the target, and others around it. What a robot sees depends on how it moves its camera to
look past or over them, and on what its teammates can see instead.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.elementary import atan2
from coopmap_env.core.linear_algebra import product
from coopmap_env.core.settings import OpenUnitInterval, Settings
from coopmap_env.geometry import Z_AXIS, Pose, rotation_about_axis
from coopmap_env.mapping import VoxelGrid
from coopmap_env.simulation.scenes.field._layout import SceneLayout
from coopmap_env.simulation.scenes.field.base_poses import (
    BasePlacement,
    first_hits_toward_target,
    sample_base_poses,
    target_points,
)
from coopmap_env.simulation.scenes.field.solid import Solid, box_corners, solid_from_boxes
from coopmap_env.simulation.scenes.field.worksite import TARGET, target_solids
from coopmap_env.simulation.scenes.field.world import (
    BASE_CLEARANCE,
    FIELD_GRID,
    CountRange,
    FieldWorld,
    check_counts,
    check_field_grid,
    make_ground,
)

_PLACEMENT = BasePlacement(min_distance=4.0, max_distance=5.0, sector=math.radians(130.0))
_MAX_TRIES = 20
"""Screens that are tried for a base before it counts as having no room for more."""
_FRACTIONS = (0.3, 0.9)
"""Where a screen stands on the way from a base to the target."""
_MAX_TURN = math.radians(25.0)
"""How far a screen is turned from facing what it hides the target from."""
_DISTANCES = (1.4, 3.4)
"""Metres from the middle of the target, between which the screens around it stand."""


@dataclass(frozen=True)
class Occluded(Settings):
    """Worlds of the solar panel behind screens."""

    grid: VoxelGrid = FIELD_GRID
    visible: tuple[OpenUnitInterval, OpenUnitInterval] = (0.15, 0.3)
    """Least and greatest fraction of the target that is visible from 1.5 m above each base. No
    screen leaves less than the first number. Where there is no room for more screens, more than the
    second number stays visible."""
    around: CountRange = (5, 9)
    """Fewest and most screens drawn around the target, wherever the bases are; those without room
    or that hide too much are left out."""
    base_placement: BasePlacement = _PLACEMENT
    """Vehicles stand on one side, and far enough away for screens before the target."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_field_grid(self.grid)
        check_counts(self, "around")
        if not self.visible[0] < self.visible[1]:
            raise ValueError(f"Occluded.visible must be (least, greatest), got {self.visible!r}")

    @property
    def name(self) -> str:
        """What the scene is called in reports."""
        return "occluded"

    def world(
        self, rng: np.random.Generator, n_robots: int, footprint: float = BASE_CLEARANCE
    ) -> FieldWorld:
        """Draw base poses on one side of the panel, then screens that leave them room."""
        target = target_solids()
        bases = sample_base_poses(rng, n_robots, self.base_placement, footprint, self.grid, target)
        layout = SceneLayout(self.grid, bases, footprint, target)
        screens = _Screens(layout, target, bases, self.visible)
        screens.hide_target(rng)
        screens.surround_target(rng, int(rng.integers(self.around[0], self.around[1] + 1)))
        solids = (make_ground(self.grid), *target, *layout.solids)
        return FieldWorld(self.name, solids, TARGET, self.grid, bases)


class _Screens:
    """Places screens that leave enough of the target visible from above each base."""

    def __init__(
        self,
        layout: SceneLayout,
        target: tuple[Solid, ...],
        bases: tuple[Pose, ...],
        visible: tuple[float, float],
    ) -> None:
        self._layout, self._target = layout, target
        self._points = target_points(target)[:, :2]
        self._places = [base.translation[:2] for base in bases]
        self._is_visible = np.ones((len(bases), len(self._points)), dtype=np.bool_)
        self._min_visible, self._max_visible = visible

    def hide_target(self, rng: np.random.Generator) -> None:
        """Place screens between each base and points of the target that are visible from it."""
        for k, place in enumerate(self._places):
            for _ in range(_MAX_TRIES):
                if self._is_visible[k].mean() <= self._max_visible:
                    break
                ahead = self._points[rng.choice(np.flatnonzero(self._is_visible[k]))] - place
                center = place + rng.uniform(*_FRACTIONS) * ahead
                boxes = _random_screen(rng)
                if self._layout.is_free(center, _radius(boxes)):
                    self._add(rng, boxes, center, ahead)

    def surround_target(self, rng: np.random.Generator, n_screens: int) -> None:
        """Place some screens on all sides of the target; those without room are left out."""
        for _ in range(n_screens):
            boxes = _random_screen(rng)
            center = self._layout.sample_free_disc(rng, _radius(boxes), *_DISTANCES)
            if center is not None:
                self._add(rng, boxes, center, facing=center)

    def _add(
        self,
        rng: np.random.Generator,
        boxes: list[NDArray[np.float64]],
        center: NDArray[np.float64],
        facing: NDArray[np.float64],
    ) -> None:
        """Place a screen roughly across a direction, unless it hides too much from a base."""
        turn = rng.uniform(-_MAX_TURN, _MAX_TURN)
        rotation = rotation_about_axis(Z_AXIS, atan2(facing[1], facing[0]) + turn)
        offset = np.array([*center, 0.0])
        corners = [product(box, rotation.T) + offset for box in boxes]
        screen = solid_from_boxes(f"screen_{len(self._layout.solids)}", corners)
        solids = [*self._target, screen]
        hits = np.stack([first_hits_toward_target(place, solids) for place in self._places])
        is_visible = self._is_visible & (hits < len(self._target))
        if (is_visible.mean(axis=1) >= self._min_visible).all():
            self._is_visible = is_visible
            self._layout.reserve_disc(center, _radius(boxes))
            self._layout.add(screen)


def _radius(boxes: list[NDArray[np.float64]]) -> float:
    """Metres from the axis of a screen to its farthest corner."""
    corners = np.concatenate(boxes)
    return math.sqrt((corners[:, 0] * corners[:, 0] + corners[:, 1] * corners[:, 1]).max())


def _random_screen(rng: np.random.Generator) -> list[NDArray[np.float64]]:
    """Draw a screen that faces +x: the corners (8, 3) of its boxes."""
    return (_wall, _board, _crates)[rng.integers(3)](rng)


def _wall(rng: np.random.Generator) -> list[NDArray[np.float64]]:
    """Draw a wall from the ground up."""
    width, height = rng.uniform(0.8, 1.6), rng.uniform(1.6, 2.4)
    return [box_corners((0.1, width, height), (0.0, 0.0, height / 2))]


def _board(rng: np.random.Generator) -> list[NDArray[np.float64]]:
    """Draw a board between two posts, with a gap to the ground."""
    width, height, gap = rng.uniform(0.8, 1.6), rng.uniform(1.8, 2.6), rng.uniform(0.3, 0.8)
    posts = [
        box_corners((0.1, 0.1, height), (0.0, y * (width + 0.1) / 2, height / 2)) for y in (-1, 1)
    ]
    return [*posts, box_corners((0.05, width, height - gap), (0.0, 0.0, (height + gap) / 2))]


def _crates(rng: np.random.Generator) -> list[NDArray[np.float64]]:
    """Draw a pile of crates, two or three in a row and four or five high, with gaps between."""
    n_y, n_z, side = rng.integers(2, 4), rng.integers(4, 6), rng.uniform(0.42, 0.55)
    boxes = []
    for y in side * (np.arange(n_y) - (n_y - 1) / 2):
        for z in side * np.arange(n_z):
            widths = side * rng.uniform(0.8, 1.0, 2)
            shift = (side - widths[1]) * (rng.random() - 0.5)
            boxes.append(box_corners((*widths, side), (0.0, y + shift, z + side / 2)))
    return boxes
