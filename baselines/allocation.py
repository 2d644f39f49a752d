"""Allocation: each robot goes to another cluster of frontier cells, the cheapest for the team."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from coopmap_baselines.frontier_clusters import clusters_of_poses
from coopmap_baselines.planner import GainPlanner, Search
from coopmap_env.core.settings import PositiveInt, checked_value
from coopmap_env.envs import Belief, Observations, Poses
from coopmap_env.information import ReservedMask

OUT_OF_REACH = -1e6
"""Utility of a cluster to which no pose of a robot belongs."""


class AllocationPolicy(GainPlanner):
    """Clusters of frontier cells are assigned to robots by the Hungarian method.

    The utility of a cluster for a robot is the highest gain minus weighted motion of its poses
    there, as of `FrontierPolicy`. No two robots get the same cluster, and the sum of the utilities
    is the largest (Kuhn 1955; for frontiers: Faigl, Kulich & Preucil 2012, "Goal assignment using
    distance cost in multi-robot exploration"). Then the robots take, one after another, their best
    pose in their cluster, beside what the robots before them are about to see. Robots without a
    cluster take the best pose of all.

    Parameters
    ----------
    search : int or "exhaustive"
        See `Planner`.
    motion_weight : float
        Gain that is worth one unit of d (Eq. 5).
    min_cells : int
        Cells of the smallest cluster.
    """

    def __init__(
        self, search: Search = "exhaustive", motion_weight: float = 0.001, min_cells: int = 3
    ) -> None:
        super().__init__(search, "sequential", motion_weight)
        self.min_cells: int = checked_value("min_cells", min_cells, PositiveInt)

    def gain(
        self, belief: Belief, robot: int, poses: Poses, reserved_mask: ReservedMask | None
    ) -> NDArray[np.float64]:
        """See `Planning.expected_unknown_fraction`."""
        return belief.planning.expected_unknown_fraction(belief, robot, poses, reserved_mask)

    def act(self, belief: Belief, observations: Observations) -> dict[str, Any]:
        """Assign clusters, then choose the best pose of each robot, as actions."""
        robots = range(len(belief.agents))
        poses = [self._screened_poses(belief, robot) for robot in robots]
        found = [clusters_of_poses(belief, robot, poses[robot], self.min_cells) for robot in robots]
        clusters = _distinct_clusters(found)
        assigned = self._assign(belief, poses, clusters)
        reserved_mask = np.zeros(belief.map.grid.n_cells, dtype=np.uint8)
        actions = {}
        for robot, agent in enumerate(belief.agents):
            own = clusters[robot] == assigned[robot]
            choice = poses[robot][own] if own.any() else poses[robot]
            best = choice[np.argmax(self.score(belief, robot, choice, reserved_mask))]
            actions[agent] = belief.action_for(robot, best)
            reserved_mask[belief.visible_cells(robot, best)] = 1
        return actions

    def _screened_poses(self, belief: Belief, robot: int) -> Poses:
        def score(some_belief: Belief, poses: Poses) -> NDArray[np.float64]:
            return self.score(some_belief, robot, poses, None)

        return belief.planning.prescreen(belief, self.candidate_poses(belief, robot), score)

    def _assign(
        self, belief: Belief, poses: list[Poses], clusters: list[NDArray[np.int64]]
    ) -> NDArray[np.int64]:
        """The cluster of each robot; -1 for none."""
        n_clusters = max(int(of_poses.max(initial=0)) for of_poses in clusters)
        utility = np.full((len(poses), n_clusters + 1), OUT_OF_REACH)
        for robot, of_poses in enumerate(clusters):
            inside = of_poses > 0
            if inside.any():
                score = self.score(belief, robot, poses[robot][inside], None)
                np.maximum.at(utility[robot], of_poses[inside], score)
        assigned = np.full(len(poses), -1, dtype=np.int64)
        rows, columns = linear_sum_assignment(utility[:, 1:], maximize=True)
        for row, column in zip(rows, columns + 1, strict=True):
            if utility[row, column] > OUT_OF_REACH:
                assigned[row] = column
        return assigned


def _distinct_clusters(
    found: list[tuple[NDArray[np.int32], NDArray[np.int32]]],
) -> list[NDArray[np.int64]]:
    """Clusters of the poses of each robot, with other numbers where the maps are different ones."""
    clusters: list[NDArray[np.int64]] = []
    offsets: list[int] = []
    first = 0
    for labels, of_poses in found:
        same = [k for k in range(len(offsets)) if np.array_equal(found[k][0], labels)]
        offsets.append(offsets[same[0]] if same else first)
        first = max(first, offsets[-1] + int(labels.max(initial=0)))
        clusters.append(np.where(of_poses > 0, of_poses.astype(np.int64) + offsets[-1], 0))
    return clusters
