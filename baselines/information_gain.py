"""Expected information gain: mutual information of the beams with the map, minus motion."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from coopmap_env.envs.belief import Belief
from coopmap_env.information import BeamInformation

from .planner import Claimed, Coordination, Planner, Search
from .utility import checked_weight, minus_motion


class InformationGainPolicy(Planner):
    """Mutual information as a share of a full view's entropy N ln 2, minus motion.

    Parameters
    ----------
    search, coordination
        See `Planner`.
    motion_weight : float
        Share of a full view's entropy that a motion by one unit of d (Eq. 5) must bring.
    """

    def __init__(
        self,
        search: Search = 100,
        coordination: Coordination = "independent",
        motion_weight: float = 0.002,
    ) -> None:
        super().__init__(search, coordination)
        self.motion_weight = checked_weight(motion_weight)
        self._beams: BeamInformation | None = None
        self._rating: object = None

    def score(
        self, belief: Belief, robot: int, ids: NDArray[np.int64], claimed: Claimed
    ) -> NDArray[np.float64]:
        """Share of a full view's entropy, minus the weighted distance."""
        if self._beams is None or self._rating is not belief.rating:
            self._beams, self._rating = BeamInformation(belief.rating), belief.rating
        full_view = belief.rating.fan.n_visible * math.log(2.0)
        gain = self._beams.mutual_information(belief.map, ids, claimed) / full_view
        return minus_motion(gain, belief, robot, ids, self.motion_weight)
