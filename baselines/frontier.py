"""Nearest frontier: go where known free space meets the unknown, and look at it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coopmap_env.envs.belief import Belief
from coopmap_env.robots import Reach

from .planner import Claimed, Coordination, Planner


class FrontierPolicy(Planner):
    """The nearest frontier cell by path, and the heading that shows the most unknown from there.

    A frontier cell is a reachable free cell with a never-sampled face neighbour (Yamauchi 1997, "A
    frontier-based approach for autonomous exploration"). Frontiers from which no heading shows a
    never-sampled cell are passed over.

    Parameters
    ----------
    coordination : {"independent", "sequential"}
        See `Planner`; claimed cells count as seen.
    """

    def __init__(self, coordination: Coordination = "independent") -> None:
        super().__init__("exhaustive", coordination)

    def candidates(self, belief: Belief, robot: int) -> NDArray[np.int64]:
        """All headings at the frontier cells, nearest first; everything feasible without one."""
        ids = super().candidates(belief, robot)
        if belief.offers is not None:  # these come in random order
            steps = Reach.search(belief.map, belief.cell(robot)).steps
            ids = ids[np.argsort(steps[ids // belief.lattice.n_headings], kind="stable")]
        cells = ids // belief.lattice.n_headings
        at_frontier = _next_to_unknown(belief)[cells]
        return ids[at_frontier] if at_frontier.any() else ids

    def score(
        self, belief: Belief, robot: int, ids: NDArray[np.int64], claimed: Claimed
    ) -> NDArray[np.float64]:
        """Unknown cells in view at the first cell that shows any; -1 elsewhere."""
        n = belief.lattice.n_headings
        unknown = belief.rating.unknown_cells(belief.map, ids, claimed).astype(np.float64)
        shows = unknown > 0
        if not shows.any():
            return unknown
        nearest = ids[np.argmax(shows)] // n
        return np.where(ids // n == nearest, unknown, -1.0)


def _next_to_unknown(belief: Belief) -> NDArray[np.bool_]:
    """Which cells have a never-sampled face neighbour, flat."""
    unknown = np.pad(~belief.map.sampled, 1)
    beside = unknown[:-2, 1:-1] | unknown[2:, 1:-1] | unknown[1:-1, :-2] | unknown[1:-1, 2:]
    return beside.ravel()
