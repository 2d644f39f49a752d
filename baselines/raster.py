"""Raster scan: the next viewing position is the next of the available poses, in sequence."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coopmap_baselines.planner import Planner
from coopmap_env.envs import Belief, Poses
from coopmap_env.information import ReservedMask


class RasterPolicy(Planner):
    """The feasible pose that follows the current one in raster order, starting again at the end.

    Planar poses are ordered cell by cell, row by row, and heading by heading in each cell: a camera
    turns once around, then moves one cell. Field poses are ordered by the joints of the mount, the
    last one fastest. The paper says no more than "selected sequentially from the
    available poses of the known environment".
    """

    def __init__(self) -> None:
        super().__init__("exhaustive", "independent")

    def score(
        self, belief: Belief, robot: int, poses: Poses, reserved_mask: ReservedMask | None
    ) -> NDArray[np.float64]:
        """Minus the number of steps to the pose in the sequence."""
        return -belief.planning.raster_offset(belief, robot, poses).astype(np.float64)
