"""The crop of the map around a robot's base, at the coarser resolution of observations."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.elementary import atan2, sin_cos
from coopmap_env.core.kernels import borrowing_kernel, inlined_kernel, kernel
from coopmap_env.geometry import Pose
from coopmap_env.mapping import MapArrays, VoxelGrid


class Crop(NamedTuple):
    """The voxels of each cell of a crop: runs in vertical columns."""

    columns: NDArray[np.int32]
    """Shape (V, V, k): flat index of the lowest voxel of each column, -1 outside the grid."""
    column_index: NDArray[np.int32]
    """Shape (V, V, k): index of each column among those of the grid, -1 outside."""
    n_layers: int
    """Voxels of a column that the crop shows."""

    @classmethod
    def around(cls, grid: VoxelGrid, T_world_base: Pose, cells: tuple[int, int], pool: int) -> Crop:
        """The crop of V, Z = `cells` cells around a base, each `pool` voxels wide and high.

        The center of cell [z, i, j] is (i + 1/2 - V/2) cells ahead of the base, (j + 1/2 - V/2) to
        its left, and (z + 1/2) cells above the bottom of the grid. The cell covers the voxels
        nearest to pool**3 points that are spread evenly over it.
        """
        side, height = cells
        along = (np.arange(side * pool) + 0.5 - side * pool / 2) * grid.resolution
        x, y = np.meshgrid(along, along, indexing="ij")
        heading = atan2(T_world_base.rotation[1, 0], T_world_base.rotation[0, 0])
        s, c = sin_cos(heading)
        base = T_world_base.translation
        points = np.stack(
            [base[0] + c * x - s * y, base[1] + s * x + c * y, np.full_like(x, grid.center(0)[2])],
            axis=-1,
        )
        index = grid.index(points)
        inside = grid.contains(index)
        flat = np.where(inside, grid.flat_index(np.where(inside[..., None], index, 0)), -1)
        columns = flat.reshape(side, pool, side, pool).transpose(0, 2, 1, 3).reshape(side, side, -1)
        columns = np.ascontiguousarray(columns, dtype=np.int32)
        # the lowest voxel of column k is k times the height of the grid; -1 stays -1
        return cls(columns, columns // grid.shape[2], min(height * pool, grid.shape[2]))


class ColumnBuffers(NamedTuple):
    """One column of a crop, summarized layer by layer."""

    highest: NDArray[np.int32]
    """Highest log-odds of the sampled voxels in a layer, fixed point."""
    counts: NDArray[np.int32]
    """Number of sampled voxels in a layer."""


class CropScale(NamedTuple):
    """How a crop's values are written as bytes."""

    pooling: int
    """Layers of voxels in a cell."""
    clamp: int
    """Highest log-odds in fixed point."""
    byte_of_log_odds: NDArray[np.uint8]
    """255 P, rounded, of each log-odds value in fixed point (2 clamp + 1,)."""
    fractions: NDArray[np.uint8]
    """255 times the sampled fraction, rounded down, of each number of sampled voxels."""


@borrowing_kernel
def _write_column(
    buffers: ColumnBuffers, scale: CropScale, out: NDArray[np.uint8], i: int, j: int
) -> None:
    """Fill the cells above each other at (i, j)."""
    depth, pooling = out.shape[0] // 2, scale.pooling
    for z in range(depth):
        a = np.uint64(z * pooling)
        count, top = np.int64(buffers.counts[a]), buffers.highest[a]
        for b in range(1, pooling):
            count += buffers.counts[a + np.uint64(b)]
            top = max(top, buffers.highest[a + np.uint64(b)])
        out[z, i, j] = scale.byte_of_log_odds[np.uint64((top if count else 0) + scale.clamp)]
        out[depth + z, i, j] = scale.fractions[np.uint64(count)]


@inlined_kernel  # it is called for each column: a call takes as long as the work
def _add_column(
    log_odds_fixed: NDArray[np.int32],
    sampled_mask: NDArray[np.uint8],
    lowest: np.int32,
    highest: NDArray[np.int32],
    counts: NDArray[np.int32],
) -> None:
    """Add a run of voxels (n,) to a column (n,), many at once: there is no branch."""
    for a in range(len(log_odds_fixed)):
        was_sampled = np.int32(sampled_mask[a])
        counts[a] = np.int32(counts[a] + was_sampled)
        value = log_odds_fixed[a] * was_sampled + lowest * (np.int32(1) - was_sampled)
        highest[a] = max(highest[a], value)


class CropUpdate(NamedTuple):
    """Which cells of a crop are written: those whose columns have changed since."""

    last_change: NDArray[np.int64]
    """See `ColumnChanges`."""
    since: int
    """Number of the last change that the crop shows; -1 to write all cells."""


@kernel
def write_crop(
    arrays: MapArrays,
    crop: Crop,
    pooling: int,
    byte_of_log_odds: NDArray[np.uint8],
    update: CropUpdate,
    out: NDArray[np.uint8],
) -> None:
    """Fill `out` (2 Z, V, V): highest occupancy of the sampled voxels, and their fraction.

    `byte_of_log_odds` holds 255 P of each log-odds value. A column is read in the order of memory,
    which is faster than going from cell to cell.
    """
    n, k = out.shape[0] // 2 * pooling, crop.columns.shape[2]
    highest = np.empty(n, np.int32)
    counts = np.empty(n, np.int32)
    fractions = (255 * np.arange(k * pooling + 1) // (k * pooling)).astype(np.uint8)
    scale = CropScale(pooling, arrays.clamp, byte_of_log_odds, fractions)
    _write_columns(arrays, crop, update, ColumnBuffers(highest, counts), scale, out)


@borrowing_kernel
def _write_columns(
    arrays: MapArrays,
    crop: Crop,
    update: CropUpdate,
    buffers: ColumnBuffers,
    scale: CropScale,
    out: NDArray[np.uint8],
) -> None:
    last_change, since = update
    columns, n_layers, (highest, counts) = crop.columns, crop.n_layers, buffers
    side, _, k = columns.shape
    lowest = np.int32(-arrays.clamp)
    for i in range(side):
        for j in range(side):
            newest = np.int64(-1)
            for c in range(k):
                column = crop.column_index[i, j, c]
                if column >= 0:
                    newest = max(newest, last_change[np.uint64(column)])
            if since >= 0 and newest <= since:
                continue
            highest[:] = lowest
            counts[:] = 0
            for c in range(k):
                first = columns[i, j, c]
                if first >= 0:
                    end = first + n_layers
                    run, mask = arrays.log_odds_fixed[first:end], arrays.sampled_mask[first:end]
                    _add_column(run, mask, lowest, highest[:n_layers], counts[:n_layers])
            _write_column(buffers, scale, out, i, j)
