"""OccupancyMap: the team's probabilistic map, built from scans alone."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.caches import freeze
from coopmap_env.core.kernels import PlainTuple, make_plain
from coopmap_env.core.linear_algebra import are_finite
from coopmap_env.mapping.arrays import (
    MapArrays,
    MapStorage,
    SurfaceArrays,
    SurfaceIndex,
    UpdateBuffers,
)
from coopmap_env.mapping.beam import BeamModel
from coopmap_env.mapping.column_changes import ColumnChanges
from coopmap_env.mapping.grid import VoxelGrid
from coopmap_env.mapping.integration import (
    CAMERA_OUTSIDE_GRID,
    FusionArrays,
    assign_rows,
    clamp_log_odds,
    integrate_scan,
    validate_scan,
)
from coopmap_env.mapping.log_odds import STEPS_PER_NAT, LogOddsRange
from coopmap_env.mapping.occluders import ViewedMap, find_occluders, update_occluders
from coopmap_env.mapping.pooling import PooledMap
from coopmap_env.mapping.surfaces import check_surfaces, surface_gaussians
from coopmap_env.sensing import Scan

EXACT_POSE = freeze(np.zeros((6, 6)))
"""Covariance of a camera pose that is known exactly."""

FIRST_ROWS = 1_024
"""Rows of surfaces in a new map; they double when they are full."""


class ScanGain(NamedTuple):
    """What one scan added to the map, counted in the order of the scans."""

    new_cells: int
    """Cells sampled for the first time."""
    entropy_reduction: float
    """Nats, summed over the updated cells; negative where a scan contradicts the map."""


class OccupancyMap:
    """Per cell: occupancy probability, whether it was ever sampled, and a surface estimate.

    Parameters
    ----------
    grid : VoxelGrid
    model : BeamModel, optional
        The inverse sensor model.
    log_odds_range : LogOddsRange, optional
        The clamp, which belongs to the map, not to the sensor.
    storage : MapStorage, optional
        Arrays that become the map's own, with all that is in them; new ones by default.

    Notes
    -----
    A cell is *sampled* once a scan observed it (a beam passed or ended in it), or `mark_free` or
    `mark_occupied` marked it as known. All other cells are *unknown* (never sampled), and their P
    is 1/2. Eq. 8 tells them apart from sampled cells of the same P.

    Each cell is updated once per scan: the updates of the scan's beams are summed, bounded (see
    `BeamModel`), and added to the cell's log-odds. Where surfaces are partial, the strongest update
    of the scan counts instead of the sum. The scans of one `integrate` call may come in any order.
    """

    def __init__(
        self,
        grid: VoxelGrid,
        model: BeamModel | None = None,
        log_odds_range: LogOddsRange | None = None,
        storage: MapStorage | None = None,
    ) -> None:
        self.grid = grid
        self.model = model or BeamModel()
        self.log_odds_range = log_odds_range or LogOddsRange()
        n, averaged = grid.n_cells, self.model.surface_fusion == "mean"
        self._is_alone = storage is None
        if storage is None:
            surfaces = SurfaceArrays.empty(FIRST_ROWS, grid.dimension, averaged)
            storage = MapStorage(np.zeros(n, np.int32), np.zeros(n, np.uint8), surfaces)
        self.log_odds_fixed = storage.log_odds_fixed
        """Log-odds in fixed point, flat; see `log_odds`, and `cells_changed` after writing."""
        self.sampled_mask = storage.sampled_mask
        """1 where the cell is sampled, flat; see `sampled`, and `cells_changed` after writing."""
        self.arrays = MapArrays(
            self.log_odds_fixed, self.sampled_mask, grid.shape_3d, self.log_odds_range.clamp
        )
        """Occupancy for kernels; its arrays are those of the map."""
        self.surface_sums = storage.surfaces
        """Sums over the points of each hit cell, in rows; see `surfaces` and `surface_index`."""
        self._grid = tuple(grid.geometry)
        self._pooled: PooledMap | None = None
        self._viewed: ViewedMap | None = None
        self._changes: ColumnChanges | None = None
        self._n_sampled: int | None = None

    # A view of one of many worlds has a map that is never fused into: what only that needs is made
    # when it is first used.
    @cached_property
    def surface_index(self) -> SurfaceIndex:
        """Rows of `surface_sums` that the cells have."""
        n = self.grid.n_cells
        return SurfaceIndex.empty(n, FIRST_ROWS) if self._is_alone else SurfaceIndex.of_all(n)

    @cached_property
    def _buffers(self) -> UpdateBuffers:
        return UpdateBuffers.empty(self.grid.n_cells)

    @cached_property
    def _fusion(self) -> PlainTuple:
        """The arguments of `integrate_scan`, as they are now."""
        arrays = FusionArrays(
            self.grid.geometry,
            self.model.parameters,
            self._buffers,
            self.arrays,
            self.surface_sums,
            self.surface_index,
            self.log_odds_range.entropy,
        )
        return make_plain(arrays)

    def clear(self) -> None:
        """Reset all cells; cheaper than a new map."""
        self.cells_changed()
        known = np.flatnonzero(self.sampled_mask.view(np.bool_))
        self.log_odds_fixed[known] = self.sampled_mask[known] = 0
        rows, cells, n_rows = self.surface_index
        for sums in self.surface_sums:
            sums[: n_rows[0]] = 0.0
        if self._is_alone:
            rows[cells[: n_rows[0]]] = -1
            n_rows[0] = 0

    def integrate(self, scans: Scan | Sequence[Scan]) -> list[ScanGain]:
        """Fuse scans taken at the same time; the map does not depend on their order.

        Raises
        ------
        ValueError
            If a scan's dimension is not the map's, its camera is outside the grid, or a beam has
            a value that is not finite. Nothing is fused then.
        """
        scans = [scans] if isinstance(scans, Scan) else list(scans)
        valid_scans = [self._validate(scan) for scan in scans]
        gains, updated_cells = [], []
        for arrays, pose_covariance in valid_scans:
            self._reserve_rows(len(arrays[1]))
            count, new, reduction = integrate_scan(arrays, pose_covariance, self._fusion)
            gains.append(ScanGain(new, reduction))
            if self._n_sampled is not None:
                self._n_sampled += new
            updated_cells.append(self._buffers.updated_cells[:count].copy())
        for cells in updated_cells:
            clamp_log_odds(self.log_odds_fixed, cells, self.log_odds_range.clamp)
            if self._changes is not None:
                self._changes.add(cells)
            if self._viewed is not None:
                update_occluders(self.arrays, cells, self._viewed.occluders)
        if self._pooled is not None and updated_cells:
            self._pooled.update(np.concatenate(updated_cells))
        return gains

    def _validate(self, scan: Scan) -> tuple[PlainTuple, NDArray[np.float64]]:
        """The plain arrays of a scan that fits this map, and the covariance of its pose."""
        d = self.grid.dimension
        if scan.points.shape[1] != d:
            raise ValueError(f"a {scan.points.shape[1]}-D scan cannot enter a {d}-D map")
        arrays = (scan.origin, scan.points, scan.covariances, scan.hit)
        invalid_beam = validate_scan(arrays, self._grid)
        if invalid_beam == CAMERA_OUTSIDE_GRID:
            raise ValueError(f"camera at {scan.origin} is outside the map's grid {self.grid}")
        if invalid_beam >= 0:
            raise ValueError(
                f"beam {invalid_beam} of a scan has a value that is not finite: point "
                f"{scan.points[invalid_beam]}, covariance {scan.covariances[invalid_beam].tolist()}"
            )
        if scan.pose_covariance is None:
            return arrays, EXACT_POSE
        if not are_finite(np.ravel(scan.pose_covariance)):
            raise ValueError(f"pose_covariance must be finite, got {scan.pose_covariance.tolist()}")
        return arrays, scan.pose_covariance

    def mark_free(self, cells: ArrayLike) -> None:
        """Mark cells (flat indices) as known to be free, such as those of a robot's own body."""
        self._mark(cells, -self.log_odds_range.clamp)

    def mark_occupied(self, cells: ArrayLike) -> None:
        """Mark cells (flat indices) as known to be occupied, as after a collision."""
        self._mark(cells, self.log_odds_range.clamp)

    def _mark(self, cells: ArrayLike, log_odds_fixed: int) -> None:
        cells = np.asarray(cells)
        self.log_odds_fixed[cells] = log_odds_fixed
        self.sampled_mask[cells] = 1
        self.cells_changed()

    @property
    def pooled(self) -> MapArrays:
        """Occupancy at half the resolution, see `coopmap_env.mapping.pooling`; for reading."""
        return self.viewed(pooled=True).arrays

    def viewed(self, pooled: bool = False) -> ViewedMap:
        """Occupancy and the cells that occlude a view, of the map or pooled; for reading.

        It is made when it is first asked for, and then kept up to date by all methods; who writes
        to the arrays of the map calls `cells_changed`. On given arrays it is made each time.
        """
        if pooled:
            if self._pooled is None or not self._is_alone:
                self._pooled = PooledMap(self.arrays)
            return self._pooled.viewed
        if self._viewed is None or not self._is_alone:
            self._viewed = ViewedMap(self.arrays, find_occluders(self.arrays))
        return self._viewed

    def cells_changed(self) -> None:
        """Tell the map that any of its cells may have changed: after writing to its arrays."""
        self._pooled = self._viewed = self._n_sampled = None
        if self._changes is not None:
            self._changes.add_all()

    @property
    def changes(self) -> ColumnChanges:
        """Which columns of a 3-D map change from when this is first asked for; for reading.

        It is kept up to date as `viewed` is; on arrays that were given it is a new one each time.
        """
        if self._changes is None or not self._is_alone:
            self._changes = ColumnChanges(self.grid.shape_3d)
        return self._changes

    @property
    def log_odds(self) -> NDArray[np.float64]:
        """Log-odds of occupancy, nats, shape of the grid."""
        return self.log_odds_fixed.reshape(self.grid.shape) / STEPS_PER_NAT

    @property
    def probability(self) -> NDArray[np.float64]:
        """P(occupied) in (0, 1), one half where nothing is known, shape of the grid."""
        return self.log_odds_range.probability[
            self.log_odds_fixed + self.log_odds_range.clamp
        ].reshape(self.grid.shape)

    @property
    def sampled(self) -> NDArray[np.bool_]:
        """Cells that a scan observed or that were marked, whatever their P, shape of the grid."""
        return self.sampled_mask.astype(np.bool_).reshape(self.grid.shape)

    @property
    def entropy(self) -> float:
        """Sum of the cells' entropies (Eq. 6 of occupied and free), nats."""
        return float(
            self.log_odds_range.entropy[self.log_odds_fixed + self.log_odds_range.clamp].sum()
        )

    @property
    def observed_fraction(self) -> float:
        """Fraction of the grid's cells that are sampled."""
        if self._n_sampled is None or not self._is_alone:
            self._n_sampled = int(np.count_nonzero(self.sampled_mask.view(np.bool_)))
        return self._n_sampled / self.grid.n_cells

    @property
    def hit_cells(self) -> NDArray[np.int64]:
        """Flat indices of the cells in which at least one beam ended, ascending."""
        (n_rows,) = self.surface_index.n_rows
        has_points = self.surface_sums.precision[:n_rows, 0, 0] > 0.0
        return np.sort(self.surface_index.cells[: len(has_points)][has_points])

    def surfaces(
        self,
    ) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
        """Surface estimates of the hit cells: Eqs. 2 and 4, or means (`BeamModel.surface_fusion`).

        Returns
        -------
        cells : ndarray, shape (k,)
            Flat indices of the cells in which at least one beam ended.
        means : ndarray, shape (k, D)
            Merged surface points, metres.
        covariances : ndarray, shape (k, D, D)
            Their merged covariances, square metres.
        """
        cells = self.hit_cells
        rows = self.surface_index.rows[cells].astype(np.int64)
        deviations, covariances = surface_gaussians(self.surface_sums, rows)
        centers = self.grid.center(np.stack(np.unravel_index(cells, self.grid.shape), axis=-1))
        return cells, centers + deviations, covariances

    def hit_cell_sums(self) -> tuple[NDArray[np.int64], SurfaceArrays]:
        """The hit cells (k,) and their rows of `surface_sums`."""
        cells = self.hit_cells
        rows = self.surface_index.rows[cells]
        return cells, SurfaceArrays(*(a[rows] if len(a) else a for a in self.surface_sums))

    def surface_rows(self, cells: ArrayLike) -> NDArray[np.int64]:
        """Rows of `surface_sums` of different cells (k,); a cell that has none gets an empty one.

        `surface_sums` may be other arrays then.
        """
        cells = np.asarray(cells, dtype=np.int64)
        self._reserve_rows(len(cells))
        rows = np.empty(len(cells), dtype=np.int64)
        assign_rows(cells, self.surface_index, rows)
        return rows

    def _reserve_rows(self, n: int) -> None:
        """Make room for n new rows of surfaces, or for all cells."""
        rows, cells, n_rows = self.surface_index
        needed = min(int(n_rows[0]) + n, self.grid.n_cells)
        if needed <= len(cells):
            return
        added = min(max(needed, 2 * len(cells)), self.grid.n_cells) - len(cells)
        more = SurfaceArrays.empty(added, self.grid.dimension, self.surface_sums.averaged)
        pairs = zip(self.surface_sums, more, strict=True)
        self.surface_sums = SurfaceArrays(*map(np.concatenate, pairs))
        more_cells = np.empty(added, dtype=np.int64)
        self.surface_index = SurfaceIndex(rows, np.concatenate([cells, more_cells]), n_rows)
        self.__dict__.pop("_fusion", None)  # it holds the arrays from before

    def set_state(
        self, log_odds_fixed: ArrayLike, sampled: ArrayLike, cells: ArrayLike, sums: SurfaceArrays
    ) -> None:
        """Take over the state of a map of the same grid and model.

        `sums` are the rows of `cells`, as in `hit_cell_sums`.

        Raises
        ------
        ValueError
            If a shape or a value does not fit this map, which is then unchanged.
        """
        log_odds_fixed, sampled = np.asarray(log_odds_fixed), np.asarray(sampled)
        n = self.grid.n_cells
        if log_odds_fixed.shape != (n,) or sampled.shape != (n,):
            raise ValueError(
                f"a state of {n} cells cannot have the shapes {log_odds_fixed.shape} and "
                f"{sampled.shape}"
            )
        _check_occupancy(log_odds_fixed, sampled, self.log_odds_range.clamp)
        cells, sums = check_surfaces(cells, sums, self.surface_sums, sampled)
        self.clear()
        self.log_odds_fixed[:], self.sampled_mask[:] = log_odds_fixed, sampled
        rows = self.surface_rows(cells)
        for mine, theirs in zip(self.surface_sums, sums, strict=True):
            if len(mine):
                mine[rows] = theirs
        self.cells_changed()

    def copy(self) -> OccupancyMap:
        """An independent copy."""
        return copy.deepcopy(self)


def _check_occupancy(
    log_odds_fixed: NDArray[Any], sampled: NDArray[np.generic], clamp: int
) -> None:
    if any(array.dtype.kind not in "biu" for array in (log_odds_fixed, sampled)):
        raise ValueError("log_odds_fixed and sampled must be integers")
    if not (-clamp <= log_odds_fixed.min() <= log_odds_fixed.max() <= clamp):
        raise ValueError(f"log_odds_fixed must lie within +-{clamp}")
    if sampled.min() < 0 or sampled.max() > 1:
        raise ValueError("sampled must be 0 or 1")
    if log_odds_fixed[sampled == 0].any():
        raise ValueError("log_odds_fixed must be 0 where sampled is 0")
