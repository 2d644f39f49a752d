"""The reference planner of Sujan & Dubowsky: the pose of the highest rating (Eq. 9)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from coopmap_baselines.planner import Coordination, Planner, Search
from coopmap_env.core.settings import NonNegative, checked_value
from coopmap_env.envs import Belief, Poses
from coopmap_env.information import Ratings, ReservedMask


class RatingFunctionPolicy(Planner):
    """Rates poses by Eq. 9 with the constants of the environment.

    Parameters
    ----------
    search : int or "exhaustive"
        m of the paper's random search, or the whole known configuration space.
    coordination : {"independent", "sequential"}
        See `Planner`. With "sequential" and an exhaustive search, each robot's pose maximises the
        reward "rating" of the environment, given the poses of the robots before it.
    motion_weight : float, optional
        K of Eq. 9, nats per unit of d**n. By default that of the environment; 0 makes the planner
        an opponent of policies whose reward does not pay for motion.
    """

    def __init__(
        self,
        search: Search = 100,
        coordination: Coordination = "independent",
        motion_weight: float | None = None,
    ) -> None:
        super().__init__(search, coordination)
        self.motion_weight: float | None = checked_value(
            "motion_weight", motion_weight, NonNegative | None
        )

    def score(
        self, belief: Belief, robot: int, poses: Poses, reserved_mask: ReservedMask | None
    ) -> NDArray[np.float64]:
        """RF of each pose (Eq. 9)."""
        if self.search == "exhaustive":
            rated = belief.planning.rate_all(belief, robot, poses, reserved_mask)
        else:
            rated = belief.rate(robot, poses, reserved_mask)
        if self.motion_weight is None:
            return rated.rating
        constants = replace(belief.rating_settings, K=self.motion_weight)
        return Ratings.from_terms(
            rated.new_information, rated.distance, rated.occupancy, constants
        ).rating
