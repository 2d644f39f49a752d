"""Kernels on a list of active views: the weights that bound them best, and better choices of them.

Views are `PoseSets`; `earliest` (n_robots, p) says from which scan on each robot can take them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import borrowing_kernel, kernel

TIE = 0.5
"""Cells: views whose scores differ by less count as equally good; the step follows them all."""
STALL, SHRINKAGE, LEAST_STEP = 20, 0.7, 1e-3
"""Steps without a gain after which they become shorter, by this factor, down to this length."""


@borrowing_kernel
def _score(
    start: NDArray[np.int64], cells: NDArray[np.int32], view: int, values: NDArray[np.float64]
) -> float:
    """Sum of the values of the cells in a view."""
    total = 0.0
    for k in range(start[view], start[view + 1]):
        total += values[cells[k]]
    return total


@borrowing_kernel
def _add_best(
    start: NDArray[np.int64],
    cells: NDArray[np.int32],
    scores: NDArray[np.float64],
    earliest: NDArray[np.int64],
    n_scans: int,
    slope: NDArray[np.float64],
) -> float:
    """Sum of the best scores of a robot over its scans; add their cells to the slope.

    `earliest` (p,) is that of the robot.
    """
    total, scan = 0.0, 1
    while scan <= n_scans:
        best, following = -1.0, n_scans + 1
        for p in range(len(scores)):
            if earliest[p] <= scan:
                best = max(best, scores[p])
            elif earliest[p] < following:
                following = earliest[p]
        n_equal = 0
        for p in range(len(scores)):
            n_equal += earliest[p] <= scan and scores[p] >= best - TIE
        if n_equal > 0:
            total += (following - scan) * best
            share = (following - scan) / n_equal
            for p in range(len(scores)):
                if earliest[p] <= scan and scores[p] >= best - TIE:
                    for k in range(start[p], start[p + 1]):
                        slope[cells[k]] += share
        scan = following
    return total


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
) -> None:
    """Improve weights (n_cells,): make the bound by the active views lower.

    Projected subgradient steps of Polyak's length, towards `target` cells, which can be shown.
    """
    n, length, stall, least = len(weights), 1.0, 0, np.inf
    slope, best = np.empty(n), weights.copy()
    scores = np.empty(len(start) - 1)
    for _ in range(n_steps):
        bound = 0.0
        for c in range(n):
            slope[c] = 0.0
            if not known[c]:
                bound += 1.0 - weights[c]
                slope[c] = -1.0
        for p in range(len(scores)):
            scores[p] = _score(start, cells, p, weights)
        for robot in range(len(earliest)):
            bound += _add_best(start, cells, scores, earliest[robot], n_scans, slope)
        square = 0.0
        for c in range(n):
            is_fixed = known[c] or (weights[c] <= 0.0 and slope[c] > 0.0)
            if is_fixed or (weights[c] >= 1.0 and slope[c] < 0.0):
                slope[c] = 0.0
            square += slope[c] * slope[c]
        if bound < least - 1e-6:
            least, stall = bound, 0
            best[:] = weights
        else:
            stall += 1
        if square < 1e-9 or length < LEAST_STEP:
            break
        if stall >= STALL:
            length, stall = length * SHRINKAGE, 0
            weights[:] = best
            continue
        step = length * (bound - target) / square
        for c in range(n):
            weights[c] = min(max(weights[c] - step * slope[c], 0.0), 1.0)
    weights[:] = best


@kernel
def improve_choice(
    start: NDArray[np.int64],
    cells: NDArray[np.int32],
    earliest: NDArray[np.int64],
    known: NDArray[np.bool_],
    chosen: NDArray[np.int64],
) -> bool:
    """Exchange chosen views (n_scans, n_robots) for those that show more beside the others.

    Whether any was exchanged.
    """
    times = np.zeros(len(known), np.int64)
    for scan in range(chosen.shape[0]):
        for robot in range(chosen.shape[1]):
            for k in range(start[chosen[scan, robot]], start[chosen[scan, robot] + 1]):
                times[cells[k]] += 1
    unseen, is_better = np.empty(len(known)), False
    for c in range(len(known)):
        unseen[c] = 0.0 if known[c] or times[c] > 0 else 1.0
    for scan in range(chosen.shape[0]):
        for robot in range(chosen.shape[1]):
            own = chosen[scan, robot]
            for k in range(start[own], start[own + 1]):
                times[cells[k]] -= 1
                if times[cells[k]] == 0 and not known[cells[k]]:
                    unseen[cells[k]] = 1.0
            best, most = own, _score(start, cells, own, unseen)
            for p in range(len(start) - 1):
                if earliest[robot, p] <= scan + 1:
                    score = _score(start, cells, p, unseen)
                    if score > most:
                        best, most = p, score
            is_better |= best != own
            chosen[scan, robot] = best
            for k in range(start[best], start[best + 1]):
                times[cells[k]] += 1
                unseen[cells[k]] = 0.0
    return is_better
