"""The true field world that vehicles map, and the protocol of the scenes that make it."""

from collections import Counter
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.files import brief
from coopmap_env.core.settings import Bounds, Settings
from coopmap_env.geometry import Z_AXIS, Pose, rotation_about_axis
from coopmap_env.mapping import VoxelGrid
from coopmap_env.simulation.scenes.field._voxel_truth import voxelize_solids
from coopmap_env.simulation.scenes.field.solid import Solid, ground_slab

BASE_CLEARANCE = 1.2
"""Metres around a base's axis that hold nothing but ground: a Husky's half diagonal is 0.6 m, and
its arm needs room to move at first."""

Count = Annotated[int, Bounds(at_least=0, largest=1_000)]
CountRange = tuple[Count, Count]
"""Type of settings that hold the fewest and the most of something."""

GROUND_MARGIN = 10.0
"""Metres of ground around the grid: more than a camera's range."""

FIELD_GRID = VoxelGrid((128, 128, 40), 0.1, (-6.4, -6.4, -0.35))
"""Default voxels: the surface of the ground lies in the middle of a layer, so rounding never
decides on which side of a face it lies."""


@dataclass(frozen=True, eq=False)
class FieldWorld:
    """One field world: solids on the ground, and the base poses of the vehicles among them.

    The world frame is that of the target, z up, the ground at z = 0.

    Attributes
    ----------
    name : str
        What this world is called in reports.
    solids : tuple of Solid
        All that does not move, the ground included; at least one is a target.
    target : str
        What the target is called.
    grid : VoxelGrid
        The voxels that the robots map.
    base_poses : tuple of Pose
        T_world_base of each vehicle: on the ground, x forward, z up.

    Raises
    ------
    ValueError
        With the value, if a field is not as described.
    """

    name: str
    solids: tuple[Solid, ...]
    target: str
    grid: VoxelGrid
    base_poses: tuple[Pose, ...]

    def __post_init__(self) -> None:
        names = [solid.name for solid in self.solids]
        twice = sorted(name for name, n in Counter(names).items() if n > 1)
        if twice:
            raise ValueError(f"solids must have different names, not twice {brief(twice)}")
        if not any(solid.is_target for solid in self.solids):
            raise ValueError(f"one of the solids must be a target, not none of {brief(names)}")
        check_field_grid(self.grid)
        if not self.base_poses:
            raise ValueError("base_poses must hold at least one pose, not none")
        for k, pose in enumerate(self.base_poses):
            if pose.translation.shape != (3,):
                raise ValueError(f"base pose {k} must have 3 axes, not {pose.translation.shape}")

    def with_headings(self, headings: ArrayLike) -> "FieldWorld":
        """The same world with vehicle headings (n_robots,): radians, from +x to +y."""
        bases = tuple(
            Pose(base.translation, rotation_about_axis(Z_AXIS, float(heading)))
            for base, heading in zip(self.base_poses, np.asarray(headings), strict=True)
        )
        return replace(self, base_poses=bases)

    @property
    def n_robots(self) -> int:
        """Number of vehicles."""
        return len(self.base_poses)

    @cached_property
    def triangles(self) -> NDArray[np.float64]:
        """Triangles (m, 3, 3) of all solids, in their order."""
        return _concatenate_triangles(self.solids)

    @cached_property
    def target_triangles(self) -> NDArray[np.float64]:
        """Triangles (m, 3, 3) of the target."""
        return _concatenate_triangles(tuple(solid for solid in self.solids if solid.is_target))

    @cached_property
    def occupied(self) -> NDArray[np.bool_]:
        """Voxels (nx, ny, nz) that a surface intersects or that lie inside of a closed solid."""
        occupied = voxelize_solids(self.solids, self.grid)
        occupied.setflags(write=False)
        return occupied


def _concatenate_triangles(solids: tuple[Solid, ...]) -> NDArray[np.float64]:
    triangles = np.concatenate([solid.triangles for solid in solids])
    triangles.setflags(write=False)
    return triangles


def check_field_grid(grid: VoxelGrid) -> None:
    """Raise ValueError unless a grid has three axes and contains the ground's surface."""
    if grid.dimension != 3:
        raise ValueError(f"grid must have 3 axes, not shape {grid.shape}")
    top = grid.origin[2] + grid.shape[2] * grid.resolution
    if not grid.origin[2] < 0.0 < top:
        raise ValueError(
            f"grid must reach from below the ground (z = 0) to above it, not from "
            f"{grid.origin[2]} to {top} m"
        )


def check_counts(scene: Settings, *names: str) -> None:
    """Raise ValueError unless each of these fields is (fewest, most) in ascending order."""
    for name in names:
        fewest, most = getattr(scene, name)
        if fewest > most:
            raise ValueError(
                f"{type(scene).__name__}.{name} must be (fewest, most), got {(fewest, most)!r}"
            )


def make_ground(grid: VoxelGrid) -> Solid:
    """Make the ground under a grid and `GROUND_MARGIN` metres around it."""
    low = np.array(grid.origin)
    high = low + np.array(grid.shape) * grid.resolution
    return ground_slab(low - GROUND_MARGIN, high + GROUND_MARGIN, thickness=1.0 - low[2])


@runtime_checkable
class FieldScene(Protocol):
    """Makes field worlds on one grid."""

    @property
    def name(self) -> str:
        """What the scene is called in reports."""

    @property
    def grid(self) -> VoxelGrid:
        """The voxels that the robots map, the same for each world."""

    def world(
        self, rng: np.random.Generator, n_robots: int, footprint: float = BASE_CLEARANCE
    ) -> FieldWorld:
        """Make one world.

        Parameters
        ----------
        rng : numpy.random.Generator
            Makes every random choice.
        n_robots : int
            Vehicles in the world.
        footprint : float
            Radius in metres around each base's axis that is kept free at any height.
        """
