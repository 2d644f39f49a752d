"""How well a map shows the true surface.

=================  =====================================================================
score              meaning, 1 is best unless a unit is given
=================  =====================================================================
coverage           share of the reachable surface with an occupied voxel next to it
target coverage    the same of the target alone
precision          share of the map's points that lie within tau of the true surface
recall             share of the reachable surface that lies within tau of a map point
F-score            their harmonic mean
Chamfer distance   metres, best 0: mean of both mean distances, uncapped
=================  =====================================================================

A map point is the merged surface mean (Eqs. 2 and 4) of a voxel with P > ½. Precision asks for the
exact distance to all true triangles inside of the grid, reachable or not. Recall and coverage ask
at samples of the reachable surface (`evaluation.surface_reach`), and so tell what the policy
missed, not what nobody could have seen. A sample counts as covered within one voxel, so that one
side of a plate thinner than that covers the other.

tau is one voxel: the map claims no finer detail than that a surface runs through a voxel, whose
next point is at most that far away in a flat piece; and it is what coverage allows as well.

An empty map has precision, recall and F-score 0, and the worst Chamfer distance that there is: the
diagonal of the grid. Where nothing is reachable, coverage, recall, F-score and Chamfer distance are
NaN: there is nothing to be scored.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from coopmap_env.evaluation.metrics.triangle_distance import TriangleBins
from coopmap_env.mapping import OccupancyMap, VoxelGrid


@dataclass(frozen=True)
class SurfaceScores:
    """A map against the true surface; see the module."""

    coverage: float
    """Share of the reachable surface."""
    target_coverage: float
    """Share of the target's reachable surface."""
    f_score: float
    precision: float
    """Share of the map's points."""
    recall: float
    """Share of the reachable surface."""
    chamfer: float
    """Metres."""


@dataclass(frozen=True, eq=False)
class SampleVoxels:
    """The voxels of surface samples, each once, for asking again and again which are covered."""

    cells: NDArray[np.int64]
    """Shape (u,): flat numbers."""
    counts: NDArray[np.int64]
    """Shape (u,): samples in each."""
    grid: VoxelGrid

    @classmethod
    def from_points(cls, points: ArrayLike, grid: VoxelGrid) -> SampleVoxels:
        """Sort points (n, 3) into the voxels of a grid that holds them."""
        at, size = grid.to_cell_units(np.reshape(points, (-1, 3))), np.array(grid.shape)
        if ((at < -1e-6) | (at > size + 1e-6)).any():
            raise ValueError(f"surface samples must lie inside of the grid {grid}")
        # a sample on the upper end of the grid is in its last voxel
        index = np.clip(at.astype(np.int64), 0, size - 1)
        cells, counts = np.unique(grid.flat_index(index), return_counts=True)
        return cls(cells, counts.astype(np.int64), grid)

    def coverage(self, map_: OccupancyMap) -> float:
        """Share of the samples with an occupied voxel (sampled, P > ½) within one voxel.

        That is one of the 27 voxels around the sample's own. NaN if there are no samples.

        Raises
        ------
        ValueError
            If the map's grid is not that of the samples.
        """
        if map_.grid != self.grid:
            raise ValueError(f"the samples lie in {self.grid}, the map in {map_.grid}")
        if not len(self.cells):
            return float("nan")
        shape = np.array(self.grid.shape)
        covered = count_covered(
            map_.log_odds_fixed, map_.sampled_mask, shape, self.cells, self.counts
        )
        return float(covered / self.counts.sum())


def surface_points(map_: OccupancyMap) -> NDArray[np.float64]:
    """What a map says the surface is: merged means (k, 3) of its voxels with P > ½, metres."""
    cells, means, _ = map_.surfaces()
    return means[map_.log_odds_fixed[cells] > 0]


def distance_scores(
    map_points: NDArray[np.float64],
    samples: NDArray[np.float64],
    bins: TriangleBins,
    tau: float,
) -> tuple[float, float, float, float]:
    """F-score, precision, recall and Chamfer distance of map points (k, 3).

    F = 2 P R / (P + R), and the Chamfer distance is (mean distance of map points to the surface +
    mean distance of samples to the nearest map point) / 2.

    Parameters
    ----------
    map_points : ndarray, shape (k, 3)
    samples : ndarray, shape (n, 3)
        On the part of the true surface that is asked for.
    bins : TriangleBins
        All of the true surface.
    tau : float
        Metres.

    Raises
    ------
    ValueError
        If tau is not finite and > 0.
    """
    if not (np.isfinite(tau) and tau > 0):
        raise ValueError(f"tau must be finite and > 0, got {tau}")
    if not len(samples):
        undefined = float("nan")
        precision = float((bins.distances(map_points) <= tau).mean()) if len(map_points) else 0.0
        return undefined, precision, undefined, undefined
    if not len(map_points):
        grid = bins.grid
        return 0.0, 0.0, 0.0, float(np.linalg.norm(grid.shape) * grid.resolution)
    from scipy.spatial import cKDTree  # only at an episode's end

    to_surface = bins.distances(map_points)
    to_map, _ = cKDTree(map_points).query(samples)
    precision, recall = float((to_surface <= tau).mean()), float((to_map <= tau).mean())
    f_score = 2 * precision * recall / (precision + recall) if precision + recall else 0.0
    return f_score, precision, recall, float(to_surface.mean() + to_map.mean()) / 2


@njit(cache=True, nogil=True)
def count_covered(log_odds_fixed, sampled, shape, cells, counts):
    """Sum of the counts (u,) of cells (u,) with an occupied one among the 27 around them."""
    ny, nz = shape[1], shape[2]
    total = 0
    for n in range(len(cells)):
        cell = cells[n]
        if (
            log_odds_fixed[cell] > 0 and sampled[cell]
        ):  # where anything is covered, mostly the own one
            total += counts[n]
            continue
        x, rest = cell // (ny * nz), cell % (ny * nz)
        if has_occupied_neighbor(log_odds_fixed, sampled, shape, x, rest // nz, rest % nz):
            total += counts[n]
    return total


@njit(cache=True, nogil=True)
def has_occupied_neighbor(log_odds_fixed, sampled, shape, x, y, z):
    """Whether one of the 27 cells around a cell is occupied."""
    nx, ny, nz = shape[0], shape[1], shape[2]
    first, last = max(z - 1, 0), min(z + 2, nz)
    for i in range(max(x - 1, 0), min(x + 2, nx)):
        for j in range(max(y - 1, 0), min(y + 2, ny)):
            row = (i * ny + j) * nz
            for cell in range(row + first, row + last):
                if log_odds_fixed[cell] > 0 and sampled[cell]:
                    return True
    return False
