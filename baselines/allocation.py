"""Allocation: each robot goes to another cluster of frontier cells, the best for the team."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_baselines.frontier_clusters import (
    frontier_clusters,
    frontier_poses,
    pose_towards,
    utility_of_poses,
)
from coopmap_env.core.settings import NonNegative, PositiveInt, checked_value
from coopmap_env.envs import Belief, Observations, Poses
from coopmap_env.information import ReservedMask

NO_POSE = -1e6
"""Utility of a cluster to which no pose of a robot belongs."""


class Options(NamedTuple):
    """Where a robot may go."""

    poses: Poses
    clusters: NDArray[np.int64]
    """Number of the cluster of each pose (k,), 0 for none: the same for all robots with one map."""


class AllocationPolicy:
    """Clusters of frontier cells are assigned to robots by the Hungarian method.

    The utility of a cluster for a robot is the highest of its poses there, as of `FrontierPolicy`.
    No two robots get the same cluster, and the sum of the utilities is the largest (Kuhn 1955; for
    frontiers: Faigl, Kulich & Preucil 2012, "Goal assignment using distance cost in multi-robot
    exploration"). Then the robots choose, one after another, their best pose in their cluster,
    beside what the robots before them are about to see. Robots without a cluster choose among all
    poses.

    Parameters
    ----------
    motion_weight : float
        Gain that is worth one unit of d (Eq. 5).
    min_cells : int
        Cells of the smallest cluster.

    Raises
    ------
    ValueError
        If an option is outside of its range.
    """

    def __init__(self, motion_weight: float = 0.001, min_cells: int = 3) -> None:
        self.motion_weight: float = checked_value("motion_weight", motion_weight, NonNegative)
        self.min_cells: int = checked_value("min_cells", min_cells, PositiveInt)

    def reset(self, rng: np.random.Generator) -> None:
        """Start an episode; nothing is random."""

    def act(self, belief: Belief, observations: Observations) -> dict[str, Any]:
        """Assign clusters, then choose the best pose of each robot, as actions."""
        reserved_mask = np.zeros(belief.map.grid.n_cells, dtype=np.uint8)
        options = self._options(belief)
        assigned = self._assign(belief, options)
        actions = {}
        for robot, agent in enumerate(belief.agents):
            poses, clusters = options[robot]
            inside = clusters == assigned[robot]
            poses = poses[inside] if inside.any() else poses
            utility = self._utility(belief, robot, poses, reserved_mask)
            best = pose_towards(belief, robot, poses[np.argmax(utility)], reserved_mask)
            actions[agent] = belief.action_for(robot, best)
            reserved_mask[belief.visible_cells(robot, best)] = 1
        return actions

    def _options(self, belief: Belief) -> list[Options]:
        """The poses of each robot and their clusters."""
        options: list[Options] = []
        maps: list[NDArray[np.int32]] = []
        first = [0]
        for robot in range(len(belief.agents)):
            found = frontier_clusters(belief, robot, self.min_cells)
            same = [k for k, known in enumerate(maps) if np.array_equal(known, found)]
            if not same:
                maps.append(found)
                first.append(first[-1] + int(found.max(initial=0)))
            offset = first[same[0] if same else len(maps) - 1]
            poses, numbers = frontier_poses(belief, robot, found)
            options.append(Options(poses, np.where(numbers > 0, numbers + np.int64(offset), 0)))
        return options

    def _assign(self, belief: Belief, options: list[Options]) -> NDArray[np.int64]:
        """The cluster of each robot; -1 for none."""
        from scipy.optimize import linear_sum_assignment  # half a second, seldom needed

        n_clusters = max(int(clusters.max(initial=0)) for _, clusters in options)
        utility = np.full((len(options), n_clusters + 1), NO_POSE)
        for robot, (poses, clusters) in enumerate(options):
            each = self._utility(belief, robot, poses, None)
            np.maximum.at(utility[robot], clusters, each)
        assigned = np.full(len(options), -1, dtype=np.int64)
        for robot, column in zip(
            *linear_sum_assignment(utility[:, 1:], maximize=True), strict=True
        ):
            if utility[robot, column + 1] > NO_POSE:
                assigned[robot] = column + 1
        return assigned

    def _utility(
        self, belief: Belief, robot: int, poses: Poses, reserved_mask: ReservedMask | None
    ) -> NDArray[np.float64]:
        return utility_of_poses(belief, robot, poses, self.motion_weight, reserved_mask)
