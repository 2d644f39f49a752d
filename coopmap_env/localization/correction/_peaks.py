"""Kernels that select fiducials: the map's peaks in view, their balls, the best of them.

Lengths and positions are in cells, positions from the grid's lower corner; sums of
surfaces are the map's, in metres.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.caches import freeze
from coopmap_env.core.kernels import kernel
from coopmap_env.localization.correction.voxels_in_view import (
    Frustum,
    distance_in_view,
    write_surface_voxels,
)
from coopmap_env.mapping import MapArrays, SurfaceArrays, has_line_of_sight, mean_gaussian

Array = NDArray[np.float64]
Cells = NDArray[np.int64]
Levels = NDArray[np.int32]
Shape = tuple[int, int, int]


class PeakMap(NamedTuple):
    """What peaks are found in."""

    occupancy: MapArrays
    probability: Array
    """Probability of each log-odds in fixed point, from the lowest on."""
    surfaces: SurfaceArrays
    """See `OccupancyMap.surface_sums`."""
    rows: NDArray[np.int32]
    """Row of each cell in `surfaces` (n_cells,), -1 for none."""
    resolution: float
    """Edge of a cell, metres."""


class BallOffsets(NamedTuple):
    """Voxels around a peak at (0, 0, 0), sorted by distance."""

    offsets: Cells
    """Shape (m, 3)."""
    inner: Cells
    """Shape (m, 3): of each, the voxel one step nearer to the peak."""
    distances: Array
    """Shape (m,): cells from the peak."""


class BallLimits(NamedTuple):
    """How far a ball around a peak extends."""

    voxels: BallOffsets
    min_rise: float
    """Probability by which a value must exceed that of its inner neighbour to end the ball."""
    max_radius: float
    """Cells."""


class SelectionLimits(NamedTuple):
    """Which peaks become fiducials."""

    min_log_odds: int
    """In fixed point."""
    border_fraction: float
    """Part of the half field of view, at its edge, where no new ones are selected."""
    min_spacing: float
    """Cells between new ones and all others."""
    occlusion_tolerance: float
    """Cells in front of a fiducial in which occupied voxels do not hide it."""


class SelectedPeaks(NamedTuple):
    """Arrays for k fiducials, to be filled; see `Fiducials`."""

    cells: Cells
    positions: Array
    """Shape (k, 3): cells."""
    covariances: Array
    radii: Array
    """Shape (k,): cells."""
    scores: Array

    @classmethod
    def empty(cls, k: int) -> SelectedPeaks:
        """Arrays with room for k fiducials."""
        cells = np.empty(k, dtype=np.int64)
        return cls(cells, np.empty((k, 3)), np.empty((k, 3, 3)), np.empty(k), np.empty(k))


@lru_cache(maxsize=8)
def ball_offsets(radius: float) -> BallOffsets:
    """Voxels up to a radius in cells around a peak.

    The step inwards leads along the straight line to the peak, over a face, an edge or a corner.
    """
    reach = math.floor(radius)
    axis = np.arange(-reach, reach + 1)
    offsets = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    squares = (offsets**2).sum(axis=1)
    inside = (squares > 0) & (squares <= radius**2)
    offsets = offsets[inside][np.argsort(squares[inside], kind="stable")]
    longest = np.abs(offsets).max(axis=1, keepdims=True)
    inner = offsets - np.sign(offsets) * (2 * np.abs(offsets) >= longest)
    return freeze(BallOffsets(offsets, inner, np.sqrt((offsets**2).sum(axis=1))))


@kernel
def select_peaks(
    map_: PeakMap,
    frustum: Frustum,
    ball: BallLimits,
    limits: SelectionLimits,
    previous: Cells,
    selected: SelectedPeaks,
) -> int:
    """Fill the arrays of the selected fiducials, up to their length; return how many.

    Previous ones come first, in their order, while they are peaks in view; then the best new ones.
    """
    log_odds = map_.occupancy.log_odds_fixed
    cells, positions, covariances, radii, scores = selected
    capacity, count = len(cells), 0
    tolerance = limits.occlusion_tolerance
    for cell in previous:
        if count == capacity or log_odds[cell] < limits.min_log_odds:
            continue
        if _trace(map_, cell) <= 0.0 or not _is_peak(map_, cell, False):
            continue
        point = positions[count]
        radius, score = _score_peak(map_, frustum, ball, 0.0, cell, point, covariances[count])
        if score > 0.0 and has_line_of_sight(map_.occupancy, frustum.position, point, tolerance):
            cells[count], radii[count], scores[count] = cell, radius, score
            count += 1
    if count == capacity:
        return count
    new_cells, new_radii, new_scores = _peaks_in_view(map_, frustum, ball, limits)
    # stable, so that equals stay in the order of their cells
    for best in np.argsort(-new_scores, kind="mergesort"):
        if count == capacity:
            break
        cell, point = new_cells[best], positions[count]
        _surface_point(map_, cell, point, covariances[count])
        if _is_separate(selected, count, cell, point, limits.min_spacing) and has_line_of_sight(
            map_.occupancy, frustum.position, point, tolerance
        ):
            cells[count], radii[count], scores[count] = cell, new_radii[best], new_scores[best]
            count += 1
    return count


@kernel
def _peaks_in_view(
    map_: PeakMap, frustum: Frustum, ball: BallLimits, limits: SelectionLimits
) -> tuple[Cells, Array, Array]:
    """Cells of all peaks in view, ascending, hidden or not, their radii and scores."""
    cells = np.empty(len(map_.rows), dtype=np.int64)
    n = write_surface_voxels(
        map_.occupancy, map_.surfaces.precision, map_.rows, frustum, limits.min_log_odds, cells
    )
    radii, scores = np.empty(n), np.empty(n)
    point, covariance = np.empty(3), np.empty((3, 3))
    count = 0
    for cell in cells[:n]:
        if _is_peak(map_, cell, True):
            radius, score = _score_peak(
                map_, frustum, ball, limits.border_fraction, cell, point, covariance
            )
            if score > 0.0:
                cells[count], radii[count], scores[count] = cell, radius, score
                count += 1
    return cells[:count], radii[:count], scores[:count]


@kernel
def _score_peak(
    map_: PeakMap,
    frustum: Frustum,
    ball: BallLimits,
    border: float,
    cell: int,
    point: Array,
    covariance: Array,
) -> tuple[float, float]:
    """Write the surface point and its covariance; radius of the ball and score, 0 out of view."""
    _surface_point(map_, cell, point, covariance)
    distance = distance_in_view(point, frustum, border)
    if distance == math.inf:
        return 0.0, 0.0
    radius = _ball_radius(map_, cell, ball)
    log_odds = map_.occupancy.log_odds_fixed[cell]
    return radius, radius * map_.probability[log_odds + map_.occupancy.clamp] / distance


@kernel
def _ball_radius(map_: PeakMap, cell: int, ball: BallLimits) -> float:
    """Spherical expansion: distance of the nearest voxel that increases, cells, or `max_radius`.

    Voxels beyond the map are unknown, so a ball ends there too.
    """
    levels, _, (nx, ny, nz), clamp = map_.occupancy
    (offsets, inner, distances), min_rise, max_radius = ball
    i, j, k = cell // (ny * nz), cell // nz % ny, cell % nz
    for m in range(len(distances)):
        x, y, z = i + offsets[m, 0], j + offsets[m, 1], k + offsets[m, 2]
        if not (0 <= x < nx and 0 <= y < ny and 0 <= z < nz):
            return distances[m]
        outer = levels[(x * ny + y) * nz + z]
        nearer = levels[((i + inner[m, 0]) * ny + j + inner[m, 1]) * nz + k + inner[m, 2]]
        if outer > nearer:  # noqa: SIM102 - nested is faster
            if map_.probability[outer + clamp] - map_.probability[nearer + clamp] > min_rise:
                return distances[m]
    return max_radius


@kernel
def _trace(map_: PeakMap, cell: int) -> float:
    """Trace of the precision of a voxel's surface point, or its number of points; 0 without one."""
    row, precision = map_.rows[cell], map_.surfaces.precision
    if row < 0:
        return 0.0
    trace = precision[row, 0, 0]
    for axis in range(1, precision.shape[1]):
        trace += precision[row, axis, axis]
    return trace


