"""Expected coverage: the pose that shows the most never-sampled cells for the least motion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coopmap_baselines.planner import GainPlanner
from coopmap_env.envs import Belief, Poses
from coopmap_env.information import ReservedMask


class CoveragePolicy(GainPlanner):
    """Never-sampled cells in view, as a fraction of the most a camera can see, minus motion.

    Parameters are those of `GainPlanner`.
    """

    def gain(
        self, belief: Belief, robot: int, poses: Poses, reserved_mask: ReservedMask | None
    ) -> NDArray[np.float64]:
        """See `Belief.unknown_fraction`."""
        return belief.unknown_fraction(robot, poses, reserved_mask)
