"""The steps of one view; see `views`.

They take arrays rather than named tuples of arrays: a kernel counts the arrays of a tuple as in use
and as released at every call, which takes longer than a step.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import borrowing_kernel
from coopmap_env.information.planar.cell_codes import EMPTY

EIGHT_ONES = np.uint64(0x0101010101010101)
"""A one in each byte of a word. Times it, a word of small bytes becomes their running sums."""
SPECIAL_BITS = ~EIGHT_ONES
"""Bits that are zero in a word of unknown and empty cells, whose codes are 0 and 1."""
ONE, SEVEN, EIGHT = np.uint64(1), np.uint64(7), np.uint64(8)
WORD_SHIFT, LAST_BYTE_SHIFT = np.uint64(3), np.uint64(56)


@borrowing_kernel
def copy_inner_codes(
    map_codes: NDArray[np.uint8],
    cell: int,
    flat_offsets: NDArray[np.int32],
    first: np.uint64,
    n: np.uint64,
    codes: NDArray[np.uint8],
) -> None:
    """Copy the codes of n entries of a fan, from `first` on, if all of them lie inside the map."""
    for k in range(n):
        codes[k] = map_codes[np.uint64(cell + flat_offsets[first + k])]


@borrowing_kernel
def copy_border_codes(
    map_codes: NDArray[np.uint8],
    nx: int,
    ny: int,
    x: int,
    y: int,
    offsets: NDArray[np.int16],
    first: np.uint64,
    n: np.uint64,
    uncounted: int,
    codes: NDArray[np.uint8],
) -> None:
    """Copy the codes of n entries of a fan, and `uncounted` where they lie outside of the map.

    Without branches: an unsigned number compares as too large if it is negative.
    """
    for k in range(n):
        i, j = x + offsets[first + k, 0], y + offsets[first + k, 1]
        is_inside = (np.uint64(i) < np.uint64(nx)) & (np.uint64(j) < np.uint64(ny))
        code = map_codes[np.uint64(i * ny + j) * np.uint64(is_inside)]
        codes[k] = code if is_inside else uncounted


@borrowing_kernel
def find_special_cells(
    words: NDArray[np.uint64],
    codes: NDArray[np.uint8],
    n_words: np.uint64,
    marked: NDArray[np.int64],
    special: NDArray[np.int64],
) -> np.uint64:
    """List the entries with cells that are neither unknown nor empty; return their number.

    Every index is written and kept only if the next one does not overwrite it: without branches.
    """
    n_marked = np.uint64(0)
    for w in range(n_words):
        marked[n_marked] = w
        n_marked += np.uint64(words[w] & SPECIAL_BITS != 0)
    n = np.uint64(0)
    for m in range(n_marked):
        first = np.uint64(marked[m]) << WORD_SHIFT
        for k in range(first, first + EIGHT):
            special[n] = k
            n += np.uint64(codes[k] > EMPTY)
    return n


@borrowing_kernel
def count_special_cells(
    special: NDArray[np.int64],
    n_special: np.uint64,
    first: np.uint64,
    beams: NDArray[np.uint64],
    distance_class: NDArray[np.uint8],
    bins: NDArray[np.uint16],
    first_occupied: int,
    n_bins: int,
    codes: NDArray[np.uint8],
    alive: NDArray[np.uint64],
    ends: NDArray[np.int64],
    counts: NDArray[np.int64],
) -> tuple[np.uint64, int, np.int64, np.int64]:
    """Count the visible special cells in their bins, and list the ends of beams.

    The codes of special cells become `EMPTY`. Return the number of ends, the number of cells in
    bins other than 0, and the lowest and highest bin that may not be empty, unless it is 0.
    """
    lowest = highest = np.int64(n_bins // 2)
    n_binned = 0
    e = np.uint64(0)
    for s in range(n_special):
        k = np.uint64(special[s])
        code = codes[k]
        codes[k] = EMPTY
        crossing = np.uint64(0)
        for w in range(alive.shape[1]):
            crossing |= alive[e, w] & beams[w, first + k]
        if crossing:
            b = np.int64(bins[np.uint64(distance_class[first + k]), np.uint64(code)])
            counts[np.uint64(b)] += 1
            n_binned += b != 0
            lowest, highest = min(lowest, b), max(highest, b)
            if code >= first_occupied:
                ends[e] = k
                for w in range(alive.shape[1]):
                    alive[e + ONE, w] = alive[e, w] & ~beams[w, first + k]
                e += ONE
    return e, n_binned, lowest, highest


@borrowing_kernel
def find_visible_entries(
    first: np.uint64,
    n: np.uint64,
    beams: NDArray[np.uint64],
    alive: NDArray[np.uint64],
    ends: NDArray[np.int64],
    n_ends: np.uint64,
    visible: NDArray[np.uint8],
) -> None:
    """Write which entries living beams cross, from the first end of beams on."""
    ends[n_ends] = n - ONE
    for e in range(n_ends):
        low, high = np.uint64(ends[e]) + ONE, np.uint64(ends[e + ONE]) + ONE
        left = alive[e + ONE, 0]
        for k in range(low, high):
            visible[k] = np.uint8(beams[0, first + k] & left != 0)
        for w in range(1, alive.shape[1]):
            left = alive[e + ONE, w]
            for k in range(low, high):
                visible[k] |= np.uint8(beams[w, first + k] & left != 0)


@borrowing_kernel
def sum_unknown_cells(
    words: NDArray[np.uint64],
    visible_words: NDArray[np.uint64],
    n_words: np.uint64,
    sum_words: NDArray[np.uint64],
    before: NDArray[np.int64],
) -> np.int64:
    """Write the sums of visible unknown cells in each word, and before it; return the last sum."""
    total = np.uint64(0)
    for w in range(n_words):
        sums = ((words[w] ^ EIGHT_ONES) & visible_words[w]) * EIGHT_ONES
        sum_words[w] = sums
        before[w] = total
        total += sums >> LAST_BYTE_SHIFT
    return np.int64(total)


@borrowing_kernel
def count_visible_entries(visible_words: NDArray[np.uint64], n: np.uint64) -> np.int64:
    """Number of visible entries among the n of a view."""
    n_words = (n + SEVEN) >> WORD_SHIFT
    count = np.uint64(0)
    for w in range(n_words):
        count += visible_words[w] * EIGHT_ONES >> LAST_BYTE_SHIFT
    return np.int64(count - (n_words * EIGHT - n))


@borrowing_kernel
def histogram_entropy(
    n_in_bin_0: np.int64,
    lowest: np.int64,
    highest: np.int64,
    n_bins: int,
    counts: NDArray[np.int64],
    terms: NDArray[np.float64],
    segment_last: NDArray[np.int64],
    first: int,
    end: int,
    sums: NDArray[np.uint8],
    before: NDArray[np.int64],
) -> float:
    """NI, nats (Eqs. 6 and 7): terms of bin 0, of special cells and of segments of unknown ones.

    The first segment has a bin in common with special cells. The counts become zeros.
    """
    h = 0.0 + terms[np.uint64(n_in_bin_0)]
    last = np.uint64(segment_last[first])
    done = before[last >> WORD_SHIFT] + sums[last]
    counts[np.uint64(n_bins // 2)] += done
    for b in range(np.uint64(max(lowest, np.int64(1))), np.uint64(highest + 1)):
        if b < n_bins:
            h += terms[np.uint64(counts[b])]
    for b in range(np.uint64(lowest), np.uint64(highest + 1)):
        counts[b] = 0
    for s in range(np.uint64(first + 1), np.uint64(end)):
        last = np.uint64(segment_last[s])
        so_far = before[last >> WORD_SHIFT] + sums[last]
        h += terms[np.uint64(so_far - done)]
        done = so_far
    return h
