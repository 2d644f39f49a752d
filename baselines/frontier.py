"""Nearest frontier: go where known free space borders on the unknown."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coopmap_baselines.planner import Coordination, Planner
from coopmap_env.envs import Belief, Poses
from coopmap_env.information import ReservedMask


class FrontierPolicy(Planner):
    """The nearest frontier, and of the poses there the one that shows the most unknown.

    A frontier cell is a free cell with a never-sampled face neighbor (Yamauchi 1997, "A
    frontier-based approach for autonomous exploration"). A planar camera moves there, by the
    shortest path, so the cell must be known to be free (P < 0.05). A field camera turns to the
    frontier nearest to it, for which P < 1/2 is enough. Frontiers at which no pose shows a
    never-sampled cell are skipped.

    Parameters
    ----------
    coordination : {"independent", "sequential"}
        See `Planner`; reserved cells count as seen.
    """

    def __init__(self, coordination: Coordination = "independent") -> None:
        super().__init__("exhaustive", coordination)

    def score(
        self, belief: Belief, robot: int, poses: Poses, reserved_mask: ReservedMask | None
    ) -> NDArray[np.float64]:
        """Fraction of never-sampled cells in view at the nearest frontier; -1 elsewhere."""
        unknown = belief.unknown_fraction(robot, poses, reserved_mask)
        at_frontier = belief.planning.nearest_frontier_mask(belief, robot, poses, unknown > 0)
        return np.where(at_frontier, unknown, -1.0) if at_frontier.any() else unknown
