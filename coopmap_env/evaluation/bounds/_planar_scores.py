"""The best view from each cell of a planar world: sums of weights over what is in view.

Neighbours along y are scored together: the cells of a strip have each entry of the fan at
neighbouring places in memory, and the compiler turns the loops over a strip into vector
instructions.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import PlainTuple, borrowing_kernel, kernel
from coopmap_env.sensing.beam_fan import FanArrays

STRIP = 32
"""Cells that are scored together; a constant, so that the loops over them have a known length."""
SIGN_SHIFT = np.int64(63)
"""Shifts a number of 64 bits to its sign: 0, or -1, all whose bits are set."""


@borrowing_kernel
def _sum_in_view(
    marked: NDArray[np.int64],
    first: np.uint64,
    heading: int,
    fan: FanArrays,
    alive: NDArray[np.uint64],
    seen: NDArray[np.uint64],
    totals: NDArray[np.int64],
) -> None:
    """Sum the weights in view from each cell of a strip, from `first` on.

    `alive` (words, STRIP) and `seen` (STRIP,) are scratch.
    """
    n_words = np.uint64(len(fan.all_beams))
    for lane in range(STRIP):
        totals[lane] = 0
        for word in range(n_words):
            alive[word, lane] = fan.all_beams[word]
    for entry in range(np.uint64(fan.start[heading]), np.uint64(fan.start[heading + 1])):
        at = first + np.uint64(fan.flat_offsets[entry])
        values = marked[at : at + np.uint64(STRIP)]
        own, beams = alive[0], fan.beams[0, entry]
        if n_words == 1:  # half of the time of the loops below
            for lane in range(STRIP):
                sign, crossing = values[lane] >> SIGN_SHIFT, own[lane] & beams
                own[lane] &= ~(crossing & np.uint64(sign))
                totals[lane] += values[lane] ^ sign if crossing != 0 else 0
            continue
        for lane in range(STRIP):
            seen[lane] = 0
        for word in range(n_words):
            own, beams = alive[word], fan.beams[word, entry]
            for lane in range(STRIP):
                crossing = own[lane] & beams
                own[lane] &= ~(crossing & np.uint64(values[lane] >> SIGN_SHIFT))
                seen[lane] |= crossing
        for lane in range(STRIP):
            sign = values[lane] >> SIGN_SHIFT
            totals[lane] += values[lane] ^ sign if seen[lane] != 0 else 0


@kernel
def score_views(
    marked: NDArray[np.int64],
    cells: NDArray[np.int64],
    plain_fan: PlainTuple,
    scores: NDArray[np.int64],
    headings: NDArray[np.int64],
) -> None:
    """Write the best score of each cell (k,) over all headings, and which heading has it first.

    `marked` has the weights of a framed world, 0 in the frame, -1 - weight in occupied cells, and
    `STRIP` more numbers, which do not count. The cells are in order.
    """
    fan = FanArrays(*plain_fan)
    alive = np.empty((len(fan.all_beams), STRIP), np.uint64)
    seen, totals = np.empty(STRIP, np.uint64), np.empty(STRIP, np.int64)
    best, best_heading = np.empty(STRIP, np.int64), np.empty(STRIP, np.int64)
    q = 0
    while q < len(cells):
        first = cells[q]
        best[:] = -1
        for heading in range(len(fan.start) - 1):
            _sum_in_view(marked, np.uint64(first), heading, fan, alive, seen, totals)
            for lane in range(STRIP):
                if totals[lane] > best[lane]:
                    best[lane], best_heading[lane] = totals[lane], heading
        while q < len(cells) and cells[q] < first + STRIP:
            lane = cells[q] - first
            scores[q], headings[q] = best[lane], best_heading[lane]
            q += 1
