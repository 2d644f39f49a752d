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
"""Places whose gains the greedy choice finds anew in one call."""
MAX_SWEEPS = 20
"""Of exchanges."""


@dataclass(frozen=True)
class BoundSearch(Settings):
    """How long to search."""

    n_rounds: Annotated[int, Bounds(at_least=0, largest=1_000)] = 12
    """Passes over all views."""
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
    """Cells that they show, before the first scan and after each (n_scans + 1,)."""
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
    """
    settings = search or BoundSearch()
    known = views.known
    choice = greedy_choice(views, n_scans)
    certificates = [Certificate.trivial(len(known))]
    each = [certificates[0].bounds(views, n_scans)]
    active, weights = np.unique(choice), (~known).astype(np.float64)
    for _ in range(settings.n_rounds):
        most = _count_shown(views, choice)[-1]
        if min(own[-1] for own in each) <= (1.0 + settings.tolerance) * most:
            break
        sets, earliest = views.pose_sets(active), views.earliest[:, views.place_of(active)]
        choice = _improved(sets, earliest, known, active, choice)
        target = float(_count_shown(views, choice)[-1] - known.sum())
        minimise_bound(*sets, earliest, n_scans, target, known, settings.n_steps, weights)
        found = Certificate(np.round(weights * SCALE).astype(np.uint16))
        bounds, best = found.evaluate(views, n_scans)
        certificates.append(found)
        each.append(bounds)
        active = np.union1d(active, _best_of_blocks(views, best, settings.n_added))
    needed = np.unique(np.argmin(each, axis=0))
    return ShownBound(
        np.min(each, axis=0),
        choice,
        _count_shown(views, choice),
        tuple(certificates[k] for k in needed),
    )


def greedy_choice(views: Views, n_scans: int) -> NDArray[np.int64]:
    """Poses (n_scans, n_robots), each the one that adds most to those before it.

    Gains only fall, so the gain that a place had last bounds it: few are found anew at a time.
    """
    unseen = (~views.known).astype(np.int64)
    gains, poses = (part.copy() for part in views.best(unseen))
    chosen = np.empty((n_scans, len(views.earliest)), dtype=np.int64)
    for scan in range(n_scans):
        for robot, earliest in enumerate(views.earliest):
            possible = np.flatnonzero(earliest <= scan + 1)
            is_fresh = np.zeros(len(possible), dtype=np.bool_)
            k = min(EVALUATED_TOGETHER, len(possible))
            while True:
                top = np.argpartition(gains[possible], -k)[-k:]
                best = top[gains[possible[top]].argmax()]
                if is_fresh[best]:
                    break
                stale = top[~is_fresh[top]]
                at = possible[stale]
                gains[at], poses[at] = views.best(unseen, at)
                is_fresh[stale] = True
            chosen[scan, robot] = pose = poses[possible[best]]
            unseen[views.pose_sets(np.array([pose])).cells] = 0
    return chosen


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


def _count_shown(views: Views, choice: NDArray[np.int64]) -> NDArray[np.int64]:
    """Cells that poses (n_scans, n_robots) show or that are known, from before the first scan."""
    shown, counts = views.known.copy(), [int(views.known.sum())]
    for poses in choice:
        shown[views.pose_sets(poses).cells] = True
        counts.append(int(shown.sum()))
    return np.array(counts)


def _best_of_blocks(views: Views, best: ViewScores, n: int) -> NDArray[np.int64]:
    """The n best of these poses, of each block of places the best one."""
    order = np.argsort(-best.scores, kind="stable")
    _, first = np.unique(views.blocks[order], return_index=True)
    return best.poses[order[np.sort(first)[:n]]]
