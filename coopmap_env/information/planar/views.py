"""Kernels over the cells that a camera pose would see on the known map.

A pose is the id of a lattice pose. A sampled cell with P >= 1/2 counts as occupied and ends the
beams that cross it; unknown cells let them pass. `reserved_mask` is 1 at cells that a teammate will
observe: they are not counted, and Eq. 7 treats them as hidden ones.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import PlainTuple, kernel
from coopmap_env.information.gray_levels import GrayBins, histogram_entropy
from coopmap_env.mapping import MapArrays
from coopmap_env.sensing.beam_fan import FanArrays


class ViewBuffers(NamedTuple):
    """Scratch of one view."""

    alive: NDArray[np.uint64]
    """Beams that no occupied cell has ended yet, as bits (words,)."""
    visible: NDArray[np.int64]
    """Visible cells, flat, nearest first (max_visible_cells,)."""
    entries: NDArray[np.int64]
    """Their entries in the fan (max_visible_cells,)."""
    counts: NDArray[np.int64]
    """Histogram of gray levels (n_bins,); zeros between two views."""


@kernel
def are_all_below(numbers: NDArray[np.int64], n: int) -> bool:
    """Whether every number lies in 0 ... n - 1."""
    outside = 0
    for k in range(len(numbers)):
        outside += numbers[k] < 0 or numbers[k] >= n
    return outside == 0


@kernel
def allocate_view(fan: FanArrays, n_bins: int) -> ViewBuffers:
    """Scratch for the largest view of a fan."""
    return ViewBuffers(
        np.empty(len(fan.all_beams), np.uint64),
        np.empty(fan.max_visible_cells, np.int64),
        np.empty(fan.max_visible_cells, np.int64),
        np.zeros(n_bins, np.int64),
    )


@kernel
def find_visible_cells(arrays: MapArrays, pose: int, fan: FanArrays, view: ViewBuffers) -> int:
    """Write the visible cells and their entries in the fan; return how many there are."""
    log_odds_fixed, sampled, (nx, ny, _) = arrays.log_odds_fixed, arrays.sampled_mask, arrays.shape
    start, offsets, beams, alive = fan.start, fan.offsets, fan.beams, view.alive
    n_headings = len(start) - 1
    cell, heading = pose // n_headings, pose % n_headings
    x, y = cell // ny, cell % ny
    words = len(alive)
    for w in range(words):
        alive[w] = fan.all_beams[w]
    count = 0
    for k in range(start[heading], start[heading + 1]):
        i, j = x + offsets[k, 0], y + offsets[k, 1]
        if i < 0 or i >= nx or j < 0 or j >= ny:
            continue
        visible_beams = np.uint64(0)
        for w in range(words):
            visible_beams |= alive[w] & beams[k, w]
        if visible_beams == 0:
            continue
        visible_cell = i * ny + j
        view.visible[count] = visible_cell
        view.entries[count] = k
        count += 1
        if sampled[visible_cell] and log_odds_fixed[visible_cell] >= 0:
            left = np.uint64(0)
            for w in range(words):
                alive[w] &= ~beams[k, w]
                left |= alive[w]
            if left == 0:
                break
    return count


@kernel
def view_information(
    arrays: MapArrays, reserved_mask: NDArray[np.uint8], view: ViewBuffers, n: int, gray: GrayBins
) -> tuple[float, int]:
    """NI of a view of n cells (Eqs. 6-8), nats, and its number of never-sampled cells."""
    log_odds_fixed, sampled, clamp = arrays.log_odds_fixed, arrays.sampled_mask, arrays.clamp
    counts = view.counts
    unknown = 0
    for v in range(n):
        cell, k = view.visible[v], view.entries[v]
        if reserved_mask[cell]:
            continue
        if sampled[cell]:
            counts[gray.sampled[gray.distance_class[k], log_odds_fixed[cell] + clamp]] += 1
        else:
            counts[gray.unknown[k]] += 1
            unknown += 1
    h = histogram_entropy(counts, gray)
    counts[:] = 0
    return h, unknown


@kernel
def evaluate_views(
    map_tuple: PlainTuple,
    reserved_mask: NDArray[np.uint8],
    poses: NDArray[np.int64],
    fan_tuple: PlainTuple,
    gray_tuple: PlainTuple,
    ni: NDArray[np.float64],
    unknown: NDArray[np.int64],
) -> None:
    """Write NI (Eqs. 6-8) of each pose, and how many never-sampled cells it sees.

    Cameras of at most 64 beams, such as the default one, take one pass over the fan
    (`_evaluate_views_64_beams`); others take two.

    The tuples are plain `MapArrays`, `FanArrays` and `GrayBins`.
    """
    arrays, fan, gray = MapArrays(*map_tuple), FanArrays(*fan_tuple), GrayBins(*gray_tuple)
    if len(fan.all_beams) == 1:
        _evaluate_views_64_beams(arrays, reserved_mask, poses, fan, gray, ni, unknown)
        return
    view = allocate_view(fan, gray.n_bins)
    for p in range(len(poses)):
        n = find_visible_cells(arrays, poses[p], fan, view)
        ni[p], unknown[p] = view_information(arrays, reserved_mask, view, n, gray)


@kernel
def _evaluate_views_64_beams(
    arrays: MapArrays,
    reserved_mask: NDArray[np.uint8],
    poses: NDArray[np.int64],
    fan: FanArrays,
    gray: GrayBins,
    ni: NDArray[np.float64],
    unknown: NDArray[np.int64],
) -> None:
    """`find_visible_cells` and `view_information` in one pass, where all beams fit one word.

    Planners spend their time here; it takes a third of the two passes.
    """
    log_odds_fixed, sampled, (nx, ny, _) = arrays.log_odds_fixed, arrays.sampled_mask, arrays.shape
    start, offsets, beams, clamp = fan.start, fan.offsets, fan.beams, arrays.clamp
    table, distance_class, unknown_bin = gray.sampled, gray.distance_class, gray.unknown
    margin = fan.max_offset
    n_headings = len(start) - 1
    counts = np.zeros(gray.n_bins, np.int64)
    for p in range(len(poses)):
        cell, heading = poses[p] // n_headings, poses[p] % n_headings
        x, y = cell // ny, cell % ny
        is_interior = margin <= x < nx - margin and margin <= y < ny - margin
        alive = fan.all_beams[0]
        n_unknown = 0
        for entry in range(start[heading], start[heading + 1]):
            k = np.uint64(entry)
            bits = beams[k, 0]
            if alive & bits == 0:
                continue
            i, j = x + offsets[k, 0], y + offsets[k, 1]
            if not is_interior and (i < 0 or i >= nx or j < 0 or j >= ny):
                continue
            visible_cell = np.uint64(i * ny + j)
            if sampled[visible_cell]:
                log_odds = log_odds_fixed[visible_cell]
                if not reserved_mask[visible_cell]:
                    row, column = np.uint64(distance_class[k]), np.uint64(log_odds + clamp)
                    counts[np.uint64(table[row, column])] += 1
                if log_odds >= 0:
                    alive &= ~bits
                    if alive == 0:
                        break
            elif not reserved_mask[visible_cell]:
                counts[np.uint64(unknown_bin[k])] += 1
                n_unknown += 1
        ni[p], unknown[p] = histogram_entropy(counts, gray), n_unknown
        counts[:] = 0


@kernel
def sequential_new_information(
    map_tuple: PlainTuple,
    reserved_mask: NDArray[np.uint8],
    poses: NDArray[np.int64],
    fan_tuple: PlainTuple,
    gray_tuple: PlainTuple,
    out: NDArray[np.float64],
) -> None:
    """Write NI of each pose without what the poses before it see; `reserved_mask` ends as zeros.

    The tuples are plain, as of `evaluate_views`.
    """
    arrays, fan, gray = MapArrays(*map_tuple), FanArrays(*fan_tuple), GrayBins(*gray_tuple)
    view = allocate_view(fan, gray.n_bins)
    visible = np.empty((len(poses), fan.max_visible_cells), np.int64)
    n_visible = np.zeros(len(poses), np.int64)
    for p in range(len(poses)):
        n_visible[p] = find_visible_cells(arrays, poses[p], fan, view)
        out[p], _ = view_information(arrays, reserved_mask, view, n_visible[p], gray)
        for v in range(n_visible[p]):
            visible[p, v] = view.visible[v]
            reserved_mask[visible[p, v]] = 1
    for p in range(len(poses)):
        for v in range(n_visible[p]):
            reserved_mask[visible[p, v]] = 0
