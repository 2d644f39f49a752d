"""What a team knows before its first look: the room in which its vehicles were parked."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from coopmap_env.geometry import Pose
from coopmap_env.mapping import VoxelGrid


def initial_free_voxels(grid: VoxelGrid, bases: Sequence[Pose], radius: float) -> NDArray[np.int64]:
    """Flat numbers of the voxels above the ground and within `radius` of a vehicle's axis.

    A voxel counts if it lies above the ground as a whole, so that the layer of the ground itself
    stays to be mapped.
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
