"""A map with constant hit and miss updates, which the Gaussian beam model is compared with.

This is the common occupancy-grid model (Moravec & Elfes 1985; OctoMap's form). In each scan, a cell
in which a beam ends gets one constant, and a cell that beams only cross gets another. The model
does not know the uncertainty of the range.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import kernel
from coopmap_env.core.settings import NonNegative, OpenUnitInterval, Settings
from coopmap_env.geometry import start_ray, step_ray
from coopmap_env.mapping import LogOddsRange, VoxelGrid, to_log_odds_fixed
from coopmap_env.sensing import Scan


@dataclass(frozen=True)
class HitMissModel(Settings):
    """The two constants; the defaults have the lowest log-loss on training worlds."""

    hit: OpenUnitInterval = 0.8
    """Occupancy that one scan gives to a cell in which a beam ends, above 1/2."""
    miss: OpenUnitInterval = 0.005
    """Occupancy that one scan gives to a cell that beams only cross, below 1/2."""
    hit_offset: NonNegative = 0.5
    """Distance behind the observed point at which the hit is entered, in cells. Where whole cells
    are obstacles, a surface lies between two cells; half a cell selects the occupied one, which
    makes the comparison fair. 0 where surfaces lie inside cells."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.miss < 0.5 < self.hit:
            raise ValueError(
                f"HitMissModel needs miss < 0.5 < hit, got miss {self.miss} and hit {self.hit}"
            )


HIT_MISS_LOG_ODDS_RANGE = LogOddsRange(0.9999)
"""Clamp of the lowest log-loss on training worlds."""


class ConstantUpdate(NamedTuple):
    """The update of one scan, as the kernel takes it."""

    hit: int
    """Log-odds in fixed point of a cell in which a beam ends."""
    miss: int
    """Log-odds in fixed point of a cell that beams only cross."""
    hit_offset: float
    """Cells."""
    clamp: int
    """Highest log-odds in fixed point; the lowest is its negative."""


class HitMissArrays(NamedTuple):
    """The map's arrays and the working memory of one scan, all flat (n_cells,)."""

    log_odds_fixed: NDArray[np.int32]
    sampled_mask: NDArray[np.uint8]
    marks: NDArray[np.uint8]
    """0 between scans; in a scan, 1 for crossed cells and 2 for hit cells."""
    scan_cells: NDArray[np.int64]
    """Cells that the scan marked, in order."""


class HitMissMap:
    """A planar occupancy map with constant updates; each cell is updated once per scan, hits first.

    Parameters
    ----------
    grid : VoxelGrid
        Two-dimensional.
    model : HitMissModel, optional
    log_odds_range : LogOddsRange, optional
    """

    def __init__(
        self,
        grid: VoxelGrid,
        model: HitMissModel | None = None,
        log_odds_range: LogOddsRange | None = None,
    ) -> None:
        self.grid = grid
        self.model = model or HitMissModel()
        self.log_odds_range = log_odds_range or LogOddsRange()
        self._shape = (grid.shape[0], grid.shape[1])
        self._update = ConstantUpdate(
            to_log_odds_fixed(self.model.hit),
            to_log_odds_fixed(self.model.miss),
            float(self.model.hit_offset),
            self.log_odds_range.clamp,
        )
        self._arrays = HitMissArrays(
            log_odds_fixed=np.zeros(grid.n_cells, dtype=np.int32),
            sampled_mask=np.zeros(grid.n_cells, dtype=np.uint8),
            marks=np.zeros(grid.n_cells, dtype=np.uint8),
            scan_cells=np.empty(grid.n_cells, dtype=np.int64),
        )

    def integrate(self, scans: Scan | Sequence[Scan]) -> None:
        """Fuse scans one by one."""
        for scan in [scans] if isinstance(scans, Scan) else scans:
            origin, points = (
                self.grid.to_cell_units(scan.origin),
                self.grid.to_cell_units(scan.points),
            )
            _integrate(origin, points, scan.hit, self._shape, self._update, self._arrays)

    @property
    def probability(self) -> NDArray[np.float64]:
        """P(occupied), shape of the grid."""
        index = self._arrays.log_odds_fixed + self.log_odds_range.clamp
        return self.log_odds_range.probability[index].reshape(self.grid.shape)

    @property
    def sampled(self) -> NDArray[np.bool_]:
        """Cells that at least one scan observed, shape of the grid."""
        return self._arrays.sampled_mask.astype(np.bool_).reshape(self.grid.shape)


@kernel
def _integrate(
    origin: NDArray[np.float64],
    points: NDArray[np.float64],
    hit: NDArray[np.bool_],
    shape: tuple[int, int],
    update: ConstantUpdate,
    arrays: HitMissArrays,
) -> None:
    """Mark and list the cells of a scan, then update each of them once."""
    log_odds_fixed, sampled_mask, marks, scan_cells = arrays
    nx, ny = shape
    count = 0
    for beam in range(len(points)):
        ux, uy = points[beam, 0] - origin[0], points[beam, 1] - origin[1]
        length = np.sqrt(ux * ux + uy * uy)
        if length == 0.0:
            continue
        direction = (ux / length, uy / length, 0.0)
        ray, position = start_ray((origin[0], origin[1], 0.5), direction, (nx, ny, 1))
        if hit[beam]:
            length += update.hit_offset
        end = min(length, ray.end)
        last = -1
        while position.distance < end:
            last = position.cell
            if marks[last] == 0:
                marks[last] = 1
                scan_cells[count] = last
                count += 1
            position = step_ray(ray, position)
        if hit[beam] and position.distance >= length and last >= 0:
            marks[last] = 2
    for k in range(count):  # only the listed cells: a scan crosses few cells of a large map
        cell = scan_cells[k]
        change = update.hit if marks[cell] == 2 else update.miss
        level = log_odds_fixed[cell] + change
        log_odds_fixed[cell] = min(max(level, -update.clamp), update.clamp)
        sampled_mask[cell] = 1
        marks[cell] = 0
