"""The search for certificates: weights that bound what can be shown, near to what is possible.

The dual of maximum coverage, on a list of active views that grows: minimise the bound of the active
views (`_active_views`), look at all views with these weights, keep the bound, which holds, and add
the views that exceeded. What some views show together tells how far the bound can still fall.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.settings import Bounds, Settings
from coopmap_env.evaluation.bounds._active_views import minimise_bound
from coopmap_env.evaluation.bounds.certificate import SCALE, Certificate, Views, ViewScores

N_ADDED, N_STEPS = 600, 150
"""Active views that a round adds, at most, one of a block of places; steps on them in a round."""
STAY = 0.3
"""Fraction of the way back to the best weights so far at which all views are looked at: views that
are good at both are missing, not those that only the last steps forgot (Wentges 1997)."""
RESOLUTION = 1e-3
"""The search ends when the active views alone do not let the bound fall by this fraction."""


@dataclass(frozen=True)
class BoundSearch(Settings):
    """How long to search."""

    n_exchanges: Annotated[int, Bounds(at_least=0, largest=1_000_000)] = 8_000
    """Random exchanges that improve the choice, for each scan of a robot."""
    n_rounds: Annotated[int, Bounds(at_least=0, largest=1_000)] = 14
    """Passes over all views, at most."""
    tolerance: Annotated[float, Bounds(at_least=0, largest=1)] = 0.01
    """Relative gap between the bound and the choice at which the search ends."""

    def is_as_long_as(self, other: BoundSearch) -> bool:
        """Whether it does not end before another one, whatever ends it."""
        return (
            self.n_exchanges >= other.n_exchanges
            and self.n_rounds >= other.n_rounds
            and self.tolerance <= other.tolerance
        )


class ShownBound(NamedTuple):
    """How many cells can be shown in a world."""

    bounds: NDArray[np.int64]
    """Most cells that any policy shows, before the first scan and after each (n_scans + 1,)."""
    choice: NDArray[np.int64]
    """Poses (n_scans, n_robots) that show many cells; no policy need reach them one by one."""
    choice_shown: NDArray[np.int64]
    """Cells that the choice shows, before the first scan and after each (n_scans + 1,); it is made
    for the last scan."""
    certificates: tuple[Certificate, ...]
    """The bound is the least of theirs."""
    search: BoundSearch
    """How it was found."""

    @property
    def gap(self) -> float:
        """Relative gap between the bound and what the choice shows, at the end."""
        return float(self.bounds[-1] / self.choice_shown[-1] - 1.0)


def bound_shown(
    views: Views,
    n_scans: int,
    search: BoundSearch | None = None,
    log: Callable[[str], None] | None = None,
) -> ShownBound:
    """Bound the cells that a team can show with n_scans scans of each robot.

    The search is for the bound after the last scan: bounds of fewer scans are best asked for by
    themselves.

    Parameters
    ----------
    views : Views
    n_scans : int
    search : BoundSearch, optional
    log : callable, optional
        Receives a line of progress after each round.

    Raises
    ------
    ValueError
        If there is no scan, or there are more than the views were made for.
    """
    settings = search or BoundSearch()
    trivial = Certificate.trivial(len(views.known))
    found = [_Found(trivial, *trivial.evaluate(views, n_scans))]
    choice = views.choose(n_scans, settings.n_exchanges * n_scans * len(views.earliest))
    choice_shown = count_shown(views, choice)
    _tighten(views, choice, int(choice_shown[-1]), settings, found, log)
    each = np.array([one.bounds for one in found])
    return ShownBound(
        np.minimum(each.min(axis=0), len(views.known)),
        choice,
        choice_shown,
        tuple(found[k].certificate for k in np.unique(each.argmin(axis=0))),
        settings,
    )


class _Found(NamedTuple):
    """A certificate, with what all views say of it."""

    certificate: Certificate
    bounds: NDArray[np.int64]
    best: ViewScores


def _tighten(
    views: Views,
    choice: NDArray[np.int64],
    most: int,
    settings: BoundSearch,
    found: list[_Found],
    log: Callable[[str], None] | None,
) -> None:
    """Add certificates whose bounds come near to `most` cells, which the choice shows."""
    known, n_scans = views.known, len(choice)
    active, weights = np.unique(choice), np.where(known, 0.0, 1.0)
    n_known = int(known.sum())
    for k in range(1, settings.n_rounds + 1):
        least = min(found, key=lambda one: int(one.bounds[-1]))
        if least.bounds[-1] <= (1.0 + settings.tolerance) * most:
            break
        active = np.union1d(active, _best_of_blocks(views, found[-1].best))
        sets = views.pose_sets(active)
        earliest = np.ascontiguousarray(views.earliest[:, views.place_of(active)])
        target = float(most - n_known)
        lowest = minimise_bound(*sets, earliest, n_scans, target, known, N_STEPS, weights)
        if n_known + lowest >= (1.0 - RESOLUTION) * least.bounds[-1]:
            break
        mixed = (1.0 - STAY) * weights * SCALE + STAY * least.certificate.weights
        certificate = Certificate(np.round(mixed).astype(np.uint16))
        found.append(_Found(certificate, *certificate.evaluate(views, n_scans)))
        if log is not None:
            bounds = [int(one.bounds[-1]) for one in found]
            log(
                f"round {k}: at most {min(bounds)} cells, {bounds[-1]} by the last weights; "
                f"{len(active)} views alone: {n_known + lowest:.0f}; the choice shows {most}"
            )


def count_shown(views: Views, choice: NDArray[np.int64]) -> NDArray[np.int64]:
    """Cells that poses (n_scans, n_robots) show or that are known, before and after each scan."""
    shown, counts = views.known.copy(), [int(views.known.sum())]
    for poses in choice:
        shown[views.pose_sets(poses).cells] = True
        counts.append(int(shown.sum()))
    return np.array(counts)


def _best_of_blocks(views: Views, best: ViewScores) -> NDArray[np.int64]:
    """The best of these poses, of each block of places the best one."""
    order = np.argsort(-best.scores, kind="stable")
    _, first = np.unique(views.blocks[order], return_index=True)
    return best.poses[order[np.sort(first)[:N_ADDED]]]
