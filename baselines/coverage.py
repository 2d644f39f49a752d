"""Expected coverage: the pose that shows the most never-sampled cells for the least motion."""

from __future__ import annotations

import numpy as np
from coopmap_baselines.planner import (
    Coordination,
    Planner,
    Search,
    check_motion_weight,
    subtract_motion_cost,
)
from numpy.typing import NDArray

from coopmap_env.envs import Belief, Poses, ReservedMask


class CoveragePolicy(Planner):
    """Never-sampled cells in view, as a fraction of the most a camera can see, minus motion.

    Parameters
    ----------
    search, coordination
        See `Planner`.
    motion_weight : float
        Fraction of a full view that a motion by one unit of d (Eq. 5) must bring. On training
        worlds the default has the best area under the coverage curve within a hundredth, with
        less motion than smaller weights.
    """

    def __init__(
        self,
        search: Search = 100,
        coordination: Coordination = "independent",
        motion_weight: float = 0.006,
    ) -> None:
        super().__init__(search, coordination)
        self.motion_weight = check_motion_weight(motion_weight)

    def score(
        self, belief: Belief, robot: int, poses: Poses, reserved_mask: ReservedMask
    ) -> NDArray[np.float64]:
        """Fraction of a full view that is never sampled, minus the weighted distance."""
        gain = belief.unknown_fraction(robot, poses, reserved_mask)
        return subtract_motion_cost(gain, belief, robot, poses, self.motion_weight)
