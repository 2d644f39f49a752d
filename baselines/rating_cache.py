"""New information of many poses, remembered from scan to scan.

A scan changes a few hundred cells; the views of most poses hold none of them and tell what they
told before. So the exhaustive search keeps the NI of every pose that it has rated, and after a scan
rates only those whose fan holds a cell that changed for Eq. 8: a cell sampled for the first time,
or come to another gray bin. A fan's cells in one grid row are an interval, so "does the fan hold a
changed cell" is one subtraction of running sums per row. The result equals rating every pose anew
(tested so).
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from coopmap_env.information import RatingFunction
from coopmap_env.mapping import OccupancyMap


class NewInformationCache:
    """NI of lattice poses on a map that changes; compares the map with what it saw last.

    Parameters
    ----------
    rating : RatingFunction
    """

    def __init__(self, rating: RatingFunction) -> None:
        self.rating = rating
        lattice = rating.lattice
        self._shape = lattice.grid.shape
        self._rows = _row_intervals(rating)
        self._ni = np.zeros(lattice.n_poses)
        self._cached = np.zeros(lattice.n_poses, dtype=np.uint8)
        self._log_odds_fixed = np.zeros(lattice.grid.n_cells, dtype=np.int32)
        self._sampled = np.zeros(lattice.grid.n_cells, dtype=np.uint8)
        self._changed = np.zeros(lattice.grid.n_cells, dtype=np.uint8)
        self._near = np.zeros(lattice.grid.n_cells, dtype=np.uint8)
        self.n_rated = 0
        """Poses rated so far, for benchmarks: brute force would have rated all of them."""

    def new_information(
        self, map_: OccupancyMap, ids: ArrayLike, reserved_mask: NDArray[np.uint8] | None = None
    ) -> NDArray[np.float64]:
        """As `RatingFunction.new_information`, shape (k,)."""
        ids = self.rating.validate_ids(map_, ids)
        self._invalidate_changed(map_)
        self._rate_missing(map_, ids)
        ni = self._ni[ids]
        if reserved_mask is not None and reserved_mask.any():
            (affected,) = np.nonzero(self._affected(ids, reserved_mask, reserved_mask))
            ni[affected] = self.rating.new_information(map_, ids[affected], reserved_mask)
            self.n_rated += len(affected)
        return ni

    def _invalidate_changed(self, map_: OccupancyMap) -> None:
        any_changed = find_changed_cells(
            map_.log_odds_fixed, map_.sampled_mask, self._log_odds_fixed, self._sampled,
            self.rating.gray.sampled, map_.log_odds_range.clamp, self._changed, self._near,
        )  # fmt: skip
        if any_changed:
            (cached,) = np.nonzero(self._cached)
            self._cached[cached[self._affected(cached, self._changed, self._near) != 0]] = 0

    def _rate_missing(self, map_: OccupancyMap, ids: NDArray[np.int64]) -> None:
        missing = ids[self._cached[ids] == 0]
        self._ni[missing] = self.rating.new_information(map_, missing)
        self._cached[missing] = 1
        self.n_rated += len(missing)

    def _affected(
        self, ids: NDArray[np.int64], changed: NDArray[np.uint8], near: NDArray[np.uint8]
    ) -> NDArray[np.uint8]:
        """1 for poses whose fan holds a changed cell, or whose own surroundings a near one."""
        nx, ny = self._shape
        sums = np.zeros((nx, ny + 1), dtype=np.int32)
        np.cumsum(changed.reshape(nx, ny), axis=1, out=sums[:, 1:])
        out = np.empty(len(ids), dtype=np.uint8)
        find_affected_poses(
            ids, sums, near.reshape(nx, ny), self.rating.fan.max_offset, *self._rows, out
        )
        return out


def _row_intervals(rating: RatingFunction) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows of every heading's fan: start (n_headings + 1,) and [dx, lowest dy, highest dy]."""
    fan, start, rows = rating.fan, [0], []
    for h in range(fan.n_headings):
        offsets = fan.offsets[fan.start[h] : fan.start[h + 1]].astype(np.int64)
        for dx in np.unique(offsets[:, 0]):
            dy = offsets[offsets[:, 0] == dx, 1]
            rows.append((dx, dy.min(), dy.max()))
        start.append(len(rows))
    return np.array(start), np.array(rows)


@njit(cache=True, nogil=True)
def find_changed_cells(
    log_odds_fixed, sampled, old_log_odds_fixed, old_sampled, table, clamp, changed, near
):
    """Mark cells whose gray bin or occlusion changed, and remember the map; say if there are any.

    `changed` concerns all views; `near` only those from less than two cells away, for which Eq. 8a
    tells levels apart that it treats alike from afar.
    """
    far_class = table.shape[0] - 1
    found = False
    for cell in range(len(log_odds_fixed)):
        changed[cell] = 0
        near[cell] = 0
        new, old = log_odds_fixed[cell], old_log_odds_fixed[cell]
        if sampled[cell] != old_sampled[cell]:
            changed[cell] = 1
            near[cell] = 1
        elif new != old and sampled[cell]:
            if (new >= 0) != (old >= 0):
                changed[cell] = 1
            for row in range(far_class + 1):
                if table[row, new + clamp] != table[row, old + clamp]:
                    near[cell] = 1
                    if row == far_class:
                        changed[cell] = 1
        old_log_odds_fixed[cell] = new
        old_sampled[cell] = sampled[cell]
        found |= changed[cell] != 0 or near[cell] != 0
    return found


@njit(cache=True, nogil=True)
def find_affected_poses(ids, sums, near, reach, start, rows, out):
    """Write 1 for every pose whose fan (by row intervals) or 3 x 3 surroundings hold a mark."""
    nx, ny = near.shape
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
            i = x + rows[r, 0]
            if 0 <= i < nx:
                low, high = max(y + rows[r, 1], 0), min(y + rows[r, 2] + 1, ny)
                if low < high and sums[i, high] > sums[i, low]:
                    out[k] = 1
