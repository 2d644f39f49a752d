"""Kernels of fiducials: the peaks in view, spherical expansion around them, the best of them.

Lengths and positions are in cells, positions from the grid's lower corner; surface information is
the map's, in metres.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from coopmap_env.mapping.line_of_sight import has_line_of_sight

HALF_DIAGONAL = math.sqrt(3.0) / 2.0
"""Cells: half the diagonal of a voxel, by which its surface point may lie off its centre."""


@lru_cache(maxsize=8)
def ball_offsets(
    radius: float,
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Voxels (m, 3) around a peak at (0, 0, 0), those a step nearer, and distances (m,), sorted.

    The step leads along the straight way to the peak, over a face, an edge or a corner. Voxels
    further than `radius`, in cells, are left out.
    """
    reach = math.floor(radius)
    axis = np.arange(-reach, reach + 1)
    offsets = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    squares = (offsets**2).sum(axis=1)
    inside = (squares > 0) & (squares <= radius**2)
    offsets = offsets[inside][np.argsort(squares[inside], kind="stable")]
    longest = np.abs(offsets).max(axis=1, keepdims=True)
    inner = offsets - np.sign(offsets) * (2 * np.abs(offsets) >= longest)
    return offsets, inner, np.sqrt((offsets**2).sum(axis=1))


@njit(cache=True, nogil=True)
def _ball_radius(log_odds_fixed, shape, probability, cell, neighbourhood, min_rise, max_radius):
    """Spherical expansion: distance of the nearest voxel that increases, cells, or `max_radius`.

    What lies beyond the map is not known, so a ball ends there too.
    """
    nx, ny, nz = shape
    offsets, inner, distances = neighbourhood
    clamp = len(probability) // 2
    i, j, k = cell // (ny * nz), cell // nz % ny, cell % nz
    for m in range(len(distances)):
        x, y, z = i + offsets[m, 0], j + offsets[m, 1], k + offsets[m, 2]
        if not (0 <= x < nx and 0 <= y < ny and 0 <= z < nz):
            return distances[m]
        outer = log_odds_fixed[(x * ny + y) * nz + z]
        nearer = log_odds_fixed[((i + inner[m, 0]) * ny + j + inner[m, 1]) * nz + k + inner[m, 2]]
        if outer > nearer:  # noqa: SIM102 - nested is faster
            if probability[outer + clamp] - probability[nearer + clamp] > min_rise:
                return distances[m]
    return max_radius


@njit(cache=True, nogil=True)
def _trace(precision, cell):
    """How well the surface in a voxel is known; 0 without one."""
    return precision[cell, 0, 0] + precision[cell, 1, 1] + precision[cell, 2, 2]


@njit(cache=True, nogil=True)
def _is_peak(log_odds_fixed, precision, shape, cell, unique):
    """Whether none of the 26 neighbours is above; with `unique`, none is equal and known better."""
    nx, ny, nz = shape
    i, j, k = cell // (ny * nz), cell // nz % ny, cell % nz
    level = log_odds_fixed[cell]
    precision_trace = _trace(precision, cell)
    for x in range(max(i - 1, 0), min(i + 2, nx)):
        for y in range(max(j - 1, 0), min(j + 2, ny)):
            for z in range(max(k - 1, 0), min(k + 2, nz)):
                other = (x * ny + y) * nz + z
                if log_odds_fixed[other] > level:
                    return False
                if unique and log_odds_fixed[other] == level and other != cell:
                    trace = _trace(precision, other)
                    if trace > precision_trace or (trace == precision_trace and other < cell):
                        return False
    return True


@njit(cache=True, nogil=True)
def _first_column(low, position, reach, axis):
    """First column whose centre is inside the frustum's box and sphere along an axis."""
    return max(0, math.ceil(max(low[axis] - HALF_DIAGONAL, position[axis] - reach) - 0.5))


@njit(cache=True, nogil=True)
def _end_column(high, position, reach, axis, n):
    """One past the last such column."""
    return min(n, math.floor(min(high[axis] + HALF_DIAGONAL, position[axis] + reach) - 0.5) + 1)


