"""The reference planner of Sujan & Dubowsky: the pose of the highest rating (Eq. 9)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coopmap_baselines.planner import Coordination, Planner, Search
from coopmap_env.envs import Belief, Poses
from coopmap_env.information import ReservedMask


class RatingFunctionPolicy(Planner):
    """Rates poses by Eq. 9 with the constants of the environment.

    Parameters
    ----------
    search : int or "exhaustive"
        m of the paper's random search, or the whole known configuration space.
    coordination : {"independent", "sequential"}
        See `Planner`. With "sequential" and an exhaustive search, each robot's pose maximises the
        reward "rating" of the environment, given the poses of the robots before it.
    """

    def __init__(self, search: Search = 100, coordination: Coordination = "independent") -> None:
        super().__init__(search, coordination)

    def score(
        self, belief: Belief, robot: int, poses: Poses, reserved_mask: ReservedMask | None
    ) -> NDArray[np.float64]:
        """RF of each pose (Eq. 9)."""
        if self.search == "exhaustive":
            return belief.planning.rate_all(belief, robot, poses, reserved_mask).rating
        return belief.rate(robot, poses, reserved_mask).rating
