"""The plain constant hit/miss map that the Gaussian beam model is compared with.

The common occupancy-grid model (Moravec & Elfes 1985; OctoMap's form): in each scan a cell in which
a beam ends gets one constant, a cell that beams only pass through gets another. It knows nothing of
the range's uncertainty.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from coopmap_env.geometry.traversal import init_axis, step_voxel
from coopmap_env.mapping import LogOddsRange, VoxelGrid
from coopmap_env.mapping.log_odds import to_log_odds_fixed
from coopmap_env.sensing import Scan


@dataclass(frozen=True)
class HitMissModel:
    """The two constants; the defaults are those of the best log-loss on training worlds."""

    hit: float = 0.9
    """Occupancy that a scan claims for a cell in which a beam ends."""
    miss: float = 0.005
    """Occupancy that a scan claims for a cell that beams only pass."""
    hit_offset: float = 0.5
    """Cells behind the observed point where the hit is entered. Where cells are the obstacles, a
    surface lies between two cells and half a cell tells which is meant, so that the comparison
    is fair; 0 where surfaces lie inside of cells."""

    def __post_init__(self) -> None:
        if not 0 < self.miss < 0.5 < self.hit < 1:
            raise ValueError(f"need 0 < miss < 0.5 < hit < 1, got {self.miss}, {self.hit}")


class HitMissMap:
    """A planar occupancy map with constant updates, each cell once per scan, hits first."""

    def __init__(
        self,
        grid: VoxelGrid,
        model: HitMissModel | None = None,
        log_odds_range: LogOddsRange | None = None,
    ) -> None:
        self.grid = grid
        self.model = model or HitMissModel()
        self.log_odds_range = log_odds_range or LogOddsRange()
        self._log_odds_fixed = np.zeros(grid.n_cells, dtype=np.int32)
        self._sampled = np.zeros(grid.n_cells, dtype=np.uint8)
        self._cell_marks = np.zeros(grid.n_cells, dtype=np.uint8)
        self._scan_cells = np.empty(grid.n_cells, dtype=np.int64)

    def integrate(self, scans: Scan | Sequence[Scan]) -> None:
        """Fuse scans one by one."""
        for scan in [scans] if isinstance(scans, Scan) else scans:
            _integrate(
                self.grid.to_cell_units(scan.origin), self.grid.to_cell_units(scan.points), scan.hit,
                self.grid.shape, to_log_odds_fixed(self.model.hit), to_log_odds_fixed(self.model.miss),
                float(self.model.hit_offset), self.log_odds_range.clamp, self._log_odds_fixed, self._sampled, self._cell_marks,
                self._scan_cells,
            )  # fmt: skip

    @property
    def probability(self) -> NDArray[np.float64]:
        """P(occupied), shape of the grid."""
        return self.log_odds_range.probability[
            self._log_odds_fixed + self.log_odds_range.clamp
        ].reshape(self.grid.shape)

    @property
    def sampled(self) -> NDArray[np.bool_]:
        """Where a scan ever told something, shape of the grid."""
        return self._sampled.astype(np.bool_).reshape(self.grid.shape)


@njit(cache=True, nogil=True)
def _integrate(
    origin,
    points,
    hit,
    shape,
    hit_update,
    miss_update,
    hit_offset,
    clamp,
    log_odds_fixed,
    sampled,
    cell_marks,
    scan_cells,
):
    """Mark the scan's cells (1 passed, 2 hit) and list them, then update each once."""
    nx, ny = shape
    count = 0
    for beam in range(len(points)):
        ux, uy = points[beam, 0] - origin[0], points[beam, 1] - origin[1]
        length = np.sqrt(ux * ux + uy * uy)
        if length == 0.0:
            continue
        cx, sx, tx, dx, end_x = init_axis(origin[0], ux / length, nx, ny)
        cy, sy, ty, dy, end_y = init_axis(origin[1], uy / length, ny, 1)
        cell = cx + cy
        if hit[beam]:
            length += hit_offset
        end = min(length, end_x, end_y)
        t = 0.0
        last = -1
        while t < end:
            if cell_marks[cell] == 0:
                cell_marks[cell] = 1
                scan_cells[count] = cell
                count += 1
            last = cell
            cell, tx, ty, _, t = step_voxel(cell, sx, sy, 0, tx, ty, np.inf, dx, dy, np.inf)
        if hit[beam] and t >= length and last >= 0:
            cell_marks[last] = 2
    for k in range(count):  # not all cells: a scan sees few of a large map
        cell = scan_cells[k]
        update = hit_update if cell_marks[cell] == 2 else miss_update
        log_odds_fixed[cell] = min(max(log_odds_fixed[cell] + update, -clamp), clamp)
        sampled[cell] = 1
        cell_marks[cell] = 0
