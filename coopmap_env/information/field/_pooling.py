"""A map at half its resolution, to score many views at an eighth of the cost.

A block of 2 x 2 x 2 voxels is occupied if any of them is, with the highest log-odds of them; else
unknown if more than half of them were never sampled; else free, with the mean log-odds of those
that were. A block is reserved if more than half of it is.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import kernel
from coopmap_env.mapping import MapArrays, VoxelGrid


def pooled_grid(grid: VoxelGrid) -> VoxelGrid:
    """Blocks of two voxels along each axis; the last ones may stick out of the grid."""
    shape = tuple(math.ceil(n / 2) for n in grid.shape)
    return VoxelGrid(shape, 2 * grid.resolution, grid.origin)


@kernel
def _pool(
    arrays: MapArrays,
    reserved_mask: NDArray[np.uint8],
    out: MapArrays,
    out_reserved: NDArray[np.uint8],
) -> None:
    log_odds_fixed, sampled, (nx, ny, nz) = arrays.log_odds_fixed, arrays.sampled_mask, arrays.shape
    mx, my, mz = out.shape
    for i in range(mx):
        for j in range(my):
            for k in range(mz):
                highest = -(1 << 30)
                n_sampled = n_reserved = size = total = 0
                for x in range(2 * i, min(2 * i + 2, nx)):
                    for y in range(2 * j, min(2 * j + 2, ny)):
                        for cell in range(
                            (x * ny + y) * nz + 2 * k, (x * ny + y) * nz + min(2 * k + 2, nz)
                        ):
                            size += 1
                            n_reserved += reserved_mask[cell]
                            if sampled[cell]:
                                n_sampled += 1
                                total += log_odds_fixed[cell]
                                highest = max(highest, log_odds_fixed[cell])
                block = (i * my + j) * mz + k
                is_sampled = highest >= 0 or 2 * n_sampled >= size
                out.sampled_mask[block] = is_sampled
                if highest >= 0:
                    out.log_odds_fixed[block] = highest
                else:
                    out.log_odds_fixed[block] = total // n_sampled if is_sampled else 0
                out_reserved[block] = 2 * n_reserved > size


def pool(
    arrays: MapArrays, reserved_mask: NDArray[np.uint8], grid: VoxelGrid
) -> tuple[MapArrays, NDArray[np.uint8]]:
    """A map's arrays and its reserved mask, at the resolution of the pooled grid."""
    pooled = pooled_grid(grid)
    n = pooled.n_cells
    sampled, reserved = np.empty((2, n), dtype=np.uint8)
    out = MapArrays(np.empty(n, dtype=np.int32), sampled, pooled.shape_3d, arrays.clamp)
    _pool(arrays, reserved_mask, out, reserved)
    return out, reserved
