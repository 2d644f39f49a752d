"""Kernels over the cells that a camera pose would see on the known map: NI, Eqs. 6 to 8.

A pose is the id of a lattice pose, the map is the codes of its cells (`cell_codes`). A sampled cell
with P >= 1/2 counts as occupied and ends the beams that cross it; unknown cells let them pass.

In most views nearly all cells are unknown, or known and empty: the special ones are few. So a view

1. copies the codes of all entries of its fan,
2. lists the special cells, which are neither unknown nor empty,
3. counts those of them that are visible in their bins of Eq. 7, and finds what they hide,
4. sums the visible unknown cells over the list: those of one bin are neighbours, as entries are
   sorted by distance. Bin 0 takes what the other bins leave.

Entries of one byte are handled eight at a time, as a word of 64 bits.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import borrowing_kernel
from coopmap_env.information.planar.cell_codes import UNCOUNTED_OCCLUDER
from coopmap_env.information.planar.view_arrays import ReservedCells, ViewBuffers, ViewTables
from coopmap_env.information.planar.view_steps import (
    EIGHT_ONES,
    ONE,
    SEVEN,
    WORD_SHIFT,
    copy_border_codes,
    copy_inner_codes,
    count_special_cells,
    count_visible_entries,
    find_special_cells,
    find_visible_entries,
    histogram_entropy,
    sum_unknown_cells,
)
from coopmap_env.sensing.beam_fan import FanArrays


@borrowing_kernel
def evaluate_views(
    map_codes: NDArray[np.uint8],
    shape: tuple[int, ...],
    poses: NDArray[np.int64],
    fan: FanArrays,
    tables: ViewTables,
    view: ViewBuffers,
    ni: NDArray[np.float64],
    unknown: NDArray[np.int64],
) -> None:
    """Write NI (Eqs. 6-8), nats, of each pose, and how many never-sampled cells it sees.

    `shape` are the cells along x and y. Which entries the last pose sees stays in `view`.
    """
    nx, ny = shape
    start, beams, margin = fan.start, fan.beams, fan.max_offset
    offsets, flat_offsets = fan.offsets, fan.flat_offsets
    bins, distance_class, n_bins = tables.bins, tables.distance_class, tables.n_bins
    segment_start, segment_last = tables.segment_start, tables.segment_last
    words, visible_words, marked, special, ends, alive, sum_words, before, counts = view
    codes, visible = words.view(np.uint8), visible_words.view(np.uint8)
    sums = sum_words.view(np.uint8)
    n_headings = len(start) - 1
    for word in range(len(fan.all_beams)):
        alive[0, word] = fan.all_beams[word]
    for p in range(len(poses)):
        cell, heading = poses[p] // n_headings, poses[p] % n_headings
        x, y = cell // ny, cell % ny
        first, end = np.uint64(start[heading]), np.uint64(start[heading + 1])
        n = end - first
        n_words = (n + SEVEN) >> WORD_SHIFT
        # what fills up the last word is neither unknown nor special
        words[n_words - ONE] = EIGHT_ONES
        if margin <= x < nx - margin and margin <= y < ny - margin:
            copy_inner_codes(map_codes, cell, flat_offsets, first, n, codes)
        else:
            copy_border_codes(map_codes, nx, ny, x, y, offsets, first, n, tables.uncounted, codes)
        n_special = find_special_cells(words, codes, n_words, marked, special)
        visible_words[:n_words] = EIGHT_ONES
        n_ends, n_binned, lowest, highest = count_special_cells(
            special, n_special, first, beams, distance_class, bins, tables.first_occupied, n_bins,
            codes, alive, ends, counts,
        )  # fmt: skip
        if n_ends:
            find_visible_entries(first, n, beams, alive, ends, n_ends, visible)
        n_unknown = sum_unknown_cells(words, visible_words, n_words, sum_words, before)
        total = np.int64(fan.max_visible_cells)
        if not tables.hidden_is_empty:
            total = count_visible_entries(visible_words, n)
        ni[p] = histogram_entropy(
            total - n_unknown - n_binned, lowest, highest, n_bins, counts, tables.entropy_terms,
            segment_last, segment_start[heading], segment_start[heading + 1], sums, before,
        )  # fmt: skip
        unknown[p] = n_unknown


@borrowing_kernel
def list_visible_cells(
    shape: tuple[int, ...],
    pose: int,
    fan: FanArrays,
    view: ViewBuffers,
    cells: NDArray[np.int64],
) -> int:
    """Write the cells that the last pose of `evaluate_views` sees, flat, nearest first.

    Reserved cells are included. Return how many there are.
    """
    nx, ny = shape
    start, offsets, visible = fan.start, fan.offsets, view.visible.view(np.uint8)
    n_headings = len(start) - 1
    cell, heading = pose // n_headings, pose % n_headings
    x, y = cell // ny, cell % ny
    first = start[heading]
    count = 0
    for k in range(start[heading + 1] - first):
        i, j = x + offsets[first + k, 0], y + offsets[first + k, 1]
        if visible[k] and 0 <= i < nx and 0 <= j < ny:
            cells[count] = i * ny + j
            count += 1
    return count


@borrowing_kernel
def sequential_new_information(
    map_codes: NDArray[np.uint8],
    shape: tuple[int, ...],
    poses: NDArray[np.int64],
    fan: FanArrays,
    tables: ViewTables,
    view: ViewBuffers,
    reserved: ReservedCells,
    ni: NDArray[np.float64],
) -> None:
    """Write NI of each pose without what the poses before it see; `map_codes` end as they were."""
    total = 0
    for p in range(len(poses)):
        one = slice(p, p + 1)
        evaluate_views(
            map_codes, shape, poses[one], fan, tables, view, ni[one], reserved.unknown[one]
        )
        first, cells = total, reserved.cells
        if p + 1 < len(poses):
            total += list_visible_cells(shape, poses[p], fan, view, cells[first:])
        for v in range(first, total):
            code = map_codes[cells[v]]
            reserved.codes[v] = code
            occupied = code >= tables.first_occupied
            map_codes[cells[v]] = UNCOUNTED_OCCLUDER if occupied else tables.uncounted
    for v in range(total - 1, -1, -1):
        map_codes[reserved.cells[v]] = reserved.codes[v]
