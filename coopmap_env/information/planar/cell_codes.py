"""Cell codes: one byte a cell that holds all a view needs to know of it.

====================================  ============================================================
code                                  cell
====================================  ============================================================
`UNKNOWN`, 0                          never sampled
`EMPTY`, 1                            sampled, free for motion, gray level in bin 0
2 ... `uncounted` - 1                 sampled, P < 1/2: beams pass
`uncounted`                           does not count (see below), and beams pass
`first_occupied` ... 254              sampled, P >= 1/2: ends beams
`UNCOUNTED_OCCLUDER`, 255             does not count, and ends beams
====================================  ============================================================

Sampled cells have codes in order of their log-odds. Two of them share a code if a view cannot tell
them apart: the same bin of gray levels (Eq. 8a) at every distance, both free for motion or none,
both occupied or none. Cells do not count if they lie outside of the map, or if a teammate will
observe them. Where Eq. 7 takes such cells for empty ones, `uncounted` is `EMPTY`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import borrowing_kernel, kernel
from coopmap_env.information.gray_levels import GrayLevelTable
from coopmap_env.mapping import FREE_LOG_ODDS_FIXED, LogOddsRange
from coopmap_env.sensing.beam_fan import FanArrays

UNKNOWN, EMPTY, UNCOUNTED_OCCLUDER = 0, 1, 255


@dataclass(frozen=True)
class CodeTable:
    """Which code a cell has, and what it stands for.

    There are at most 256 bins over gray levels in [0, 2], of which sampled cells have those up to
    1; so at any distance they change at most 128 times over the log-odds, and, as Eq. 8a depends on
    the distance for a distance of 1 or sqrt(2) cells only, a byte is enough.
    """

    of_log_odds: NDArray[np.uint8]
    """Code of a sampled cell, by its log-odds in fixed point plus the clamp."""
    bins: NDArray[np.uint16]
    """Shape (classes, 256): bin of a code at each class of distances. Codes that do not count have
    bin 0 if they are taken for empty cells, or `n_bins`, which stands for no bin."""
    first_not_free: int
    """Sampled cells with a lower code are free for motion."""
    first_occupied: int
    """From this code on, cells end beams."""
    uncounted: int
    """Code of a cell that does not count and lets beams pass."""

    @classmethod
    def from_gray_levels(cls, gray: GrayLevelTable, log_odds_range: LogOddsRange) -> CodeTable:
        """Codes of a map with this range of log-odds."""
        log_odds = np.arange(-log_odds_range.clamp, log_odds_range.clamp + 1)
        is_free, is_occupied = log_odds < FREE_LOG_ODDS_FIXED, log_odds >= 0
        traits = np.vstack([gray.sampled, is_free, is_occupied])
        starts_code = np.append(True, (np.diff(traits) != 0).any(axis=0))
        has_empty = is_free[0] and not gray.sampled[:, 0].any()
        codes = np.cumsum(starts_code) + (0 if has_empty else EMPTY) + is_occupied
        first_occupied = int(codes[is_occupied][0])
        uncounted = EMPTY if gray.hidden_is_empty else first_occupied - 1
        bins = np.zeros((len(gray.sampled), 256), dtype=np.uint16)
        bins[:, codes] = gray.sampled
        bins[:, [uncounted, UNCOUNTED_OCCLUDER]] = 0 if gray.hidden_is_empty else gray.n_bins
        return cls(
            codes.astype(np.uint8),
            bins,
            int(codes[is_free][-1]) + 1 if is_free.any() else EMPTY,
            first_occupied,
            uncounted,
        )


@borrowing_kernel
def update_codes(
    log_odds_fixed: NDArray[np.int32],
    sampled_mask: NDArray[np.uint8],
    cells: NDArray[np.int64],
    count: int,
    of_log_odds: NDArray[np.uint8],
    codes: NDArray[np.uint8],
) -> None:
    """Write the codes of the first `count` of `cells`, flat indices, into those of the map."""
    clamp = len(of_log_odds) // 2
    for k in range(np.uint64(count)):
        cell = np.uint64(cells[k])
        codes[cell] = of_log_odds[np.uint64(log_odds_fixed[cell] + clamp)] * sampled_mask[cell]


@kernel
def write_codes(
    log_odds_fixed: NDArray[np.int32],
    sampled_mask: NDArray[np.uint8],
    of_log_odds: NDArray[np.uint8],
    codes: NDArray[np.uint8],
) -> None:
    """Write the codes of all cells (n_cells,); `of_log_odds` is that of the `CodeTable`."""
    clamp = len(of_log_odds) // 2
    for cell in range(np.uint64(len(codes))):
        codes[cell] = of_log_odds[np.uint64(log_odds_fixed[cell] + clamp)] * sampled_mask[cell]


@kernel
def reserve_cells(
    reserved_mask: NDArray[np.uint8],
    first_occupied: int,
    uncounted: int,
    codes: NDArray[np.uint8],
) -> None:
    """Give reserved cells (n_cells,) the codes that do not count; they go on ending beams."""
    for cell in range(np.uint64(len(codes))):
        if reserved_mask[cell]:
            codes[cell] = UNCOUNTED_OCCLUDER if codes[cell] >= first_occupied else uncounted


@kernel
def write_view_codes(
    log_odds_fixed: NDArray[np.int32],
    sampled_mask: NDArray[np.uint8],
    shape: tuple[int, ...],
    poses: NDArray[np.int64],
    fan: FanArrays,
    of_log_odds: NDArray[np.uint8],
    codes: NDArray[np.uint8],
) -> None:
    """Write the codes of the cells in the fans of poses into those of the map."""
    start, offsets, flat_offsets, margin = fan.start, fan.offsets, fan.flat_offsets, fan.max_offset
    (nx, ny), n_headings, clamp = shape, len(start) - 1, len(of_log_odds) // 2
    for p in range(len(poses)):
        cell, heading = poses[p] // n_headings, poses[p] % n_headings
        x, y = cell // ny, cell % ny
        is_inner = margin <= x < nx - margin and margin <= y < ny - margin
        for k in range(np.uint64(start[heading]), np.uint64(start[heading + 1])):
            i, j = x + offsets[k, 0], y + offsets[k, 1]
            if is_inner or (0 <= i < nx and 0 <= j < ny):
                at = np.uint64(cell + flat_offsets[k])
                codes[at] = of_log_odds[np.uint64(log_odds_fixed[at] + clamp)] * sampled_mask[at]
