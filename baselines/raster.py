"""Raster scan: the next viewing position is the next of the available poses, in sequence."""

from __future__ import annotations

import numpy as np
from coopmap_baselines.planner import Planner
from numpy.typing import NDArray

from coopmap_env.envs.belief import Belief, Poses, ReservedMask


class RasterPolicy(Planner):
    """The feasible pose that follows the current one in raster order, around at the end.

    In the plane, poses are ordered cell by cell, row by row, and heading by heading in each cell: a
    camera that turns once around, then goes one cell further. In the field, a mount counts through
    its joints, the last one fastest. The paper says no more than "selected sequentially from the
    available poses of the known environment".
    """

    def __init__(self) -> None:
        super().__init__("exhaustive", "independent")

    def score(
        self, belief: Belief, robot: int, poses: Poses, reserved_mask: ReservedMask
    ) -> NDArray[np.float64]:
        """Minus the number of places to go in the sequence."""
        return -belief.raster_offset(robot, poses).astype(np.float64)
