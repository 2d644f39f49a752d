"""The arrays of an occupancy map, as kernels take them; all are flat (row-major) over the cells."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class MapArrays(NamedTuple):
    """Occupancy of the cells."""

    log_odds_fixed: NDArray[np.int32]
    """Log-odds in fixed point (n_cells,); see `log_odds`."""
    sampled_mask: NDArray[np.uint8]
    """1 where the cell is sampled (n_cells,); see `OccupancyMap`."""
    shape: tuple[int, int, int]
    """Cells along x, y, z; a planar grid is one layer."""
    clamp: int
    """Highest log-odds in fixed point; the lowest is its negative."""


class SurfaceArrays(NamedTuple):
    """Surface estimates of the cells in information form, where merging is a sum."""

    precision: NDArray[np.float64]
    """Sums of the points' inverse covariances (n_cells, D, D)."""
    information_vector: NDArray[np.float64]
    """Sums of inverse covariance times (point minus the cell's center) (n_cells, D)."""


class UpdateBuffers(NamedTuple):
    """Updates of one scan before they are added to the map."""

    pending: NDArray[np.int32]
    """Update of each cell in fixed point (n_cells,); zero between scans, never zero for the cells
    of a scan."""
    updated_cells: NDArray[np.int64]
    """Cells of the scan, once each, at the front of (n_cells + 1,)."""
