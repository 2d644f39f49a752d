"""Tours: a few viewpoints that cover what can be seen, visited on a short path."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from coopmap_baselines.planner import GainPlanner, Search
from coopmap_env.core.settings import Bounds, UnitInterval, checked_value
from coopmap_env.envs import Belief, Foresight, Observations, Poses
from coopmap_env.information import ReservedMask


class TourPolicy(GainPlanner):
    """Viewpoints that cover the frontier, in the order of a short tour; goes to the first of it.

    The robots take turns to choose viewpoints: each the pose with the highest gain minus weighted
    motion, beside all views that were chosen before (greedy set cover of the cells that are
    expected to be seen). So the team's viewpoints are split among its robots. Each robot orders its
    own by nearest insertion and 2-opt (a travelling salesman who does not return), and goes to the
    first. After the scan, all of it is planned again (Kompis et al. 2021, "Informed sampling
    exploration path planner", and others, plan such tours for one robot).

    Parameters
    ----------
    search : int or "exhaustive"
        See `Planner`.
    motion_weight : float
        Gain that is worth one unit of d (Eq. 5), where viewpoints are chosen.
    viewpoints : int
        The most viewpoints of a robot. With 1 there is nothing to order.
    least_gain : float
        No viewpoint is added whose gain is less than this part of that of the robot's first.
    """

    def __init__(
        self,
        search: Search = 300,
        motion_weight: float = 0.001,
        viewpoints: int = 4,
        least_gain: float = 0.7,
    ) -> None:
        super().__init__(search, "sequential", motion_weight)
        self.viewpoints: int = checked_value(
            "viewpoints", viewpoints, Annotated[int, Bounds(at_least=1, at_most=100)]
        )
        self.least_gain: float = checked_value("least_gain", least_gain, UnitInterval)

    def gain(
        self, belief: Belief, robot: int, poses: Poses, reserved_mask: ReservedMask | None
    ) -> NDArray[np.float64]:
        """See `Planning.expected_unknown_fraction`."""
        return belief.planning.expected_unknown_fraction(belief, robot, poses, reserved_mask)

    def act(self, belief: Belief, observations: Observations) -> dict[str, Any]:
        """The first viewpoint of each robot's tour, as actions."""
        poses = [self._screened_poses(belief, robot) for robot in range(len(belief.agents))]
        future = belief.planning.foresight(belief)
        chosen = self._choose_viewpoints(belief, poses, future)
        actions = {}
        for robot, agent in enumerate(belief.agents):
            own = poses[robot][chosen[robot]]
            from_here = belief.distance(robot, own)
            between = np.array([future.distance(robot, own, pose) for pose in own])
            first = shortest_tour(from_here, between)[0]
            actions[agent] = belief.action_for(robot, own[first])
        return actions

    def _screened_poses(self, belief: Belief, robot: int) -> Poses:
        def score(some_belief: Belief, poses: Poses) -> NDArray[np.float64]:
            return self.score(some_belief, robot, poses, None)

        return belief.planning.prescreen(belief, self.candidate_poses(belief, robot), score)

    def _choose_viewpoints(
        self, belief: Belief, poses: list[Poses], future: Foresight
    ) -> list[list[int]]:
        """Indices of each robot's viewpoints, at least one; `future` is that after all of them."""
        chosen: list[list[int]] = [[] for _ in poses]
        first_gain = np.zeros(len(poses))
        motion = [self.motion_weight * belief.distance(r, own) for r, own in enumerate(poses)]
        for turn in range(self.viewpoints):
            for robot, own in enumerate(poses):
                if len(chosen[robot]) < turn:
                    continue
                gain = future.gain(robot, own)
                best = int(np.argmax(gain - motion[robot]))
                if turn == 0:
                    first_gain[robot] = gain[best]
                elif not gain[best] > self.least_gain * first_gain[robot]:
                    continue
                chosen[robot].append(best)
                future.take(robot, own[best])
        return chosen


def shortest_tour(from_start: NDArray[np.float64], between: NDArray[np.float64]) -> list[int]:
    """A short path from a start through all of n points, which ends at any of them.

    Nearest insertion, then 2-opt until no exchange shortens the path.

    Parameters
    ----------
    from_start : ndarray, shape (n,)
        Distances from the start.
    between : ndarray, shape (n, n)
        Distances between the points, symmetric.

    Returns
    -------
    list of int
        The points in order.
    """
    n = len(from_start)
    lengths = np.zeros((n + 1, n + 1))
    lengths[1:, 1:] = between
    lengths[0, 1:] = lengths[1:, 0] = from_start
    tour, left = [0], set(range(1, n + 1))
    while left:
        nearest = min(left, key=lambda point: (min(lengths[point, at] for at in tour), point))
        left.remove(nearest)
        place = min(
            range(1, len(tour) + 1),
            key=lambda k: (_length(lengths, [*tour[:k], nearest, *tour[k:]]), k),
        )
        tour.insert(place, nearest)
    shorter = True
    while shorter:
        shorter = False
        for i in range(1, n):
            for j in range(i + 1, n + 1):
                turned = tour[:i] + tour[i : j + 1][::-1] + tour[j + 1 :]
                if _length(lengths, turned) < _length(lengths, tour) - 1e-9:
                    tour, shorter = turned, True
    return [point - 1 for point in tour[1:]]


def _length(lengths: NDArray[np.float64], tour: list[int]) -> float:
    return float(sum(lengths[a, b] for a, b in pairwise(tour)))
