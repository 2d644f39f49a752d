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
    """Sums over the points of cells, a row for each cell, from which its surface Gaussian is made.

    The first two have the form of information: the merged point is precision^-1 information_vector.
    With ``surface_fusion="mean"`` each point counts 1, and three more sums give the covariance of
    that mean; with "eq_4" they have no cells.
    """

    precision: NDArray[np.float64]
    """Eq. 4: sums of the points' inverse covariances (r, D, D). Mean: numbers of points
    (r, 1, 1)."""
    information_vector: NDArray[np.float64]
    """Eq. 4: sums of inverse covariance times deviation (r, D), the deviation being the point
    minus the cell's center. Mean: sums of deviations."""
    noise: NDArray[np.float64]
    """Mean: sums of the points' covariances (r, D, D)."""
    scatter: NDArray[np.float64]
    """Mean: sums of deviation times deviation, less the points' covariances (r, D, D)."""
    shared: NDArray[np.float64]
    """Mean: sums of the covariances that camera poses give to the points (r, D, D)."""

    @classmethod
    def empty(cls, n_rows: int, dimension: int, averaged: bool) -> SurfaceArrays:
        """Rows without points."""
        matrices, vectors = (n_rows, dimension, dimension), np.zeros((n_rows, dimension))
        if averaged:
            counts = np.zeros((n_rows, 1, 1))
            return cls(counts, vectors, *(np.zeros(matrices) for _ in range(3)))
        return cls.of_eq_4(np.zeros(matrices), vectors)

    @property
    def averaged(self) -> bool:
        """Whether the points of a cell are averaged, not merged by Eq. 4."""
        return self.precision.shape[1] < self.information_vector.shape[1]

    @classmethod
    def of_eq_4(
        cls, precision: NDArray[np.float64], information_vector: NDArray[np.float64]
    ) -> SurfaceArrays:
        """The sums of Eq. 4, (k, D, D) and (k, D)."""
        none = np.zeros((0, *precision.shape[1:]))
        return cls(precision, information_vector, none, none, none)


class SurfaceIndex(NamedTuple):
    """Which row of a `SurfaceArrays` belongs to which cell."""

    rows: NDArray[np.int32]
    """Row of each cell (n_cells,), -1 for none."""
    cells: NDArray[np.int64]
    """Cell of each row (r,)."""
    n_rows: NDArray[np.int64]
    """Rows in use, (1,)."""

    @classmethod
    def empty(cls, n_cells: int, n_rows: int) -> SurfaceIndex:
        """That of cells without rows, and of rows not in use."""
        rows, cells = np.full(n_cells, -1, dtype=np.int32), np.empty(n_rows, dtype=np.int64)
        return cls(rows, cells, np.zeros(1, dtype=np.int64))

    @classmethod
    def of_all(cls, n_cells: int) -> SurfaceIndex:
        """That of rows which belong to all cells, in their order."""
        cells = np.arange(n_cells, dtype=np.int64)
        return cls(cells.astype(np.int32), cells, np.array([n_cells], dtype=np.int64))


class MapStorage(NamedTuple):
    """The state of a map: what is kept of its cells."""

    log_odds_fixed: NDArray[np.int32]
    """Shape (n_cells,); see `MapArrays`."""
    sampled_mask: NDArray[np.uint8]
    """Shape (n_cells,)."""
    surfaces: SurfaceArrays
    """A row for each cell, or no rows where no surfaces are kept."""


class UpdateBuffers(NamedTuple):
    """Updates of one scan before they are added to the map."""

    pending: NDArray[np.int32]
    """Update of each cell in fixed point (n_cells,); zero between scans, never zero for the cells
    of a scan."""
    updated_cells: NDArray[np.int32]
    """Cells of the scan, once each, at the front of (n_cells + 1,)."""
    n_points: NDArray[np.int32]
    """Points of the scan in each row of a `SurfaceArrays`, (n_cells,); zero between scans."""

    @classmethod
    def empty(cls, n_cells: int) -> UpdateBuffers:
        """Those between two scans."""
        return cls(
            np.zeros(n_cells, dtype=np.int32),
            np.empty(n_cells + 1, dtype=np.int32),
            np.zeros(n_cells, dtype=np.int32),
        )
