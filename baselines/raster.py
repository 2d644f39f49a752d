"""Raster scan: the next viewing position is the next of the available poses, in sequence."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coopmap_env.envs.belief import Belief

from .planner import Claimed, Planner


class RasterPolicy(Planner):
    """The feasible pose that follows the current one in raster order, around at the end.

    Poses are ordered cell by cell, row by row, and heading by heading in each cell: a camera that
    turns once around, then goes one cell further. The paper says no more than "selected
    sequentially from the available poses of the known environment".
    """

    def __init__(self) -> None:
        super().__init__("exhaustive", "independent")

    def score(
        self, belief: Belief, robot: int, ids: NDArray[np.int64], claimed: Claimed
    ) -> NDArray[np.float64]:
        """Minus the number of places to go in the sequence."""
        ahead = (ids - belief.pose_ids[robot] - 1) % belief.lattice.n_poses
        return -ahead.astype(np.float64)