@njit(cache=True, nogil=True)
def _hit_voxels(log_odds_fixed, precision, shape, R, position, frustum, min_level, cells):
    """Write the likely hit voxels around the frustum, in order; return how many."""
    nx, ny, nz = shape
    a, b, _, far = frustum
    reach = far + HALF_DIAGONAL
    # inward normals of the four planes; the box around the apex and the corners
    planes = np.empty((4, 3))
    low, high = position.copy(), position.copy()
    for q in range(4):
        s, t = 1.0 - 2.0 * (q % 2), 1.0 - 2.0 * (q // 2)
        for axis in range(3):
            corner = position[axis] + reach * (R[axis, 0] + s * a * R[axis, 1] + t * b * R[axis, 2])
            low[axis], high[axis] = min(low[axis], corner), max(high[axis], corner)
            side = s * R[axis, 1] if q < 2 else s * R[axis, 2]
            tangent = a if q < 2 else b
            planes[q, axis] = (tangent * R[axis, 0] + side) / math.sqrt(1.0 + tangent * tangent)
    count = 0
    for i in range(
        _first_column(low, position, reach, 0), _end_column(high, position, reach, 0, nx)
    ):
        dx = i + 0.5 - position[0]
        for j in range(
            _first_column(low, position, reach, 1), _end_column(high, position, reach, 1, ny)
        ):
            dy = j + 0.5 - position[1]
            rest = reach * reach - dx * dx - dy * dy
            if rest < 0.0:
                continue
            bottom, top = -math.sqrt(rest), math.sqrt(rest)
            for q in range(4):
                inside = planes[q, 0] * dx + planes[q, 1] * dy + HALF_DIAGONAL
                slope = planes[q, 2]
                if abs(slope) < 1e-9:
                    if inside < 0.0:
                        top = -math.inf
                elif slope > 0.0:
                    bottom = max(bottom, -inside / slope)
                else:
                    top = min(top, -inside / slope)
            if top < bottom:
                continue
            first = max(0, math.ceil(bottom + position[2] - 0.5))
            last = min(nz - 1, math.floor(top + position[2] - 0.5))
            column = (i * ny + j) * nz
            for cell in range(column + first, column + last + 1):
                if log_odds_fixed[cell] >= min_level and precision[cell, 0, 0] > 0.0:
                    cells[count] = cell
                    count += 1
    return count


@njit(cache=True, nogil=True)
def _surface_point(precision, vector, cell, shape, resolution, point, covariance):
    """Write the merged surface point of a hit voxel, in cells, and its covariance (Eqs. 2, 4)."""
    P = precision[cell]
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
    point[0] = cell // (shape[1] * shape[2]) + 0.5
    point[1] = cell // shape[2] % shape[1] + 0.5
    point[2] = cell % shape[2] + 0.5
    for m in range(3):
        for n in range(3):
            point[m] += covariance[m, n] * vector[cell, n] / resolution


@njit(cache=True, nogil=True)
def _distance_in_view(point, R, position, frustum, border):
    """Distance to a point in the field of view less its border, and in range; else infinity."""
    a, b, near, far = frustum
    dx, dy, dz = point[0] - position[0], point[1] - position[1], point[2] - position[2]
    x = R[0, 0] * dx + R[1, 0] * dy + R[2, 0] * dz
    y = R[0, 1] * dx + R[1, 1] * dy + R[2, 1] * dz
    z = R[0, 2] * dx + R[1, 2] * dy + R[2, 2] * dz
    distance = math.sqrt(dx * dx + dy * dy + dz * dz)
    width = (1.0 - border) * x
    if x > 0.0 and abs(y) <= a * width and abs(z) <= b * width and near <= distance <= far:
        return distance
    return math.inf


@njit(cache=True, nogil=True)
def _is_separate(cells, positions, count, cell, point, spacing):
    """Whether a fiducial is none of the first `count` ones and keeps its distance from them."""
    for m in range(count):
        if cells[m] == cell:
            return False
        square = 0.0
        for axis in range(3):
            square += (positions[m, axis] - point[axis]) ** 2
        if square < spacing * spacing:
            return False
    return True


@njit(cache=True, nogil=True)
def _score_peak(map_arrays, view, ball_limits, border, cell, point, covariance):
    """Write the surface point and its covariance; radius of the ball and score, 0 out of view."""
    log_odds_fixed, _, precision, vector, shape, resolution = map_arrays
    R, position, frustum = view
    probability, neighbourhood, min_rise, max_radius = ball_limits
    _surface_point(precision, vector, cell, shape, resolution, point, covariance)
    distance = _distance_in_view(point, R, position, frustum, border)
    if distance == math.inf:
        return 0.0, 0.0
    radius = _ball_radius(
        log_odds_fixed, shape, probability, cell, neighbourhood, min_rise, max_radius
    )
    return radius, radius * probability[log_odds_fixed[cell] + len(probability) // 2] / distance


@njit(cache=True, nogil=True)
def _peaks_in_view(map_arrays, view, ball_limits, min_level, border):
    """Cells of all peaks in view, in order, whether hidden or not, their radii and scores."""
    log_odds_fixed, _, precision, _, shape, _ = map_arrays
    R, position, frustum = view
    cells = np.empty(log_odds_fixed.size, dtype=np.int64)
    n = _hit_voxels(log_odds_fixed, precision, shape, R, position, frustum, min_level, cells)
    radii, scores = np.empty(n), np.empty(n)
    point, covariance = np.empty(3), np.empty((3, 3))
    count = 0
    for cell in cells[:n]:
        if _is_peak(log_odds_fixed, precision, shape, cell, True):
            radius, score = _score_peak(
                map_arrays, view, ball_limits, border, cell, point, covariance
            )
            if score > 0.0:
                cells[count], radii[count], scores[count] = cell, radius, score
                count += 1
    return cells[:count], radii[:count], scores[:count]


@njit(cache=True, nogil=True)
def select_peaks(
    map_arrays, view, ball_limits, min_level, border, spacing, occlusion_tolerance, previous,
    cells, positions, covariances, radii, scores,
):  # fmt: skip
    """Fill the arrays of the chosen fiducials, at most as many as they have room; return how many.

    `map_arrays` is (levels, sampled, precision, vector, shape, resolution) of the map; `view` (R,
    position, (both tangents, near, far)) of a camera in the grid; `ball_limits` (the map's table of
    probabilities, `ball_offsets` of the largest radius, least rise, largest radius); `min_level` a level.
    `positions` and `radii` are filled in cells.
    """
    log_odds_fixed, sampled, precision, vector, shape, resolution = map_arrays
    position = view[1]
    capacity, count = len(cells), 0
    for cell in previous:
        if count == capacity or log_odds_fixed[cell] < min_level or precision[cell, 0, 0] <= 0.0:
            continue
        if not _is_peak(log_odds_fixed, precision, shape, cell, False):
            continue
        point = positions[count]
        radius, score = _score_peak(
            map_arrays, view, ball_limits, 0.0, cell, point, covariances[count]
        )
        if score > 0.0 and has_line_of_sight(
            log_odds_fixed, sampled, shape, position, point, occlusion_tolerance
        ):
            cells[count], radii[count], scores[count] = cell, radius, score
            count += 1
    if count == capacity:
        return count
    candidate_cells, candidate_radii, candidate_scores = _peaks_in_view(
        map_arrays, view, ball_limits, min_level, border
    )
    # stable, so that equals stay in the order of their numbers
    for best in np.argsort(-candidate_scores, kind="mergesort"):
        if count == capacity:
            break
        cell, point = candidate_cells[best], positions[count]
        _surface_point(precision, vector, cell, shape, resolution, point, covariances[count])
        if _is_separate(cells, positions, count, cell, point, spacing) and has_line_of_sight(
            log_odds_fixed, sampled, shape, position, point, occlusion_tolerance
        ):
            cells[count], radii[count], scores[count] = (
                cell,
                candidate_radii[best],
                candidate_scores[best],
            )
            count += 1
    return count
