"""The reference planner of Sujan & Dubowsky: the pose of the highest rating (Eq. 9)."""

from __future__ import annotations

import numpy as np
from coopmap_baselines.planner import Coordination, Planner, Search
from coopmap_baselines.rating_cache import NewInformationCache
from numpy.typing import NDArray

from coopmap_env.envs.belief import Belief, Poses, ReservedMask
from coopmap_env.envs.planar.belief import PlanarBelief


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
        self._cache: NewInformationCache | None = None

    def score(
        self, belief: Belief, robot: int, poses: Poses, reserved_mask: ReservedMask
    ) -> NDArray[np.float64]:
        """RF of each pose (Eq. 9)."""
        if self.search != "exhaustive" or not isinstance(belief, PlanarBelief):
            return belief.rate(robot, poses, reserved_mask).rating
        rating = belief.rating
        if self._cache is None or self._cache.rating is not rating:
            self._cache = NewInformationCache(rating)
        ni = self._cache.new_information(belief.map, poses, reserved_mask)
        return rating.rate_from_information(belief.map, poses, [belief.pose_ids[robot]], ni).rating
