"""Certificates: weights of cells from which an upper bound follows, whatever they are.

Let a team take n scans. A cell c that was not known is shown if at least one of them views it. For
any weight w_c between 0 and 1,

    [c is shown] <= (1 - w_c) + w_c * (number of scans that view c),

as both sides say: without a view 0 <= 1 - w_c, with k views 1 <= 1 + (k - 1) w_c. Summed over the
cells, with V(p) the cells that a scan from p views and P(r, s) the poses at which robot r can be
when it takes its scan s,

    shown <= known + sum_c (1 - w_c) + sum_r sum_s max over p in P(r, s) of sum_{c in V(p)} w_c.

It holds for each sequence of scans by itself, so also for policies that react to what they see, and
with any noise: V and P do not depend on measurements. Weights are integers, in parts of `SCALE`, so
that sums are exact, and bounds are integers, in cells.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.arguments import check_count

SCALE = 4_096
"""Parts of a weight of 1."""


class ViewScores(NamedTuple):
    """The best view from each place where a camera can be, for some weights."""

    scores: NDArray[np.int64]
    """Sum of the weights of the cells in view (k,), in parts of `SCALE`."""
    poses: NDArray[np.int64]
    """The pose that has it (k,)."""


class PoseSets(NamedTuple):
    """Cells in view of some poses: those of pose k are cells[start[k] : start[k + 1]]."""

    start: NDArray[np.int64]
    cells: NDArray[np.int32]


class Views(Protocol):
    """What cameras view in a world, and when they can be where."""

    @property
    def n_scans(self) -> int:
        """Scans of each robot that are considered: `earliest` says nothing of later ones."""

    @property
    def known(self) -> NDArray[np.bool_]:
        """Cells (n_cells,) that are known before the first scan."""

    @property
    def earliest(self) -> NDArray[np.int64]:
        """First scan (n_robots, k), from 1 on, that each robot can take at each of k places."""

    @property
    def digest(self) -> str:
        """SHA-256 of all that decides what cameras view, from where and when."""

    @property
    def blocks(self) -> NDArray[np.int64]:
        """Shape (k,): places with the same number are near to each other."""

    def best(self, weights: NDArray[np.int64]) -> ViewScores:
        """The best view from each place; weights (n_cells,) are 0 at known cells."""

    def choose(self, n_scans: int, n_exchanges: int) -> NDArray[np.int64]:
        """Poses (n_scans, n_robots) that show many cells together, after so many exchanges."""

    def pose_sets(self, poses: NDArray[np.int64]) -> PoseSets:
        """Cells in view of some poses."""

    def can_take(self, choice: NDArray[np.int64]) -> bool:
        """Whether all numbers (n_scans, n_robots) are poses where robots can be in time."""

    def place_of(self, poses: NDArray[np.int64]) -> NDArray[np.int64]:
        """The place (m,) of each of some poses (m,)."""


def check_scans(views: Views, n_scans: int) -> None:
    """ValueError unless the views were made for so many scans, at least one."""
    if check_count("n_scans", n_scans) > views.n_scans:
        raise ValueError(
            f"the views were made for {views.n_scans} scans of each robot, and {n_scans} are asked "
            "for: make views for those"
        )


def best_by_scan(
    scores: NDArray[np.int64], earliest: NDArray[np.int64], n_scans: int
) -> NDArray[np.int64]:
    """Highest score that each robot can have at each scan, (n_robots, n_scans); 0 if none."""
    best = np.zeros((len(earliest), n_scans), dtype=np.int64)
    for row, own in zip(best, earliest, strict=True):
        possible = own <= n_scans
        np.maximum.at(row, own[possible] - 1, scores[possible])
    return np.maximum.accumulate(best, axis=1)


class Certificate(NamedTuple):
    """Weights of the cells in a world; see the module."""

    weights: NDArray[np.uint16]
    """Shape (n_cells,), parts of `SCALE`; those of known cells do not count."""

    @classmethod
    def trivial(cls, n_cells: int) -> Certificate:
        """Each scan shows as much as the largest view, as if no cell was ever shown twice."""
        return cls(np.full(n_cells, SCALE, dtype=np.uint16))

    def bounds(self, views: Views, n_scans: int) -> NDArray[np.int64]:
        """Most cells that can be shown before the first scan and after each (n_scans + 1,).

        Raises
        ------
        ValueError
            If there is not one weight for each cell, one is not from 0 to `SCALE`, or there are
            more scans than the views were made for.
        """
        return np.minimum(self.evaluate(views, n_scans)[0], len(self.weights))

    def evaluate(self, views: Views, n_scans: int) -> tuple[NDArray[np.int64], ViewScores]:
        """Bounds that may be higher than the number of cells, and the best views by the weights."""
        known = views.known
        check_scans(views, n_scans)
        lowest, highest = self.weights.min(initial=0), self.weights.max(initial=0)
        in_range = self.weights.dtype.kind in "iu" and lowest >= 0 and highest <= SCALE
        if self.weights.shape != known.shape or not in_range:
            raise ValueError(
                f"a certificate needs {len(known)} weights from 0 to {SCALE}, got "
                f"{self.weights.dtype} {self.weights.shape} from {lowest} to {highest}"
            )
        weights = np.where(known, 0, self.weights).astype(np.int64)
        missed = int((SCALE - weights[~known]).sum())
        best = views.best(weights)
        gains = best_by_scan(best.scores, views.earliest, n_scans)
        total = missed + np.concatenate([[0], np.cumsum(gains.sum(axis=0))])
        return int(known.sum()) + total // SCALE, best
