"""Frontiers: go where known free space borders on the unknown."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from coopmap_baselines.frontier_clusters import clusters_of_poses
from coopmap_baselines.planner import Coordination, GainPlanner
from coopmap_env.core.settings import PositiveInt, checked_value
from coopmap_env.envs import Belief, Poses
from coopmap_env.information import ReservedMask

Utility = Literal["gain", "nearest"]


class FrontierPolicy(GainPlanner):
    """The pose at a frontier that is worth its way most, or the one at the nearest frontier.

    A frontier cell is a free cell with a never-sampled face neighbor (Yamauchi 1997, "A
    frontier-based approach for autonomous exploration"). A planar camera moves there, so the cell
    must be known to be free (P < 0.05). A field camera turns to it, for which P < 1/2 is enough.

    Parameters
    ----------
    utility : {"gain", "nearest"}
        "gain": frontier cells form clusters, of which small ones are dropped. Of the poses in all
        clusters (in the field: that see the middle of one), the one with the highest gain minus
        motion: the new cells that it is expected to show, as a fraction of a full view (Gonzalez-
        Banos & Latombe 2002, "Navigation strategies for exploring indoor environments", with a
        difference in place of their exponential). Without a cluster, the same of any pose.
        "nearest": Yamauchi's. The frontier with the shortest path (in the field: nearest to the
        camera), and of the poses there the one that shows the most unknown. Frontiers at which no
        pose shows a never-sampled cell are skipped.
    coordination : {"independent", "sequential"}
        See `Planner`; reserved cells count as seen.
    motion_weight : float
        Gain that is worth one unit of d (Eq. 5); with "gain" only.
    min_cells : int
        Cells of the smallest cluster; with "gain" only.
    """

    def __init__(
        self,
        utility: Utility = "gain",
        coordination: Coordination = "independent",
        motion_weight: float = 0.001,
        min_cells: int = 3,
    ) -> None:
        super().__init__("exhaustive", coordination, motion_weight)
        self.utility: Utility = checked_value("utility", utility, Utility)
        self.min_cells: int = checked_value("min_cells", min_cells, PositiveInt)

    def gain(
        self, belief: Belief, robot: int, poses: Poses, reserved_mask: ReservedMask | None
    ) -> NDArray[np.float64]:
        """See `Planning.expected_unknown_fraction`."""
        return belief.planning.expected_unknown_fraction(belief, robot, poses, reserved_mask)

    def score(
        self, belief: Belief, robot: int, poses: Poses, reserved_mask: ReservedMask | None
    ) -> NDArray[np.float64]:
        """What each pose is worth, and less than any of them away from frontiers."""
        if self.utility == "nearest":
            return self._score_nearest(belief, robot, poses, reserved_mask)
        _, clusters = clusters_of_poses(belief, robot, poses, self.min_cells)
        at_frontier = clusters > 0
        if not at_frontier.any():
            return super().score(belief, robot, poses, reserved_mask)
        score = np.full(len(poses), -np.inf)
        score[at_frontier] = super().score(belief, robot, poses[at_frontier], reserved_mask)
        return score

    def _score_nearest(
        self, belief: Belief, robot: int, poses: Poses, reserved_mask: ReservedMask | None
    ) -> NDArray[np.float64]:
        """Fraction of never-sampled cells in view at the nearest frontier; -1 elsewhere."""
        unknown = belief.unknown_fraction(robot, poses, reserved_mask)
        at_frontier = belief.planning.nearest_frontier_mask(belief, robot, poses, unknown > 0)
        return np.where(at_frontier, unknown, -1.0) if at_frontier.any() else unknown
