"""Where vehicles stand around a target.

Bases are drawn first; what surrounds the target then keeps clear of them (see `arranging`), so a
place for each vehicle never depends on luck with obstacles.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.geometry import Z_AXIS, rotation_about_axis
from coopmap_env.geometry.transforms import Pose
from coopmap_env.mapping.grid import VoxelGrid
from coopmap_env.simulation.scenes.field.outlines import distance_to_triangles, project_to_ground
from coopmap_env.simulation.scenes.field.solid import Solid
from coopmap_env.simulation.scenes.field.visibility import first_hit

EYE_HEIGHT = 1.5
"""Metres above a base from which the target has to be seen: about where mounts carry cameras."""
BORDER_MARGIN = 1.3
"""Metres between a base and the border of the grid: a footprint and a voxel."""

MIN_VISIBLE_FRACTION = 0.25
"""Least share of the looks at the target, from above a base, that nothing stops."""

_N_RAYS = 48
_MAX_RESTARTS, _MAX_TRIES = 200, 60


@dataclass(frozen=True)
class BasePlacement:
    """Where vehicles may stand about a target."""

    min_distance: float = 2.5
    """Least distance in metres from the middle of the target."""
    max_distance: float = 4.5
    """Largest distance in metres: a default camera still sees 1.5 m of depth behind the middle."""
    min_spacing: float = 2.2
    """Least distance in metres between vehicles: two chassis and room to turn an arm."""

    def __post_init__(self) -> None:
        if not 0.0 < self.min_distance < self.max_distance < math.inf:
            raise ValueError(
                f"min_distance and max_distance must satisfy 0 < min_distance < max_distance, not "
                f"{self.min_distance!r}, {self.max_distance!r}"
            )
        if not 0.0 <= self.min_spacing < math.inf:
            raise ValueError(f"min_spacing must be finite and >= 0 m, not {self.min_spacing!r}")


DEFAULT_PLACEMENT = BasePlacement()


def sample_base_poses(
    rng: np.random.Generator,
    n_robots: int,
    base_placement: BasePlacement,
    footprint: float,
    grid: VoxelGrid,
    solids: Sequence[Solid],
    middle: ArrayLike = (0.0, 0.0),
) -> tuple[Pose, ...]:
    """Draw bases about the target, facing its middle (x, y).

    They keep `footprint` clear of the solids and see the target among them.

    Raises
    ------
    ValueError
        If no place was found for so many.
    """
    check_vehicles(n_robots, footprint)
    middle = np.asarray(middle, dtype=np.float64)[:2]
    low = np.array(grid.origin)[:2] + BORDER_MARGIN
    high = np.array(grid.origin)[:2] + np.array(grid.shape)[:2] * grid.resolution - BORDER_MARGIN
    obstacles_2d = project_to_ground(solids)
    for _ in range(_MAX_RESTARTS):
        bases: list[NDArray[np.float64]] = []
        for _ in range(_MAX_TRIES):
            radius = math.sqrt(
                rng.uniform(base_placement.min_distance**2, base_placement.max_distance**2)
            )
            angle = rng.uniform(-math.pi, math.pi)
            base = middle + radius * np.array([math.cos(angle), math.sin(angle)])
            if (
                (base >= low).all()
                and (base <= high).all()
                and all(math.dist(base, other) >= base_placement.min_spacing for other in bases)
                and distance_to_triangles(base[0], base[1], obstacles_2d) >= footprint
                and visible_target_fraction(base, solids) >= MIN_VISIBLE_FRACTION
            ):
                bases.append(base)
                if len(bases) == n_robots:
                    return tuple(facing_pose(base[0], base[1], middle) for base in bases)
    raise ValueError(
        f"no place for {n_robots} vehicles {base_placement.min_distance:g} to {base_placement.max_distance:g} m from the "
        f"middle of the target, {base_placement.min_spacing:g} m apart, {footprint:g} m clear of the scene, "
        f"{BORDER_MARGIN:g} m inside of the grid and in sight of the target: take fewer vehicles or a "
        f"larger grid, or name bases that fit"
    )


def check_vehicles(n_robots: int, footprint: float) -> None:
    """Raise ValueError unless there is a vehicle and its footprint is a length."""
    if n_robots < 1:
        raise ValueError(f"n_robots must be at least 1, not {n_robots!r}")
    if not 0.0 <= footprint < math.inf:
        raise ValueError(f"footprint must be finite and >= 0 m, not {footprint!r}")


def facing_pose(x: float, y: float, middle: NDArray[np.float64]) -> Pose:
    """Pose of a base at (x, y) on the ground that faces a point (x, y)."""
    return ground_pose(x, y, math.atan2(middle[1] - y, middle[0] - x))


def ground_pose(x: float, y: float, yaw: float) -> Pose:
    """Pose of a frame on the ground, turned by `yaw` about z."""
    return Pose(np.array([x, y, 0.0]), rotation_about_axis(Z_AXIS, yaw))


def visible_target_fraction(base: ArrayLike, solids: Sequence[Solid]) -> float:
    """Share of looks at the target, from above a base (x, y), that meet it first; 1 if none is."""
    obstacles_2d = [solid for solid in solids if not solid.is_ground]
    is_target = np.array([solid.is_target for solid in obstacles_2d], dtype=np.bool_)
    if not is_target.any():
        return 1.0
    return float(is_target[first_hits_toward_target(np.asarray(base)[:2], obstacles_2d)].mean())


def first_hits_toward_target(
    base: NDArray[np.float64], solids: Sequence[Solid]
) -> NDArray[np.int64]:
    """First solid met by looks at points spread over the target's triangles.

    Each look meets something: at the latest the triangle that it aims at.
    """
    centres = np.concatenate([s.triangles.mean(axis=1) for s in solids if s.is_target])
    step = max(1, len(centres) // _N_RAYS)
    return first_hit(np.array([*base, EYE_HEIGHT]), centres[::step], solids)
