"""Which voxels around a robot are blocked, as bits, and how far a point is from them.

A voxel is blocked unless it is known to be free (see `voxel_states`). The bits of one column of
voxels lie in a few words, so a sphere is tested column by column. Beside each word are those of
`N_LEVELS` - 1 dilations of the blocked voxels by one voxel each: how many of them a voxel is
outside of bounds its distance from all that is blocked, in one cache line.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.caches import freeze
from coopmap_env.core.kernels import PlainTuple, borrowing_kernel, inlined_kernel, kernel
from coopmap_env.mapping import FREE_LOG_ODDS_FIXED, MapArrays, OccupancyMap, VoxelGrid
from coopmap_env.robots.collision.voxel_states import box_around

N_LEVELS = 8
"""Blocked voxels and their dilations: the largest distance is one voxel less."""
WORD = 64
"""Bits of a word."""
ALL_BITS = np.uint64(0xFFFFFFFFFFFFFFFF)


class BlockedVoxels(NamedTuple):
    """The blocked voxels of a box; what is beyond the box is blocked, too."""

    words: NDArray[np.uint64]
    """Shape (nx, ny, nz / WORD rounded up, N_LEVELS): bit k of a word is voxel k of its column; the
    bits after the last voxel are 1. Those of the dilations are all 1 until `find_distances`."""
    nz: int
    lower: NDArray[np.float64]
    """Lower corner (3,), metres, world frame."""
    scale: float
    """Voxels per metre."""

    @classmethod
    def from_map(cls, map_: OccupancyMap, center: Iterable[float], reach: float) -> BlockedVoxels:
        """Blocked voxels of a map in the box that extends `reach` metres around a point.

        Raises
        ------
        ValueError
            If the map is not 3-D, or a value of the box is out of its range.
        """
        grid = map_.grid
        first, (nx, ny, nz), lower = _voxel_box(grid, tuple(map(float, center)), reach)
        words = np.empty((nx, ny, -(-nz // WORD), N_LEVELS), dtype=np.uint64)
        write_blocked_words(tuple(map_.arrays), first, nz, words)
        return cls(words, nz, lower, 1.0 / grid.resolution)

    def find_distances(self) -> None:
        """Make the dilations, which takes as long as they save in some motions."""
        dilate_words(self.words)


@lru_cache(maxsize=256)
def _voxel_box(
    grid: VoxelGrid, center: tuple[float, ...], reach: float
) -> tuple[NDArray[np.int64], tuple[int, int, int], NDArray[np.float64]]:
    """First index (3,), shape and lower corner (3,) of a box: a robot asks for the same one often.

    Raises
    ------
    ValueError
        As `box_around` does.
    """
    first, shape = box_around(grid, center, reach)
    nx, ny, nz = shape.tolist()
    return freeze((first, (nx, ny, nz), np.array(grid.origin) + first * grid.resolution))


@kernel
def write_blocked_words(
    map_arrays: PlainTuple, first: NDArray[np.int64], nz: int, words: NDArray[np.uint64]
) -> None:
    """Write the words of a box with the lowest index `first` (3,), maybe outside, at level 0.

    Those of the dilations are all 1. The map's are plain `MapArrays`.
    """
    arrays = MapArrays(*map_arrays)
    log_odds_fixed, sampled, (mx, my, mz) = arrays.log_odds_fixed, arrays.sampled_mask, arrays.shape
    for i in range(words.shape[0]):
        x = first[0] + i
        for j in range(words.shape[1]):
            y = first[1] + j
            inside = 0 <= x < mx and 0 <= y < my
            for w in range(words.shape[2]):
                bits = ALL_BITS
                if inside:
                    low = max(w * WORD, -first[2])
                    high = min(min((w + 1) * WORD, nz), mz - first[2])
                    column = (x * my + y) * mz + first[2]
                    for k in range(low, high):
                        cell = np.uint64(column + k)
                        free = sampled[cell] & np.uint8(log_odds_fixed[cell] < FREE_LOG_ODDS_FIXED)
                        bits ^= np.uint64(free) << np.uint64(k - w * WORD)
                words[i, j, w, 0] = bits
                for level in range(1, N_LEVELS):
                    words[i, j, w, level] = ALL_BITS


@kernel
def dilate_words(words: NDArray[np.uint64]) -> None:
    """Write the words of each level: those of the level below, dilated by one voxel."""
    nx, ny, n, _ = words.shape
    one, last = np.uint64(1), np.uint64(WORD - 1)
    along_z, along_y = np.empty((nx, ny, n), np.uint64), np.empty((nx, ny, n), np.uint64)
    for level in range(1, N_LEVELS):
        for i in range(nx):
            for j in range(ny):
                for w in range(n):
                    bits = words[i, j, w, level - 1]
                    below = words[i, j, w - 1, level - 1] if w > 0 else ALL_BITS
                    above = words[i, j, w + 1, level - 1] if w < n - 1 else ALL_BITS
                    along_z[i, j, w] = (
                        bits | (bits << one) | (bits >> one) | (below >> last) | (above << last)
                    )
        for i in range(nx):
            for j in range(ny):
                for w in range(n):
                    left = along_z[i, j - 1, w] if j > 0 else ALL_BITS
                    right = along_z[i, j + 1, w] if j < ny - 1 else ALL_BITS
                    along_y[i, j, w] = along_z[i, j, w] | left | right
        for i in range(nx):
            for j in range(ny):
                for w in range(n):
                    left = along_y[i - 1, j, w] if i > 0 else ALL_BITS
                    right = along_y[i + 1, j, w] if i < nx - 1 else ALL_BITS
                    words[i, j, w, level] = along_y[i, j, w] | left | right


@inlined_kernel
def free_distance(blocked: BlockedVoxels, x: float, y: float, z: float) -> float:
    """A distance in voxels within which nothing is blocked; -1 at a blocked voxel.

    The point is in voxels from the lower corner of the box.
    """
    words = blocked.words
    if not (0.0 <= x < words.shape[0] and 0.0 <= y < words.shape[1] and 0.0 <= z < blocked.nz):
        return -1.0
    # signed first: the processor has no conversion to unsigned integers
    i, j, k = np.uint64(int(x)), np.uint64(int(y)), np.uint64(int(z))
    w, bit = k // np.uint64(WORD), k % np.uint64(WORD)
    count = np.uint64(N_LEVELS)
    for level in range(N_LEVELS):
        count -= (words[i, j, w, np.uint64(level)] >> bit) & np.uint64(1)
    return float(count) - 1.0


@borrowing_kernel
def is_sphere_blocked(blocked: BlockedVoxels, x: float, y: float, z: float, radius: float) -> bool:
    """Whether a sphere touches a blocked voxel; all in voxels from the lower corner of the box."""
    words = blocked.words
    nx, ny = words.shape[0], words.shape[1]
    x0, x1 = math.floor(x - radius), math.floor(x + radius)
    y0, y1 = math.floor(y - radius), math.floor(y + radius)
    if x0 < 0 or y0 < 0 or x1 >= nx or y1 >= ny:
        return True
    if math.floor(z - radius) < 0 or math.floor(z + radius) >= blocked.nz:
        return True
    for i in range(x0, x1 + 1):
        dx = max(i - x, x - i - 1.0, 0.0)
        for j in range(y0, y1 + 1):
            dy = max(j - y, y - j - 1.0, 0.0)
            square = radius * radius - dx * dx - dy * dy
            if square > 0.0:
                half = math.sqrt(square)
                low, high = math.floor(z - half), math.ceil(z + half) - 1
                while low <= high:  # one turn, unless the sphere lies on the edge of a word
                    w = low // WORD
                    n = min(high, (w + 1) * WORD - 1) - low + 1
                    bits = words[np.uint64(i), np.uint64(j), np.uint64(w), np.uint64(0)]
                    if bits >> np.uint64(low - w * WORD) << np.uint64(WORD - n):
                        return True
                    low += n
    return False
