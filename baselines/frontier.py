"""Frontiers: go where known free space borders on the unknown."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from coopmap_baselines.frontier_clusters import (
    frontier_clusters,
    frontier_poses,
    pose_towards,
    utility_of_poses,
)
from coopmap_baselines.planner import Coordination, Planner
from coopmap_env.core.settings import NonNegative, PositiveInt, checked_value
from coopmap_env.envs import Belief, Poses
from coopmap_env.information import ReservedMask

Utility = Literal["gain", "nearest"]


class FrontierPolicy(Planner):
    """The pose at a frontier that is expected to show most, or one at the nearest frontier.

    A frontier cell is a free cell with a never-sampled face neighbor (Yamauchi 1997, "A
    frontier-based approach for autonomous exploration"). A planar camera moves there, so the cell
    must be known to be free (P < 0.05). A field camera turns to it, for which P < 1/2 is enough.

    Parameters
    ----------
    utility : {"gain", "nearest"}
        "gain": frontier cells form clusters, of which small ones are dropped. Of the poses at all
        clusters (in the field: that see the middle of one) it goes to the one with the highest
        utility: the new cells that it is expected to show, as a fraction of a full view, minus
        weighted motion, divided by the number of actions that it takes to get there. Until it
        reaches a far one, it takes the poses near the path that are expected to show most. In
        "candidates" mode, the candidates take the place of the poses at near clusters.
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
        super().__init__("exhaustive", coordination)
        self.utility: Utility = checked_value("utility", utility, Utility)
        self.motion_weight: float = checked_value("motion_weight", motion_weight, NonNegative)
        self.min_cells: int = checked_value("min_cells", min_cells, PositiveInt)

    def best_pose(self, belief: Belief, robot: int, reserved_mask: ReservedMask | None) -> Any:
        """The best pose at a frontier, or nearer to it."""
        if self.utility == "nearest":
            return super().best_pose(belief, robot, reserved_mask)
        clusters = frontier_clusters(belief, robot, self.min_cells)
        poses, _ = frontier_poses(belief, robot, clusters)
        utility = utility_of_poses(belief, robot, poses, self.motion_weight, reserved_mask)
        return pose_towards(belief, robot, poses[np.argmax(utility)], reserved_mask)

    def score(
        self, belief: Belief, robot: int, poses: Poses, reserved_mask: ReservedMask | None
    ) -> NDArray[np.float64]:
        """Fraction of never-sampled cells in view at the nearest frontier; -1 elsewhere."""
        unknown = belief.unknown_fraction(robot, poses, reserved_mask)
        at_frontier = belief.planning.nearest_frontier_mask(belief, robot, poses, unknown > 0)
        return np.where(at_frontier, unknown, -1.0) if at_frontier.any() else unknown
