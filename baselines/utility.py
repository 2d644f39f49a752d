"""A gain weighed against the motion that it takes."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from coopmap_env.envs.belief import Belief, Poses


def subtract_motion_cost(
    gain: NDArray[np.float64], belief: Belief, robot: int, poses: Poses, weight: float
) -> NDArray[np.float64]:
    """`gain` (k,) minus `weight` times the distance (Eq. 5) from the robot's pose."""
    return gain - weight * belief.distance(robot, poses)


def check_motion_weight(weight: float) -> float:
    """Return the weight of the motion, or raise ValueError with it."""
    if not isinstance(weight, int | float) or not (math.isfinite(weight) and weight >= 0):
        raise ValueError(f"motion_weight must be finite and >= 0, got {weight!r}")
    return weight
