"""Which cells the scans of planar worlds have truly shown, for scoring only."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coopmap_env.envs.planar._world_arrays import StepConstants, WorldArrays
from coopmap_env.simulation.shown_cells import mark_planar_scans


class ShownCells:
    """The cells of E worlds that are known from the start, or were shown since.

    Parameters
    ----------
    arrays : WorldArrays
    constants : StepConstants
    """

    def __init__(self, arrays: WorldArrays, constants: StepConstants) -> None:
        self._arrays = arrays
        nx, ny, _ = constants.grid.shape
        self._view = (nx, ny), arrays.pose_ids, tuple(constants.fan)
        self.mask: NDArray[np.uint8] = np.zeros(arrays.sampled_mask.shape, dtype=np.uint8)
        """1 at those cells, (E, n)."""
        self.counts: NDArray[np.int64] = np.zeros(len(self.mask), dtype=np.int64)
        """How many they are (E,)."""

    def start(self, worlds: NDArray[np.int64]) -> None:
        """Begin with what is known in worlds whose episodes start."""
        self.mask[worlds] = self._arrays.sampled_mask[worlds]
        self.counts[worlds] = self._arrays.n_observed[worlds]

    def add_scans(self, worlds: NDArray[np.int64]) -> None:
        """Add what the robots of some worlds have just scanned."""
        mark_planar_scans(worlds, self._arrays.occupied, *self._view, self.mask, self.counts)
