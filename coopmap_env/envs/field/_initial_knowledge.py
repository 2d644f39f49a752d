"""What field robots know at the start: free space around their bases, and frames of their own."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from coopmap_env.geometry import Pose
from coopmap_env.mapping import OccupancyMap, VoxelGrid
from coopmap_env.robots import Mount, Vehicle


def make_vehicles(
    mounts: Sequence[Mount], bases: Sequence[Pose], predicts_deflection: bool = False
) -> tuple[Vehicle, ...]:
    """The vehicles of a team with their bases at given poses, each T_world_base."""
    return tuple(
        Vehicle.from_mount(mount, base, predicts_deflection)
        for mount, base in zip(mounts, bases, strict=True)
    )


def initial_free_voxels(grid: VoxelGrid, bases: Sequence[Pose], radius: float) -> NDArray[np.int64]:
    """Flat indices of the voxels above the ground and within `radius` metres of a vehicle's axis.

    They are known to be free, because the vehicles were parked there. A voxel counts if the whole
    of it lies above the ground, so that the layer of the ground itself remains to be mapped.
    """
    nx, ny, nz = grid.shape_3d
    x, y = (
        grid.origin[axis] + (np.arange(n) + 0.5) * grid.resolution for axis, n in ((0, nx), (1, ny))
    )
    near = np.zeros((nx, ny), dtype=np.bool_)
    for base in bases:
        dx, dy = x - base.translation[0], y - base.translation[1]
        near |= dx[:, None] ** 2 + dy**2 <= radius**2
    bottoms = grid.origin[2] + np.arange(nz) * grid.resolution
    return np.flatnonzero(near[:, :, None] & (bottoms >= 0.0))


def local_base_pose(grid: VoxelGrid) -> Pose:
    """Base pose of a robot in its own frame: on the ground, in the middle of its grid."""
    low = np.array(grid.origin)
    middle = low + 0.5 * np.array(grid.shape) * grid.resolution
    return Pose(np.array([*middle[:2], 0.0]), np.eye(3))


def reset_local_maps(maps: Sequence[OccupancyMap], initial_free_radius: float) -> None:
    """Clear the maps of robots that are not located, and mark the space around them free."""
    for map_ in maps:
        map_.clear()
        map_.mark_free(
            initial_free_voxels(map_.grid, [local_base_pose(map_.grid)], initial_free_radius)
        )
