"""Connected regions of free space.

Row by row, each stretch of free cells is joined with those of the row before that it touches: a
map has a hundred times fewer stretches than cells.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray


def largest_free_region(occupied: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Cells of the largest 4-connected region of free space.

    Two cells that touch at a corner only are apart: nothing passes between their neighbours.
    Of two regions of the same size the one that comes first in C order is taken.

    Parameters
    ----------
    occupied : (nx, ny) bool array
        True where something stands.

    Returns
    -------
    (nx, ny) bool array
        True in the region; all False if no cell is free.
    """
    region = np.zeros(occupied.shape, dtype=np.bool_)
    mark_largest_free_region(np.ascontiguousarray(occupied), region)
    return region


@njit(cache=True, nogil=True)
def mark_largest_free_region(occupied, region):
    """Set `region` (nx, ny), all False before, in the largest free region of `occupied`."""
    nx, ny = occupied.shape
    most = nx * ((ny + 1) // 2)
    rows = np.empty(most, np.int32)
    starts = np.empty(most, np.int32)
    stops = np.empty(most, np.int32)
    parents = np.empty(most, np.int32)
    n = 0
    above = 0  # first stretch of the row before that may touch the next one of this row
    for x in range(nx):
        first = n
        y = 0
        while y < ny:
            if occupied[x, y]:
                y += 1
                continue
            start = y
            while y < ny and not occupied[x, y]:
                y += 1
            rows[n], starts[n], stops[n], parents[n] = x, start, y, n
            while above < first and stops[above] <= start:
                above += 1
            touching = above
            while touching < first and starts[touching] < y:
                union(parents, touching, n)
                touching += 1
            n += 1
        above = first
    sizes = np.zeros(n, np.int32)
    for k in range(n):
        sizes[find_root(parents, k)] += stops[k] - starts[k]
    if n == 0:
        return
    largest = np.argmax(sizes)
    for k in range(n):
        if find_root(parents, k) == largest:
            region[rows[k], starts[k] : stops[k]] = True


@njit(cache=True, nogil=True)
def find_root(parents, k):
    """First stretch of the region of stretch `k`; shortens the way to it."""
    while parents[k] != k:
        parents[k] = parents[parents[k]]
        k = parents[k]
    return k


@njit(cache=True, nogil=True)
def union(parents, a, b):
    """Make one region of those of stretches `a` and `b`: the first stretch stays its root."""
    a, b = find_root(parents, a), find_root(parents, b)
    parents[max(a, b)] = min(a, b)
