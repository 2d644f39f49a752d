"""Expected information gain: mutual information of the beams with the map, minus motion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coopmap_baselines.planner import Coordination, GainPlanner, Search
from coopmap_env.core.settings import OpenUnitInterval, checked_value
from coopmap_env.envs import Belief, Poses
from coopmap_env.information import ReservedMask


class InformationGainPolicy(GainPlanner):
    """Mutual information minus motion, as a fraction of a wholly unknown, unobstructed view's.

    Parameters
    ----------
    search, coordination, motion_weight
        See `GainPlanner`.
    prior : float, optional
        Occupancy expected of cells that were never sampled. By default the mean of training worlds:
        0.12 in the planar environment and 0.02, around the target, in the field environment.
    """

    def __init__(
        self,
        search: Search = 100,
        coordination: Coordination = "independent",
        motion_weight: float = 0.006,
        prior: float | None = None,
    ) -> None:
        super().__init__(search, coordination, motion_weight)
        self.prior: float | None = checked_value("prior", prior, OpenUnitInterval | None)

    def gain(
        self, belief: Belief, robot: int, poses: Poses, reserved_mask: ReservedMask | None
    ) -> NDArray[np.float64]:
        """See `Planning.mutual_information_fraction`."""
        prior = belief.planning.unknown_prior if self.prior is None else self.prior
        return belief.planning.mutual_information_fraction(
            belief, robot, poses, prior, reserved_mask
        )
