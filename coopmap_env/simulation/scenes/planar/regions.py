"""Connected regions of free space, by union-find over the runs of free cells in each row.

Each run is joined with the runs of the row before that it touches: a map has a hundred times
fewer runs than cells.
"""

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import kernel


def largest_free_region(occupied: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Cells of the largest 4-connected region of free space.

    Two cells that touch at a corner only are apart: nothing passes between their neighbours.
    Of two regions of the same size the one that comes first in C order is taken.

    Parameters
    ----------
    occupied : (nx, ny) bool array
        True where a cell is occupied.

    Returns
    -------
    (nx, ny) bool array
        True in the region; all False if no cell is free.
    """
    region = np.zeros(occupied.shape, dtype=np.bool_)
    runs = allocate_runs(occupied.shape)
    n, _ = find_largest_free_region(np.ascontiguousarray(occupied), runs)
    for row, start, stop in runs[:3, :n].T.tolist():
        region[row, start:stop] = True
    return region


def allocate_runs(shape: tuple[int, ...]) -> NDArray[np.int32]:
    """Room for the runs of a grid of this shape: their row, start, stop, parent and size."""
    nx, ny = shape
    return np.empty((5, nx * ((ny + 1) // 2)), dtype=np.int32)


@kernel
def find_largest_free_region(
    occupied: NDArray[np.bool_], runs: NDArray[np.int32]
) -> tuple[int, int]:
    """Write the runs of the largest free region; return how many they are, and their cells.

    The first rows of `runs` are then the row, the start and the stop of each run, in C order.
    """
    nx, ny = occupied.shape
    rows, starts, stops, parents, sizes = runs[0], runs[1], runs[2], runs[3], runs[4]
    n = 0
    above = 0  # first run of the row before that may touch the next one of this row
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
            rows[n], starts[n], stops[n], parents[n], sizes[n] = x, start, y, n, 0
            while above < first and stops[above] <= start:
                above += 1
            touching = above
            while touching < first and starts[touching] < y:
                union(parents, touching, n)
                touching += 1
            n += 1
        above = first
    largest, n_kept = 0, 0
    for k in range(n):
        root = find_root(parents, k)
        sizes[root] += stops[k] - starts[k]
    for k in range(n):
        if sizes[k] > sizes[largest]:
            largest = k
    for k in range(n):
        if find_root(parents, k) == largest:
            rows[n_kept], starts[n_kept], stops[n_kept] = rows[k], starts[k], stops[k]
            n_kept += 1
    return n_kept, int(sizes[largest]) if n > 0 else 0


@kernel
def find_root(parents: NDArray[np.int32], k: int) -> int:
    """First run of the region of run `k`; shortens the path to it."""
    while parents[k] != k:
        parents[k] = parents[parents[k]]
        k = parents[k]
    return k


@kernel
def union(parents: NDArray[np.int32], a: int, b: int) -> None:
    """Join the regions of runs `a` and `b`: the first run stays the root."""
    a, b = find_root(parents, a), find_root(parents, b)
    parents[max(a, b)] = min(a, b)
