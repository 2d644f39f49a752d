"""Base poses of the vehicles around a target.

Bases are drawn first. What surrounds the target then keeps clear of them (see `layout`), so that
obstacles never leave a vehicle without room.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.elementary import atan2, sin_cos
from coopmap_env.core.settings import (
    Bounds,
    NonNegative,
    Positive,
    PositiveInt,
    Settings,
    checked_value,
)
from coopmap_env.geometry import Z_AXIS, Pose, rotation_about_axis
from coopmap_env.mapping import VoxelGrid
from coopmap_env.simulation.scenes.field._solid_queries import (
    distance_to_triangles,
    first_hit,
    project_to_ground,
)
from coopmap_env.simulation.scenes.field.solid import Solid

EYE_HEIGHT = 1.5
"""Metres above a base from which the target has to be visible: about the height of the cameras."""
BORDER_MARGIN = 1.3
"""Metres between a base and the border of the grid: a footprint and a voxel."""

MIN_VISIBLE_FRACTION = 0.25
"""Least fraction of the rays towards the target, from above a base, that reach it."""

_N_RAYS = 48
"""Towards the target, to estimate how much of it is visible."""
_MAX_RESTARTS, _MAX_TRIES = 200, 60
"""Placements of a whole team, and of a base in it."""


@dataclass(frozen=True)
class BasePlacement(Settings):
    """Where vehicles may stand around a target."""

    min_distance: Positive = 2.5
    """Metres from the middle of the target."""
    max_distance: Positive = 4.5
    """Metres: a default camera still sees 1.5 m of depth behind the middle."""
    min_spacing: NonNegative = 2.2
    """Metres between vehicles: two chassis and room to move an arm."""
    sector: Annotated[float, Bounds(above=0, at_most=2 * math.pi)] = 2 * math.pi
    """Radians around the middle, within which all vehicles of a team stand: by default all around;
    less leaves them on one side, which is drawn for each world."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.min_distance < self.max_distance:
            raise ValueError(
                "BasePlacement needs min_distance < max_distance, got "
                f"{self.min_distance!r}, {self.max_distance!r}"
            )


DEFAULT_PLACEMENT = BasePlacement()


def sample_base_poses(
    rng: np.random.Generator,
    n_robots: int,
    placement: BasePlacement,
    footprint: float,
    grid: VoxelGrid,
    solids: Sequence[Solid],
    middle: ArrayLike = (0.0, 0.0),
) -> tuple[Pose, ...]:
    """Draw base poses around the target that face its middle (x, y).

    They keep `footprint` metres clear of the solids, and enough of the target is visible from
    each of them.

    Raises
    ------
    ValueError
        If no poses were found for so many vehicles.
    """
    check_vehicles(n_robots, footprint)
    middle = np.asarray(middle, dtype=np.float64)[:2]
    low = np.array(grid.origin)[:2] + BORDER_MARGIN
    high = np.array(grid.origin)[:2] + np.array(grid.shape)[:2] * grid.resolution - BORDER_MARGIN
    obstacles = project_to_ground(solids)
    for _ in range(_MAX_RESTARTS):
        bases: list[NDArray[np.float64]] = []
        half = placement.sector / 2
        direction = rng.uniform(-math.pi, math.pi) if half < math.pi else 0.0
        for _ in range(_MAX_TRIES):
            radius = math.sqrt(rng.uniform(placement.min_distance**2, placement.max_distance**2))
            angle = direction + rng.uniform(-half, half)
            base = middle + radius * np.array(sin_cos(angle)[::-1])
            if (
                (base >= low).all()
                and (base <= high).all()
                and all(math.dist(base, other) >= placement.min_spacing for other in bases)
                and distance_to_triangles(base[0], base[1], obstacles) >= footprint
                and visible_target_fraction(base, solids) >= MIN_VISIBLE_FRACTION
            ):
                bases.append(base)
                if len(bases) == n_robots:
                    return tuple(facing_pose(base[0], base[1], middle) for base in bases)
    raise ValueError(
        f"no place for {n_robots} vehicles {placement.min_distance:g} to "
        f"{placement.max_distance:g} m from the middle of the target, "
        f"in a sector of {math.degrees(placement.sector):g} degrees, "
        f"{placement.min_spacing:g} m apart, {footprint:g} m clear of the scene, "
        f"{BORDER_MARGIN:g} m inside of the grid and with the target visible: take fewer "
        f"vehicles or a larger grid, or name bases that fit"
    )


def check_vehicles(n_robots: int, footprint: float) -> None:
    """Raise ValueError unless there is a vehicle and its footprint is a length."""
    checked_value("n_robots", n_robots, PositiveInt)
    checked_value("footprint", footprint, NonNegative)


def facing_pose(x: float, y: float, middle: NDArray[np.float64]) -> Pose:
    """Pose of a base at (x, y) on the ground that faces a point (x, y)."""
    return ground_pose(x, y, atan2(middle[1] - y, middle[0] - x))


def ground_pose(x: float, y: float, yaw: float) -> Pose:
    """Pose of a frame on the ground, rotated by `yaw` about z, radians."""
    return Pose(np.array([x, y, 0.0]), rotation_about_axis(Z_AXIS, yaw))


def visible_target_fraction(base: ArrayLike, solids: Sequence[Solid]) -> float:
    """Fraction of the rays towards the target, from above a base (x, y), that hit it first.

    1 if none of the solids is a target.
    """
    above_ground = [solid for solid in solids if not solid.is_ground]
    is_target = np.array([solid.is_target for solid in above_ground], dtype=np.bool_)
    if not is_target.any():
        return 1.0
    return float(is_target[first_hits_toward_target(np.asarray(base)[:2], above_ground)].mean())


def first_hits_toward_target(
    base: NDArray[np.float64], solids: Sequence[Solid]
) -> NDArray[np.int64]:
    """First solid that is hit by each of the rays from above a base towards `target_points`.

    Each ray hits something: at the latest the triangle that it is directed at.
    """
    return first_hit(np.array([*base, EYE_HEIGHT]), target_points(solids), solids)


def target_points(solids: Sequence[Solid]) -> NDArray[np.float64]:
    """Points (n, 3) on the target: the middles of some of its triangles."""
    centers = np.concatenate([s.triangles.mean(axis=1) for s in solids if s.is_target])
    return centers[:: max(1, len(centers) // _N_RAYS)]
