"""What the kernels of `views` take besides the map: tables of codes, and scratch."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import kernel
from coopmap_env.information.entropy import entropy_terms
from coopmap_env.information.gray_levels import GrayLevelTable
from coopmap_env.information.planar.cell_codes import CodeTable
from coopmap_env.sensing import BeamFan
from coopmap_env.sensing.beam_fan import FanArrays


class ViewTables(NamedTuple):
    """What a code means in a view, for each entry of a fan."""

    of_log_odds: NDArray[np.uint8]
    """See `CodeTable`, as for the next three."""
    bins: NDArray[np.uint16]
    first_occupied: int
    uncounted: int
    distance_class: NDArray[np.uint8]
    """Row of `bins`, by the entry of the fan."""
    segment_start: NDArray[np.int64]
    """Shape (n_headings + 1,)."""
    segment_last: NDArray[np.int64]
    """Last entry, counted from the heading's first, of each bin of unknown cells. Those of heading
    h are ``segment_last[segment_start[h] : segment_start[h + 1]]``. The first bin, that of the
    camera's own cell with gray level 1, is the highest that sampled cells may have too."""
    n_bins: int
    """Bins over the gray levels [0, 2]."""
    entropy_terms: NDArray[np.float64]
    """-q ln q by the count of a bin; see `entropy_terms`."""
    hidden_is_empty: bool
    """Whether cells of N that a view does not count are empty; see `RatingSettings.hidden`."""

    @classmethod
    def from_fan(cls, fan: BeamFan, gray: GrayLevelTable, codes: CodeTable) -> ViewTables:
        """Tables for the views of a fan; `gray` has those of the fan's distances."""
        lists = [
            np.flatnonzero(np.diff(gray.unknown[first:end].astype(np.int64), append=-1))
            for first, end in zip(fan.start[:-1], fan.start[1:], strict=True)
        ]
        return cls(
            codes.of_log_odds,
            codes.bins,
            codes.first_occupied,
            codes.uncounted,
            gray.distance_class,
            np.cumsum([0, *map(len, lists)]),
            np.concatenate(lists),
            gray.n_bins,
            entropy_terms(fan.max_visible_cells),
            gray.hidden_is_empty,
        )


class ViewBuffers(NamedTuple):
    """Scratch of one view. Entries are counted from the heading's first."""

    codes: NDArray[np.uint64]
    """Codes of the entries, eight to a word (n_words,)."""
    visible: NDArray[np.uint64]
    """1 at visible entries, eight to a word (n_words,)."""
    marked: NDArray[np.int64]
    """Words with special cells (n_words + 1,)."""
    special: NDArray[np.int64]
    """Entries of special cells (8 n_words + 1,)."""
    ends: NDArray[np.int64]
    """Entries of visible occupied cells (8 n_words + 1,)."""
    alive: NDArray[np.uint64]
    """Beams, as bits, that none of the first e ends has ended (8 n_words + 1, words of beams)."""
    unknown: NDArray[np.uint64]
    """Running sums of the visible unknown cells within each word (n_words,)."""
    unknown_before: NDArray[np.int64]
    """Number of visible unknown cells before each word (n_words,)."""
    counts: NDArray[np.int64]
    """Special cells in each bin of gray levels, and in none (n_bins + 1,); zeros between views."""


class ReservedCells(NamedTuple):
    """Scratch of a team's views: cells that were reserved, and their codes before."""

    cells: NDArray[np.int64]
    """Shape (n_poses max_visible_cells,)."""
    codes: NDArray[np.uint8]
    unknown: NDArray[np.int64]
    """Never-sampled cells in view (n_poses,)."""


@kernel
def allocate_view(fan: FanArrays, tables: ViewTables) -> ViewBuffers:
    """Scratch for any view of a fan."""
    n_words = (fan.max_visible_cells + 7) // 8
    n = 8 * n_words + 1
    return ViewBuffers(
        np.empty(n_words, np.uint64),
        np.empty(n_words, np.uint64),
        np.empty(n_words + 1, np.int64),
        np.empty(n, np.int64),
        np.empty(n, np.int64),
        np.empty((n, len(fan.all_beams)), np.uint64),
        np.empty(n_words, np.uint64),
        np.empty(n_words, np.int64),
        np.zeros(tables.n_bins + 1, np.int64),
    )


@kernel
def allocate_reserved(fan: FanArrays, n_poses: int) -> ReservedCells:
    """Scratch for the views of a team of this size."""
    n = n_poses * fan.max_visible_cells
    return ReservedCells(np.empty(n, np.int64), np.empty(n, np.uint8), np.empty(n_poses, np.int64))
