"""Kernels that fuse one scan: collect the updates of its beams, then apply one to each cell."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import PlainTuple, borrowing_kernel, kernel
from coopmap_env.mapping.arrays import MapArrays, SurfaceArrays, SurfaceIndex, UpdateBuffers
from coopmap_env.mapping.beam import MIN_RANGE_SIGMA, BeamParameters
from coopmap_env.mapping.gaussian import add_observation
from coopmap_env.mapping.grid import GridGeometry, write_center
from coopmap_env.mapping.integration_scalar import allocate_beam, integrate_rays
from coopmap_env.mapping.integration_simd import integrate_rays_simd
from coopmap_env.mapping.surface_mean import add_point, add_shared_errors
from coopmap_env.sensing import ScanArrays

CAMERA_OUTSIDE_GRID = -2
"""Result of `validate_scan` for a camera outside of the grid."""


@kernel
def validate_scan(scan: PlainTuple, grid: PlainTuple) -> int:
    """First beam with a NaN or an infinity, -1 if there is none; or CAMERA_OUTSIDE_GRID.

    `scan` is a plain `ScanArrays`, `grid` a plain `GridGeometry`. The covariance of a beam without
    return may be anything.
    """
    origin, points, covariances, hit = scan
    lower, resolution, shape = grid
    for axis in range(len(origin)):
        cell = (origin[axis] - lower[axis]) / resolution
        if not 0.0 <= cell < shape[axis]:
            return CAMERA_OUTSIDE_GRID
    for beam in range(points.shape[0]):
        total = 0.0
        for i in range(points.shape[1]):
            total += points[beam, i]
            for j in range(points.shape[1]):
                if hit[beam]:
                    total += covariances[beam, i, j]
        if not math.isfinite(total):
            return beam
    return -1


@borrowing_kernel
def apply_updates(
    count: int,
    beam: BeamParameters,
    buffers: UpdateBuffers,
    cells: MapArrays,
    entropy: NDArray[np.float64],
) -> tuple[int, float]:
    """Add one bounded update to each cell of a scan; return new cells and the entropy reduction.

    Log-odds are left unclamped, so that the scans of one team step can be added in any order;
    `clamp_log_odds` ends the step. The entropy is always that of the clamped log-odds.
    """
    pending, updated_cells, _ = buffers
    log_odds_fixed, sampled_mask, _, clamp = cells
    reduction = 0.0
    new = 0
    for k in range(count):
        cell = np.uint64(updated_cells[k])
        update = min(max(pending[cell], beam.lowest), beam.highest)
        pending[cell] = 0
        before = log_odds_fixed[cell]
        after = before + update
        log_odds_fixed[cell] = after
        reduction += entropy[np.uint64(min(max(before, -clamp), clamp) + clamp)]
        reduction -= entropy[np.uint64(min(max(after, -clamp), clamp) + clamp)]
        new += 1 - sampled_mask[cell]
        sampled_mask[cell] = 1
    return new, reduction


class FusionArrays(NamedTuple):
    """The arguments of `integrate_scan` that are the same for every scan of a map."""

    grid: GridGeometry
    beam: BeamParameters
    buffers: UpdateBuffers
    cells: MapArrays
    surfaces: SurfaceArrays
    surface_index: SurfaceIndex
    entropy: NDArray[np.float64]
    """Entropy of the clamped log-odds, see `LogOddsRange.entropy`."""


@borrowing_kernel
def clear_surfaces(surfaces: SurfaceArrays, first: int, stop: int) -> None:
    """Forget the surfaces of the cells from the first up to the stop."""
    precision, information_vector, noise, scatter, shared = surfaces
    if len(precision) > 0:
        precision[first:stop] = 0.0
        information_vector[first:stop] = 0.0
    if len(noise) > 0:
        noise[first:stop] = 0.0
        scatter[first:stop] = 0.0
        shared[first:stop] = 0.0


@kernel
def assign_rows(cells: NDArray[np.int64], index: SurfaceIndex, rows: NDArray[np.int64]) -> None:
    """Write the row of each cell (n_beams,), -1 for none; a cell that has none gets a new one."""
    for k in range(len(cells)):
        cell = cells[k]
        if cell < 0:
            rows[k] = -1
            continue
        row = np.int64(index.rows[cell])
        if row < 0:
            row = index.n_rows[0]
            index.rows[cell], index.cells[row] = row, cell
            index.n_rows[0] = row + 1
        rows[k] = row


@borrowing_kernel
def merge_points(
    scan: ScanArrays,
    cells: NDArray[np.int64],
    rows: NDArray[np.int64],
    grid: GridGeometry,
    surfaces: SurfaceArrays,
    offset: NDArray[np.float64],
) -> None:
    """Add each beam's point to the row of its cell (n_beams,), -1 for none.

    `offset` (D,) is scratch. A map that keeps no surfaces stays as it is.
    """
    if len(surfaces.precision) == 0:
        return
    points, covariances = scan.points, scan.covariances
    averaged = len(surfaces.noise) > 0
    floor = (MIN_RANGE_SIGMA * grid.resolution) ** 2
    for beam in range(len(cells)):
        row = rows[beam]
        if row >= 0:
            write_center(grid, cells[beam], offset)
            for m in range(len(offset)):
                offset[m] = points[beam, m] - offset[m]
            if averaged:
                add_point(surfaces, row, covariances[beam], offset, floor)
            else:
                add_observation(surfaces, row, covariances[beam], offset, floor)


@kernel
def integrate_scan(
    scan: PlainTuple, pose_covariance: NDArray[np.float64], fusion: PlainTuple
) -> tuple[int, int, float]:
    """Fuse one scan; return how many cells it updated, how many were new, the entropy reduction.

    `scan` is a plain `ScanArrays`, `fusion` a plain `FusionArrays` with rows for all of the scan's
    points; `pose_covariance` (6, 6) is that of the scan, 0 if its pose is exact.
    """
    rays = ScanArrays(*scan)
    grid_tuple, beam_tuple, buffer_tuple, cell_tuple, surface_tuple, index_tuple, entropy = fusion
    grid, beam = GridGeometry(*grid_tuple), BeamParameters(*beam_tuple)
    buffers, cells = UpdateBuffers(*buffer_tuple), MapArrays(*cell_tuple)
    n_beams, dimension = rays.points.shape
    hit_cells, rows = np.empty(n_beams, dtype=np.int64), np.empty(n_beams, dtype=np.int64)
    if beam.partial_surface and dimension == 3:
        count = integrate_rays_simd(rays, grid, beam, buffers, hit_cells)
    else:
        scratch = allocate_beam(grid.shape, dimension)
        count = integrate_rays(rays, grid, beam, scratch, buffers, hit_cells)
    surfaces = SurfaceArrays(*surface_tuple)
    assign_rows(hit_cells, SurfaceIndex(*index_tuple), rows)
    merge_points(rays, hit_cells, rows, grid, surfaces, np.zeros(dimension))
    if len(surfaces.shared) > 0 and dimension == 3 and np.any(pose_covariance != 0.0):
        add_shared_errors(
            surfaces, hit_cells, rows, rays.origin, pose_covariance, grid, buffers.n_points
        )
    new, reduction = apply_updates(count, beam, buffers, cells, entropy)
    return count, new, reduction


@kernel
def clamp_log_odds(log_odds_fixed: NDArray[np.int32], cells: NDArray[Any], clamp: int) -> None:
    """Clamp the log-odds of some cells (integers)."""
    for k in range(len(cells)):
        cell = np.uint64(cells[k])
        log_odds_fixed[cell] = min(max(log_odds_fixed[cell], -clamp), clamp)
