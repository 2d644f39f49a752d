"""Connected regions of free space, by union-find over the runs of free cells in each row.

Each run is joined with the runs of the row before that it touches: a map has a hundred times
fewer runs than cells.
"""

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import borrowing_kernel, kernel
from coopmap_env.core.words import lowest_bit

_WORD, _BYTES = 64, 8
"""Bits and bytes of a word."""
_ONE = np.uint64(1)
_PACK, _PACK_SHIFT = np.uint64(0x0102040810204080), np.uint64(56)
"""Multiplying by it gathers the lowest bits of a word's eight bytes in its upper byte, in order."""


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
    row_words = np.empty(_BYTES * (ny // _WORD + 1), dtype=np.uint64)
    row_bytes = row_words.view(np.uint8)
    row_bytes[:] = 1  # the bytes after a row stay occupied
    n = 0
    above = 0  # first run of the row before that may touch the next one of this row
    for x in range(nx):
        for y in range(np.uint64(ny)):
            row_bytes[y] = occupied[x, y]
        first, n = n, _list_runs(row_words, x, n, rows, starts, stops)
        for run in range(first, n):
            parents[run], sizes[run] = run, 0
            while above < first and stops[above] <= starts[run]:
                above += 1
            touching = above
            while touching < first and starts[touching] < stops[run]:
                union(parents, touching, run)
                touching += 1
        above = first
    largest, n_kept = 0, 0
    for k in range(n):
        parents[k] = root = find_root(parents, k)
        sizes[root] += stops[k] - starts[k]
    for k in range(n):
        if sizes[k] > sizes[largest]:
            largest = k
    for k in range(n):
        if parents[k] == largest:
            rows[n_kept], starts[n_kept], stops[n_kept] = rows[k], starts[k], stops[k]
            n_kept += 1
    return n_kept, int(sizes[largest]) if n > 0 else 0


@borrowing_kernel
def _list_runs(
    row_words: NDArray[np.uint64],
    x: int,
    n: int,
    rows: NDArray[np.int32],
    starts: NDArray[np.int32],
    stops: NDArray[np.int32],
) -> int:
    """Append the runs of a row to the first n; return how many there are then.

    The row has a byte for each cell, 1 if it is occupied; the last one is. Its cells are looked at
    64 at a time: a run starts or stops where a bit differs from the one before.
    """
    before, is_inside = _ONE, False
    for w in range(np.uint64(len(row_words) // _BYTES)):
        bits = np.uint64(0)
        for byte in range(np.uint64(_BYTES)):
            packed = (row_words[np.uint64(_BYTES) * w + byte] * _PACK) >> _PACK_SHIFT
            bits |= packed << (np.uint64(_BYTES) * byte)
        changes = bits ^ ((bits << _ONE) | before)
        before = bits >> np.uint64(_WORD - 1)
        while changes != 0:
            y = _WORD * np.int64(w) + lowest_bit(changes)
            changes &= changes - _ONE
            if is_inside:
                stops[n] = y
                n += 1
            else:
                rows[n], starts[n] = x, y
            is_inside = not is_inside
    return n


@borrowing_kernel
def find_root(parents: NDArray[np.int32], k: int) -> int:
    """First run of the region of run `k`; shortens the path to it."""
    while parents[k] != k:
        parents[k] = parents[parents[k]]
        k = parents[k]
    return k


@borrowing_kernel
def union(parents: NDArray[np.int32], a: int, b: int) -> None:
    """Join the regions of runs `a` and `b`: the first run stays the root."""
    a, b = find_root(parents, a), find_root(parents, b)
    parents[max(a, b)] = min(a, b)
