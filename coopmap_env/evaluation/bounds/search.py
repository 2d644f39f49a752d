"""The search for certificates: weights that bound what can be shown, near to what is possible.

The dual of maximum coverage, on a list of active views that grows: minimise the bound of the active
views (`_active_views`), look at all views with these weights, keep the bound, which holds, and add
the views that exceeded. What some views show together, a greedy choice that is improved by
exchanges, tells how far the bound can still fall.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.settings import Bounds, PositiveInt, Settings
from coopmap_env.evaluation.bounds._active_views import improve_choice, minimise_bound
from coopmap_env.evaluation.bounds.certificate import (
    SCALE,
    Certificate,
    PoseSets,
    Views,
    ViewScores,
)

EVALUATED_TOGETHER = 64
"""Places whose gains the greedy choice computes again in one call."""
MAX_SWEEPS = 20
"""Of exchanges."""


@dataclass(frozen=True)
class BoundSearch(Settings):
    """How long to search."""

    n_rounds: Annotated[int, Bounds(at_least=0, largest=1_000)] = 12
    """Passes over all views, at most, for each horizon."""
    n_horizons: Annotated[int, Bounds(at_least=1, largest=20)] = 3
    """Numbers of scans for which it is searched: all, a half, a quarter and so on; the bound at
    each scan is the least of what was found."""
    n_added: PositiveInt = 150
    """Active views that each round adds, one of a block of places."""
    n_steps: PositiveInt = 400
    """Steps on the active views in each round."""
    tolerance: Annotated[float, Bounds(at_least=0, largest=1)] = 0.01
    """Relative gap between the bound and the best choice at which the search ends."""


class ShownBound(NamedTuple):
    """How many cells can be shown in a world."""

    bounds: NDArray[np.int64]
    """Most cells that any policy shows, before the first scan and after each (n_scans + 1,)."""
    choice: NDArray[np.int64]
    """Poses (n_scans, n_robots) that show many cells; no policy need reach them one by one."""
    choice_shown: NDArray[np.int64]
    """Cells that the best of some choices shows, before the first scan and after each
    (n_scans + 1,); at the end it is `choice`."""
    certificates: tuple[Certificate, ...]
    """The bound is the least of theirs."""

    @property
    def gap(self) -> float:
        """Relative gap between the bound and what the choice shows, at the end."""
        return float(self.bounds[-1] / self.choice_shown[-1] - 1.0)


def bound_shown(views: Views, n_scans: int, search: BoundSearch | None = None) -> ShownBound:
    """Bound the cells that a team can show with n_scans scans of each robot.

    Parameters
    ----------
    views : Views
    n_scans : int
    search : BoundSearch, optional

    Raises
    ------
    ValueError
        If there is no scan, or there are more than the views were made for.
    """
    settings = search or BoundSearch()
    trivial = Certificate.trivial(len(views.known))
    bounds, largest = trivial.evaluate(views, n_scans)
    found = [(trivial, bounds)]
    choices = [greedy_choice(views, n_scans, largest)]
    for horizon in dict.fromkeys(max(n_scans >> k, 1) for k in range(settings.n_horizons)):
        choices.append(_tighten(views, choices[0][:horizon], n_scans, settings, found))
    each = np.array([own for _, own in found])
    return ShownBound(
        each.min(axis=0),
        choices[1],
        np.max([_count_shown(views, choice, n_scans) for choice in choices], axis=0),
        tuple(found[k][0] for k in np.unique(each.argmin(axis=0))),
    )


def _tighten(
    views: Views,
    choice: NDArray[np.int64],
    n_scans: int,
    settings: BoundSearch,
    found: list[tuple[Certificate, NDArray[np.int64]]],
) -> NDArray[np.int64]:
    """Add certificates of what is shown by the end of a choice (h, n_robots); a better choice.

    Each with its bounds (n_scans + 1,).
    """
    known, horizon = views.known, len(choice)
    active, weights = np.unique(choice), (~known).astype(np.float64)
    most = _count_shown(views, choice)[-1]
    for _ in range(settings.n_rounds):
        if min(bounds[horizon] for _, bounds in found) <= (1.0 + settings.tolerance) * most:
            break
        sets = views.pose_sets(active)
        earliest = np.ascontiguousarray(views.earliest[:, views.place_of(active)])
        choice = _improved(sets, earliest, known, active, choice)
        most = _count_shown(views, choice)[-1]
        target = float(most - known.sum())
        minimise_bound(*sets, earliest, horizon, target, known, settings.n_steps, weights)
        certificate = Certificate(np.round(weights * SCALE).astype(np.uint16))
        bounds, best = certificate.evaluate(views, n_scans)
        found.append((certificate, bounds))
        active = np.union1d(active, _best_of_blocks(views, best, settings.n_added))
    return choice


def greedy_choice(views: Views, n_scans: int, largest: ViewScores) -> NDArray[np.int64]:
    """Poses (n_scans, n_robots), each the one that adds most to those before it.

    `largest` are the largest views. Gains only fall, so the gain that a place had last bounds it:
    few are computed again at a time. Where nothing is left to gain, any pose will do.
    """
    unseen = (~views.known).astype(np.int64)
    gains, poses = largest.scores // SCALE, largest.poses.copy()
    chosen = np.empty((n_scans, len(views.earliest)), dtype=np.int64)
    for scan in range(n_scans):
        for robot, earliest in enumerate(views.earliest):
            possible = np.flatnonzero(earliest <= scan + 1)
            best = possible[0]
            if unseen.any():
                best = _greatest_gain(views, unseen, possible, gains, poses)
            chosen[scan, robot] = poses[best]
            unseen[views.pose_sets(poses[[best]]).cells] = 0
    return chosen


def _greatest_gain(
    views: Views,
    unseen: NDArray[np.int64],
    possible: NDArray[np.int64],
    gains: NDArray[np.int64],
    poses: NDArray[np.int64],
) -> int:
    """Of the possible places the one with the greatest gain; brings gains and poses up to date."""
    is_fresh = np.zeros(len(possible), dtype=np.bool_)
    k = min(EVALUATED_TOGETHER, len(possible))
    while True:
        top = np.argpartition(gains[possible], -k)[-k:]
        best = top[gains[possible[top]].argmax()]
        if is_fresh[best] or gains[possible[best]] == 0:
            return int(possible[best])
        stale = top[~is_fresh[top]]
        at = possible[stale]
        gains[at], poses[at] = views.best(unseen, at)
        is_fresh[stale] = True


def _improved(
    sets: PoseSets,
    earliest: NDArray[np.int64],
    known: NDArray[np.bool_],
    active: NDArray[np.int64],
    choice: NDArray[np.int64],
) -> NDArray[np.int64]:
    """A choice of active poses (n_scans, n_robots) after exchanges."""
    chosen = np.searchsorted(active, choice)
    for _ in range(MAX_SWEEPS):
        if not improve_choice(*sets, earliest, known, chosen):
            break
    return active[chosen]


def _count_shown(
    views: Views, choice: NDArray[np.int64], n_scans: int | None = None
) -> NDArray[np.int64]:
    """Cells that poses (h, n_robots) show or that are known, before the first scan and after each.

    Shape (h + 1,), or (n_scans + 1,) where nothing more is shown after scan h.
    """
    shown, counts = views.known.copy(), [int(views.known.sum())]
    for poses in choice:
        shown[views.pose_sets(poses).cells] = True
        counts.append(int(shown.sum()))
    return np.array(counts + counts[-1:] * ((n_scans or 0) - len(choice)))


def _best_of_blocks(views: Views, best: ViewScores, n: int) -> NDArray[np.int64]:
    """The n best of these poses, of each block of places the best one."""
    order = np.argsort(-best.scores, kind="stable")
    _, first = np.unique(views.blocks[order], return_index=True)
    return best.poses[order[np.sort(first)[:n]]]
