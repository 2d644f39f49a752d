"""Scores of a map's surface against the true surface.

=================  ========================================================================
score              meaning; 1 is best unless a unit is given
=================  ========================================================================
coverage           fraction of the visible surface with an occupied voxel next to it
target coverage    the same for the target alone
precision          fraction of the map's points that lie within tau of the true surface
recall             fraction of the visible surface that lies within tau of a map point
F-score            harmonic mean of precision and recall
chi2 median        of the points' squared distances from the surface in their own standard
                   deviations: 0.45 if the map's covariances are right, more if they are too small
chi2 tail          fraction of these beyond 3.84: 0.05 if the covariances are right
Chamfer distance   metres, best 0: mean of the two mean distances, without an upper bound
=================  ========================================================================

A map point is the surface point (`OccupancyMap.surfaces`) of a voxel with P > ½. Precision uses the
exact distance to all true triangles inside the grid, visible or not. Recall and coverage are over
samples of the visible surface (`_visible_surface`): they measure what the policy missed, and not
what no pose can see. A sample is covered by an occupied voxel within one
voxel of its own. So the two sides of a plate thinner than a voxel cover each other.

tau is one voxel. The finest detail of a map is that a surface runs through a voxel, and in a flat
piece the next point is at most one voxel away. Coverage has the same tolerance.

An empty map has precision, recall and F-score 0, and the largest possible Chamfer distance: the
diagonal of the grid. If nothing is visible, coverage, recall, F-score and Chamfer distance are NaN.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.kernels import kernel
from coopmap_env.evaluation.metrics._triangle_distance import TriangleBins
from coopmap_env.mapping import MapArrays, OccupancyMap, VoxelGrid


@dataclass(frozen=True)
class SurfaceScores:
    """Scores of a map's surface; see the module."""

    coverage: float
    """Fraction of the visible surface."""
    target_coverage: float
    """Fraction of the target's visible surface."""
    f_score: float
    precision: float
    """Fraction of the map's points."""
    recall: float
    """Fraction of the visible surface."""
    chamfer: float
    """Metres."""
    chi2_median: float
    """Median squared distance in standard deviations; see `surface_consistency`."""
    chi2_tail: float
    """Fraction of the map's points beyond 3.84."""


@dataclass(frozen=True, eq=False)
class SampleVoxels:
    """The voxels of surface samples, each once: coverage of one map after the other is cheap."""

    cells: NDArray[np.int64]
    """Shape (u,): flat indices."""
    counts: NDArray[np.int64]
    """Shape (u,): samples in each."""
    grid: VoxelGrid

    @classmethod
    def from_points(cls, points: ArrayLike, grid: VoxelGrid) -> SampleVoxels:
        """Sort points (n, 3) into the voxels of a grid that contains them.

        Raises
        ------
        ValueError
            If a point lies outside the grid.
        """
        position, size = grid.to_cell_units(np.reshape(points, (-1, 3))), np.array(grid.shape)
        if ((position < -1e-6) | (position > size + 1e-6)).any():
            raise ValueError(f"surface samples must lie inside the grid {grid}")
        # a sample on the upper border of the grid is in its last voxel
        index = np.clip(position.astype(np.int64), 0, size - 1)
        cells, counts = np.unique(grid.flat_index(index), return_counts=True)
        return cls(cells, counts.astype(np.int64), grid)

    def coverage(self, map_: OccupancyMap) -> float:
        """Fraction of the samples with an occupied voxel (sampled, P > ½) within one voxel.

        That is among the 27 voxels around the sample's own. NaN if there are no samples.

        Raises
        ------
        ValueError
            If the map's grid is not that of the samples.
        """
        if map_.grid != self.grid:
            raise ValueError(f"the samples lie in {self.grid}, the map in {map_.grid}")
        if not len(self.cells):
            return float("nan")
        covered = count_covered(map_.arrays, self.cells, self.counts)
        return float(covered / self.counts.sum())


def surface_gaussians(map_: OccupancyMap) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The map's estimate of the surface: means (k, D) and covariances of cells with P > ½, m."""
    cells, means, covariances = map_.surfaces()
    occupied = map_.log_odds_fixed[cells] > 0
    return means[occupied], covariances[occupied]


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
        Points on the part of the true surface that recall is over.
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


@kernel
def count_covered(
    map_arrays: MapArrays, cells: NDArray[np.int64], counts: NDArray[np.int64]
) -> int:
    """Sum of the counts (u,) of those cells (u,) with an occupied one among the 27 around them."""
    ny, nz = map_arrays.shape[1], map_arrays.shape[2]
    total = 0
    for n in range(len(cells)):
        cell = cells[n]
        # most covered samples lie in an occupied voxel themselves
        if map_arrays.log_odds_fixed[cell] > 0 and map_arrays.sampled_mask[cell]:
            total += counts[n]
            continue
        x, rest = cell // (ny * nz), cell % (ny * nz)
        if has_occupied_neighbor(map_arrays, x, rest // nz, rest % nz):
            total += counts[n]
    return total


@kernel
def has_occupied_neighbor(map_arrays: MapArrays, x: int, y: int, z: int) -> bool:
    """Whether one of the 27 cells around a cell is occupied."""
    nx, ny, nz = map_arrays.shape
    first, last = max(z - 1, 0), min(z + 2, nz)
    for i in range(max(x - 1, 0), min(x + 2, nx)):
        for j in range(max(y - 1, 0), min(y + 2, ny)):
            row = (i * ny + j) * nz
            for cell in range(row + first, row + last):
                if map_arrays.log_odds_fixed[cell] > 0 and map_arrays.sampled_mask[cell]:
                    return True
    return False
