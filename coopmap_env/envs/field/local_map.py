"""The crop of the map around a robot's base, at the coarser resolution that networks see."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from coopmap_env.geometry import Pose
from coopmap_env.mapping import VoxelGrid


class Crop(NamedTuple):
    """Which voxels the cells of a crop stand for: upright columns, of which each holds a run."""

    columns: NDArray[np.int32]
    """Shape (V, V, k): flat number of the lowest voxel of each column, -1 outside the grid."""
    n_layers: int
    """Voxels of a column that the crop shows."""

    @classmethod
    def around(cls, grid: VoxelGrid, T_world_base: Pose, cells: tuple[int, int], pool: int) -> Crop:
        """The crop of V, Z = `cells` cells around a base, each `pool` voxels wide and high.

        Cell [z, i, j] is centred (i + 1/2 - V/2) cells ahead of the base and (j + 1/2 - V/2) to its
        left, and (z + 1/2) cells above the bottom of the grid. It stands for the voxels nearest to
        pool**3 points that are spread evenly over it.
        """
        side, height = cells
        along = (np.arange(side * pool) + 0.5 - side * pool / 2) * grid.resolution
        x, y = np.meshgrid(along, along, indexing="ij")
        heading = math.atan2(T_world_base.rotation[1, 0], T_world_base.rotation[0, 0])
        c, s = math.cos(heading), math.sin(heading)
        base = T_world_base.translation
        points = np.stack(
            [base[0] + c * x - s * y, base[1] + s * x + c * y, np.full_like(x, grid.center(0)[2])],
            axis=-1,
        )
        index = grid.index(points)
        inside = grid.contains(index)
        flat = np.where(inside, grid.flat_index(np.where(inside[..., None], index, 0)), -1)
        columns = flat.reshape(side, pool, side, pool).transpose(0, 2, 1, 3).reshape(side, side, -1)
        return cls(np.ascontiguousarray(columns, dtype=np.int32), min(height * pool, grid.shape[2]))


@njit(cache=True, nogil=True)
def _write_crop_column(highest, counts, pool, gray_values, fractions, clamp, out, i, j):
    """Fill the cells above each other at (i, j), each of `pool` layers."""
    depth = out.shape[0] // 2
    for z in range(depth):
        a = np.uint64(z * pool)  # the compiler guards signed indices against negative ones
        count, top = np.int64(counts[a]), highest[a]
        for b in range(1, pool):
            count += counts[a + np.uint64(b)]
            top = max(top, highest[a + np.uint64(b)])
        out[z, i, j] = gray_values[np.uint64((top if count else 0) + clamp)]
        out[depth + z, i, j] = fractions[np.uint64(count)]


@njit(cache=True, nogil=True)
def write_crop(log_odds_fixed, sampled, columns, n_layers, pool, gray_values, clamp, out):
    """Fill `out` (2 Z, V, V): highest occupancy of the sampled voxels, and their share.

    `gray_values` holds 255 P of each level. A column is read as it lies in memory, which takes half of
    the time that going from cell to cell does.
    """
    side, _, k = columns.shape
    n = out.shape[0] // 2 * pool
    highest = np.empty(n, np.int32)
    counts = np.empty(n, np.int32)
    lowest = np.int32(-clamp)
    fractions = (255 * np.arange(k * pool + 1) // (k * pool)).astype(np.uint8)
    for i in range(side):
        for j in range(side):
            highest[:] = lowest
            counts[:] = 0
            for c in range(k):
                first = columns[i, j, c]
                if first >= 0:
                    run, seen = (
                        log_odds_fixed[first : first + n_layers],
                        sampled[first : first + n_layers],
                    )
                    for a in range(n_layers):
                        was_seen = np.int32(seen[a])
                        counts[a] += was_seen
                        # no branch: what was sampled has no pattern that could be foreseen
                        level = run[a] * was_seen + lowest * (np.int32(1) - was_seen)
                        highest[a] = max(highest[a], level)
            _write_crop_column(highest, counts, pool, gray_values, fractions, clamp, out, i, j)
