"""Kernels on a list of active views: the weights that bound them best.

Views are `PoseSets`; `earliest` (n_robots, p) says from which scan on each robot can take them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import borrowing_kernel, kernel

PARTS = 1 << 20
"""Parts of a weight of 1 in which scores are summed: integers are added in any order."""
TIE = PARTS // 2
"""Views whose scores differ by less, half a cell, count as equally good; a step follows them all.
"""
STALL, SHRINKAGE, LEAST_STEP = 20, 0.7, 1e-3
"""Steps without a gain after which they become shorter, by this factor, down to this length."""


@kernel
def score_views(
    start: NDArray[np.int64],
    cells: NDArray[np.int32],
    parts: NDArray[np.int32] | NDArray[np.int64],
    scores: NDArray[np.int64],
) -> None:
    """Write the sum of the weights in each view; weights (n_cells,) are integers."""
    for view in range(np.uint64(len(scores))):
        total = 0
        for k in range(np.uint64(start[view]), np.uint64(start[view + np.uint64(1)])):
            total += parts[np.uint64(cells[k])]
        scores[view] = total


@borrowing_kernel
def _add_best(
    scores: NDArray[np.int64],
    earliest: NDArray[np.int64],
    best: NDArray[np.int64],
    n_equal: NDArray[np.int64],
    uses: NDArray[np.float64],
) -> int:
    """Sum of the best scores of a robot over its scans; add how often each view is used for it.

    `earliest` (p,) is that of the robot; `best` and `n_equal` (n_scans + 1,) are scratch.
    """
    n_scans = len(best) - 1
    best[:], n_equal[:] = 0, 0
    for p in range(len(scores)):
        if earliest[p] <= n_scans:
            best[earliest[p]] = max(best[earliest[p]], scores[p])
    total = 0
    for scan in range(1, n_scans + 1):
        best[scan] = max(best[scan], best[scan - 1])
        total += best[scan]
    for p in range(len(scores)):
        scan = earliest[p]
        while scan <= n_scans and scores[p] > best[scan] - TIE:
            n_equal[scan] += 1
            scan += 1
    for p in range(len(scores)):
        scan = earliest[p]
        while scan <= n_scans and scores[p] > best[scan] - TIE:
            uses[p] += 1.0 / n_equal[scan]
            scan += 1
    return total


@borrowing_kernel
def _project(
    weights: NDArray[np.float64], is_unknown: NDArray[np.bool_], slope: NDArray[np.float64]
) -> float:
    """Make the slope zero where weights cannot follow it; the square of its length."""
    square = 0.0
    for c in range(np.uint64(len(weights))):
        along = slope[c]
        stays = (weights[c] <= 0.0) & (along > 0.0) | (weights[c] >= 1.0) & (along < 0.0)
        slope[c] = along if is_unknown[c] & ~stays else 0.0
        square += slope[c] * slope[c]
    return square


@kernel
def minimise_bound(
    start: NDArray[np.int64],
    cells: NDArray[np.int32],
    earliest: NDArray[np.int64],
    n_scans: int,
    target: float,
    known: NDArray[np.bool_],
    n_steps: int,
    weights: NDArray[np.float64],
) -> float:
    """Improve weights (n_cells,): make the bound by the active views lower; return that bound.

    It counts the cells that were not known. Projected subgradient steps of Polyak's length, towards
    `target` cells, which can be shown. Weights of known cells are 0, and stay so.
    """
    n, length, stall, least = len(weights), 1.0, 0, np.inf
    slope, lowest, is_unknown = np.empty(n), weights.copy(), ~known
    n_unknown = is_unknown.sum()
    parts = np.empty(n, np.int32)
    scores, uses = np.empty(len(start) - 1, np.int64), np.empty(len(start) - 1)
    best, n_equal = np.empty((2, n_scans + 1), np.int64)
    for _ in range(n_steps):
        for c in range(n):
            parts[c] = np.int32(weights[c] * PARTS)
        score_views(start, cells, parts, scores)
        total, uses[:], slope[:] = n_unknown * PARTS - parts.sum(), 0.0, -1.0
        for robot in range(len(earliest)):
            total += _add_best(scores, earliest[robot], best, n_equal, uses)
        for p in range(len(scores)):
            if uses[p] > 0.0:
                for k in range(start[p], start[p + 1]):
                    slope[cells[k]] += uses[p]
        square, bound = _project(weights, is_unknown, slope), total / PARTS
        if bound < least - 1e-6:
            least, stall = bound, 0
            lowest[:] = weights
        else:
            stall += 1
        if square < 1e-9 or length < LEAST_STEP:
            break
        if stall >= STALL:
            length, stall = length * SHRINKAGE, 0
            weights[:] = lowest
            continue
        step = length * (bound - target) / square
        for c in range(n):
            weights[c] = min(max(weights[c] - step * slope[c], 0.0), 1.0)
    weights[:] = lowest
    return least
