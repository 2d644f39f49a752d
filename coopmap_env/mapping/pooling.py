"""A map at half its resolution, to score many views at an eighth of the cost.

A block of 2 x 2 x 2 voxels is occupied if any of them is, with the highest log-odds of them; else
unknown if more than half of them were never sampled; else free, with the mean log-odds of those
that were. A block is reserved if more than half of it is.

A scan changes few blocks: `PooledMap.update` recomputes those of the given cells.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import (
    borrowing_kernel,
    inlined_kernel,
    kernel,
    unchecked_division_kernel,
)
from coopmap_env.mapping.arrays import MapArrays
from coopmap_env.mapping.grid import VoxelGrid
from coopmap_env.mapping.occluders import WORD, ViewedMap, update_occluder

Index = int | np.int64
UNSAMPLED = -(1 << 30)
"""Below the log-odds of any cell."""


def pooled_grid(grid: VoxelGrid) -> VoxelGrid:
    """Blocks of two voxels along each axis; the last ones may stick out of the grid."""
    shape = tuple(math.ceil(n / 2) for n in grid.shape)
    return VoxelGrid(shape, 2 * grid.resolution, grid.origin)


class PooledMap:
    """Blocks of a map, as `MapArrays` on the pooled grid.

    Parameters
    ----------
    source : MapArrays
        The map's own arrays, which it changes.
    """

    def __init__(self, source: MapArrays) -> None:
        self._source = source
        x, y, z = ((n + 1) // 2 for n in source.shape)
        n = x * y * z
        self.arrays = MapArrays(
            np.zeros(n, dtype=np.int32), np.zeros(n, dtype=np.uint8), (x, y, z), source.clamp
        )
        self.viewed = ViewedMap(self.arrays, np.zeros(-(-n // WORD), dtype=np.uint64))
        """The same with the blocks that occlude a view."""
        self._last_update = np.zeros(n, dtype=np.int64)
        self._n_updates = 0
        self.update(np.flatnonzero(source.sampled_mask.view(np.bool_)).astype(np.int32))

    def update(self, cells: NDArray[np.int32]) -> None:
        """Recompute the blocks of those cells (flat indices) that have changed."""
        self._n_updates += 1
        pool_changed(self._source, cells, self._n_updates, self._last_update, self.viewed)


def pool_mask(mask: NDArray[np.uint8], grid: VoxelGrid) -> NDArray[np.uint8]:
    """A mask of cells (n_cells,) on the pooled grid: 1 where more than half of a block is."""
    pooled = pooled_grid(grid)
    out = np.empty(pooled.n_cells, dtype=np.uint8)
    write_pooled_mask(mask, grid.shape_3d, pooled.shape_3d, out)
    return out


@inlined_kernel
def _pool_block(
    source: MapArrays,
    block: np.int32,
    corner: Index,
    size: tuple[Index, Index, Index],
    out: MapArrays,
) -> None:
    """Write a block of cells from a corner (flat index) on."""
    log_odds_fixed, sampled, (_, ny, nz) = source.log_odds_fixed, source.sampled_mask, source.shape
    highest, total, n_sampled = UNSAMPLED, 0, 0
    for x in range(size[0]):
        for y in range(size[1]):
            for z in range(size[2]):
                cell = np.uint64(corner + (x * ny + y) * nz + z)
                was_sampled, level = sampled[cell], log_odds_fixed[cell]
                n_sampled += was_sampled
                total += level * was_sampled
                highest = max(highest, level * was_sampled + UNSAMPLED * (1 - was_sampled))
    at = np.uint64(block)
    if highest >= 0:
        out.sampled_mask[at], out.log_odds_fixed[at] = 1, highest
    elif 2 * n_sampled >= size[0] * size[1] * size[2]:
        out.sampled_mask[at], out.log_odds_fixed[at] = 1, total // n_sampled
    else:
        out.sampled_mask[at] = out.log_odds_fixed[at] = 0


@unchecked_division_kernel
def _write_blocks_of_cells(
    cells: NDArray[np.int32],
    shape: tuple[int, int, int],
    pooled_shape: tuple[int, int, int],
    blocks: NDArray[np.int32],
) -> None:
    """Write the block of each cell (n,).

    Quotients are truncated products: with 1/2 added they are far enough from integers, and vector
    registers have no division of integers.
    """
    _, ny, nz = shape
    _, my, mz = pooled_shape
    per_y, per_z = 1.0 / ny, 1.0 / nz
    for n in range(len(cells)):
        cell = np.int32(cells[n])
        column = np.int32((cell + 0.5) * per_z)
        row = np.int32((column + 0.5) * per_y)
        i, j, k = row >> 1, (column - row * ny) >> 1, (cell - column * nz) >> 1
        blocks[n] = (i * my + j) * mz + k


@kernel
def _keep_first(blocks: NDArray[np.int32], update: int, last_update: NDArray[np.int64]) -> int:
    """Move the first of equal blocks to the front; return how many different ones there are."""
    n = 0
    for block in blocks:
        index = np.uint64(block)
        blocks[np.uint64(n)] = block
        n += last_update[index] != update
        last_update[index] = update
    return n


@kernel
def pool_changed(
    source: MapArrays,
    cells: NDArray[np.int32],
    update: int,
    last_update: NDArray[np.int64],
    viewed: ViewedMap,
) -> None:
    """Write the blocks of some cells, once each: `last_update` is the number of that update."""
    blocks = np.empty(len(cells), dtype=np.int32)
    _write_blocks_of_cells(cells, source.shape, viewed.arrays.shape, blocks)
    _pool_blocks(source, blocks[: _keep_first(blocks, update, last_update)], viewed)


@borrowing_kernel
def _pool_blocks(source: MapArrays, blocks: NDArray[np.int32], viewed: ViewedMap) -> None:
    """Write some blocks (flat indices)."""
    out, occluders = viewed
    nx, ny, nz = source.shape
    _, my, mz = out.shape
    for block in blocks:
        i, j, k = block // (my * mz), block // mz % my, block % mz
        corner = (2 * i * ny + 2 * j) * nz + 2 * k
        size = min(nx - 2 * i, 2), min(ny - 2 * j, 2), min(nz - 2 * k, 2)
        if size == (2, 2, 2):  # loops of a known length
            _pool_block(source, block, corner, (2, 2, 2), out)
        else:
            _pool_block(source, block, corner, size, out)
        update_occluder(out, block, occluders)


@kernel
def write_pooled_mask(
    mask: NDArray[np.uint8],
    shape: tuple[int, int, int],
    pooled_shape: tuple[int, int, int],
    out: NDArray[np.uint8],
) -> None:
    """Write `pool_mask`."""
    nx, ny, nz = shape
    mx, my, mz = pooled_shape
    for i in range(mx):
        for j in range(my):
            for k in range(mz):
                marked = size = 0
                for x in range(2 * i, min(2 * i + 2, nx)):
                    for y in range(2 * j, min(2 * j + 2, ny)):
                        column = (x * ny + y) * nz
                        for cell in range(column + 2 * k, column + min(2 * k + 2, nz)):
                            size += 1
                            marked += mask[cell]
                out[(i * my + j) * mz + k] = 2 * marked > size
