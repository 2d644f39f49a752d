"""A gain weighed against the motion that it takes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coopmap_env.envs.belief import Belief


def minus_motion(
    gain: NDArray[np.float64], belief: Belief, robot: int, ids: NDArray[np.int64], weight: float
) -> NDArray[np.float64]:
    """`gain` (k,) minus `weight` times the distance (Eq. 5) from the robot's pose."""
    rated = belief.rating.compose(belief.map, ids, [belief.pose_ids[robot]], gain)
    return gain - weight * rated.distance