@kernel
def _is_peak(map_: PeakMap, cell: int, unique: bool) -> bool:
    """Whether no neighbour of 26 is above; with `unique`, none is equal and known better."""
    levels, _, (nx, ny, nz), _ = map_.occupancy
    i, j, k = cell // (ny * nz), cell // nz % ny, cell % nz
    level = levels[cell]
    own_trace = _trace(map_, cell)
    for x in range(max(i - 1, 0), min(i + 2, nx)):
        for y in range(max(j - 1, 0), min(j + 2, ny)):
            for z in range(max(k - 1, 0), min(k + 2, nz)):
                other = (x * ny + y) * nz + z
                if levels[other] > level:
                    return False
                if unique and levels[other] == level and other != cell:
                    trace = _trace(map_, other)
                    if trace > own_trace or (trace == own_trace and other < cell):
                        return False
    return True


@kernel
def _surface_point(map_: PeakMap, cell: int, point: Array, covariance: Array) -> None:
    """Write the merged surface point of a voxel, in cells, and its covariance."""
    shape, row = map_.occupancy.shape, map_.rows[cell]
    averaged = len(map_.surfaces.noise) > 0
    if averaged:
        offset = np.empty(3)
        mean_gaussian(map_.surfaces, row, offset, covariance)
    else:
        _eq_4_covariance(map_.surfaces.precision[row], covariance)
    point[0] = cell // (shape[1] * shape[2]) + 0.5
    point[1] = cell // shape[2] % shape[1] + 0.5
    point[2] = cell % shape[2] + 0.5
    vector = map_.surfaces.information_vector[row]
    for m in range(3):
        if averaged:
            point[m] += offset[m] / map_.resolution
            continue
        for n in range(3):
            point[m] += covariance[m, n] * vector[n] / map_.resolution


@kernel
def _eq_4_covariance(P: Array, covariance: Array) -> None:
    """Write the inverse of a precision (3, 3)."""
    for m in range(3):
        a, b = (m + 1) % 3, (m + 2) % 3
        for n in range(3):
            c, d = (n + 1) % 3, (n + 2) % 3
            covariance[n, m] = P[a, c] * P[b, d] - P[a, d] * P[b, c]
    scale = P[0, 0] * covariance[0, 0] + P[0, 1] * covariance[1, 0] + P[0, 2] * covariance[2, 0]
    for m in range(3):
        for n in range(m + 1):
            covariance[m, n] /= scale
            covariance[n, m] = covariance[m, n]


@kernel
def _is_separate(
    selected: SelectedPeaks, count: int, cell: int, point: Array, spacing: float
) -> bool:
    """Whether a peak is none of the first `count` fiducials and keeps its distance from them."""
    for m in range(count):
        if selected.cells[m] == cell:
            return False
        square = 0.0
        for axis in range(3):
            square += (selected.positions[m, axis] - point[axis]) ** 2
        if square < spacing * spacing:
            return False
    return True
