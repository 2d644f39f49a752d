"""New information of many poses, kept from scan to scan.

A scan changes a few hundred cells, and the views of most poses contain none of them. So the
exhaustive search keeps the NI of every pose that it has rated, and after a scan rates only those
whose fan contains a cell that changed for Eq. 8: a cell sampled for the first time, or with another
gray bin. A fan's cells in one grid row are an interval, so "does the fan contain a changed cell" is
one subtraction of running sums per row. The result equals rating every pose again.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.kernels import kernel
from coopmap_env.information.planar.cell_codes import UNKNOWN, write_codes
from coopmap_env.information.planar.rating import PlanarRatingFunction
from coopmap_env.information.ratings import WHOLE_VIEW, ViewContext
from coopmap_env.mapping import OccupancyMap


class RowIntervals(NamedTuple):
    """The cells of a `BeamFan` by grid rows: those of heading h are ``start[h] : start[h + 1]``."""

    start: NDArray[np.int64]
    """Shape (n_headings + 1,)."""
    dx: NDArray[np.int64]
    """Row, from the camera's, (n_rows,)."""
    lowest: NDArray[np.int64]
    """Lowest dy of the row, (n_rows,)."""
    highest: NDArray[np.int64]


class ChangedCells(NamedTuple):
    """Cells that changed for Eq. 8, 1 or 0, (n_cells,)."""

    far: NDArray[np.uint8]
    """Cells that changed for views from any distance."""
    near: NDArray[np.uint8]
    """Only for views from less than two cells away, where Eq. 8a depends on the distance."""


class NewInformationCache:
    """NI of lattice poses on a map that changes; compares the map with its last state.

    Parameters
    ----------
    rating : PlanarRatingFunction
    """

    def __init__(self, rating: PlanarRatingFunction) -> None:
        self.rating = rating
        lattice, n_cells = rating.lattice, rating.lattice.grid.n_cells
        self._rows = _row_intervals(rating)
        self._ni = np.zeros(lattice.n_poses)
        self._cached = np.zeros(lattice.n_poses, dtype=np.uint8)
        self._codes = np.full(n_cells, UNKNOWN, dtype=np.uint8)
        self._changed = ChangedCells(*np.zeros((2, n_cells), dtype=np.uint8))
        self.n_rated = 0
        """Poses rated so far, for benchmarks: without the cache all of them would be rated."""

    def new_information(
        self, map_: OccupancyMap, poses: ArrayLike, context: ViewContext = WHOLE_VIEW
    ) -> NDArray[np.float64]:
        """As `PlanarRatingFunction.new_information`, shape (k,)."""
        ids = self.rating.validate_ids(map_, poses)
        self._invalidate_changed(map_)
        self._rate_missing(ids)
        ni = self._ni[ids]
        reserved = context.reserved_mask
        if reserved is not None and reserved.any():
            (affected,) = np.nonzero(self._affected(ids, ChangedCells(reserved, reserved)))
            ni[affected] = self.rating.new_information(map_, ids[affected], context)
            self.n_rated += len(affected)
        return ni

    def _invalidate_changed(self, map_: OccupancyMap) -> None:
        codes = np.empty_like(self._codes)
        table, arrays = self.rating.codes, map_.arrays
        write_codes(arrays.log_odds_fixed, arrays.sampled_mask, table.of_log_odds, codes)
        any_changed = find_changed_cells(
            codes, self._codes, table.bins, table.first_occupied, self._changed
        )
        self._codes = codes
        if any_changed:
            (cached,) = np.nonzero(self._cached)
            self._cached[cached[self._affected(cached, self._changed) != 0]] = 0

    def _rate_missing(self, ids: NDArray[np.int64]) -> None:
        missing = ids[self._cached[ids] == 0]
        self._ni[missing], _ = self.rating.evaluate_codes(self._codes, missing)
        self._cached[missing] = 1
        self.n_rated += len(missing)

    def _affected(self, ids: NDArray[np.int64], changed: ChangedCells) -> NDArray[np.uint8]:
        """1 for poses whose fan contains a changed cell, or whose 3 x 3 cells a near one."""
        nx, ny = self.rating.lattice.grid.shape
        sums = np.zeros((nx, ny + 1), dtype=np.int32)
        np.cumsum(changed.far.reshape(nx, ny), axis=1, out=sums[:, 1:])
        out = np.empty(len(ids), dtype=np.uint8)
        find_affected_poses(ids, sums, changed.near.reshape(nx, ny), self._rows, out)
        return out


def _row_intervals(rating: PlanarRatingFunction) -> RowIntervals:
    fan, start, rows = rating.fan, [0], []
    for h in range(fan.n_headings):
        offsets = fan.offsets[fan.start[h] : fan.start[h + 1]].astype(np.int64)
        for dx in np.unique(offsets[:, 0]):
            dy = offsets[offsets[:, 0] == dx, 1]
            rows.append((dx, dy.min(), dy.max()))
        start.append(len(rows))
    dx, lowest, highest = np.array(rows).T.copy()
    return RowIntervals(np.array(start), dx, lowest, highest)


@kernel
def find_changed_cells(
    codes: NDArray[np.uint8],
    old_codes: NDArray[np.uint8],
    bins: NDArray[np.uint16],
    first_occupied: int,
    changed: ChangedCells,
) -> bool:
    """Mark cells whose gray bin or occlusion changed; return if there are any.

    `bins` and `first_occupied` are those of the `CodeTable`.
    """
    far, near = changed.far, changed.near
    far_class = bins.shape[0] - 1
    found = False
    for cell in range(len(codes)):
        new, old = codes[cell], old_codes[cell]
        far[cell] = 0
        near[cell] = 0
        if new != old:
            occlusion_changed = (new >= first_occupied) != (old >= first_occupied)
            if new == UNKNOWN or old == UNKNOWN or occlusion_changed:
                far[cell] = 1
            far[cell] |= bins[far_class, new] != bins[far_class, old]
            for row in range(far_class + 1):
                near[cell] |= bins[row, new] != bins[row, old]
        found |= far[cell] != 0 or near[cell] != 0
    return found


@kernel
def find_affected_poses(
    ids: NDArray[np.int64],
    sums: NDArray[np.int32],
    near: NDArray[np.uint8],
    rows: RowIntervals,
    out: NDArray[np.uint8],
) -> None:
    """Write 1 for every pose whose fan contains a changed cell, or whose 3 x 3 cells a near one.

    `sums` (nx, ny + 1) are the running sums of the changed cells along y, `near` is (nx, ny).
    """
    nx, ny = near.shape
    start = rows.start
    n_headings = len(start) - 1
    for k in range(len(ids)):
        cell, heading = ids[k] // n_headings, ids[k] % n_headings
        x, y = cell // ny, cell % ny
        out[k] = 0
        for i in range(max(x - 1, 0), min(x + 2, nx)):
            for j in range(max(y - 1, 0), min(y + 2, ny)):
                out[k] |= near[i, j]
        for r in range(start[heading], start[heading + 1]):
            if out[k]:
                break
            i = x + rows.dx[r]
            if 0 <= i < nx:
                low, high = max(y + rows.lowest[r], 0), min(y + rows.highest[r] + 1, ny)
                if low < high and sums[i, high] > sums[i, low]:
                    out[k] = 1
