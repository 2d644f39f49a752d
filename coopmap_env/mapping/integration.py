"""Kernels that fuse one scan: walk its beams, then apply one update to each touched cell."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from coopmap_env.geometry.traversal import init_axis, step_voxel
from coopmap_env.mapping.beam import (
    POSTERIOR_CUTOFF,
    RANGE_WINDOW,
    beam_log_odds_fixed,
    endpoint_posterior,
    partial_endpoint_posterior,
)
from coopmap_env.mapping.gaussian import add_observation
from coopmap_env.mapping.integration_simd import integrate_rays_simd

MIN_RANGE_SIGMA = 0.01
"""Cells: no observation is trusted beyond a hundredth of a cell, so a noise-free camera is fine."""
MAX_PATH_IN_CELL = 1.75
"""Cells: no less than the longest way through one, so that no cell in which the beam may have
ended is left among the free ones."""
CAMERA_OUTSIDE_GRID = -2
"""What `validate_scan` says of a camera out of the grid."""


@njit(cache=True, nogil=True)
def validate_scan(origin, points, covariances, hit, lower, resolution, shape):
    """First beam with a NaN or an infinity, OUTSIDE if the camera is out of the grid, else -1.

    The covariance of a beam without return is not asked.
    """
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


@njit(cache=True, nogil=True)
def _center_offset(point, cell, lower, resolution, shape, offset):
    """Write `point` minus the centre of flat cell `cell`, metres."""
    for axis in range(len(point) - 1, -1, -1):
        offset[axis] = point[axis] - ((cell % shape[axis] + 0.5) * resolution + lower[axis])
        cell //= shape[axis]


@njit(cache=True, nogil=True, inline="always")
def merge_updates(one, other):
    """Which of two beams' levels counts where surfaces are partial: ends before passes."""
    return max(one, other) if one > 0 or other > 0 else min(one, other)


@njit(cache=True, nogil=True, inline="always")
def scale_free_update(update, path_length):
    """A passing beam's level, in proportion to its way through the cell (in cells), at most 1."""
    return math.floor(update * min(path_length, 1.0) + 0.5)


@njit(cache=True, nogil=True)
def _unit_direction(point, origin, resolution, u):
    """Write the unit direction from `origin` to `point` into `u`; return the distance, cells."""
    z = 0.0
    for axis in range(len(point)):
        u[axis] = (point[axis] - origin[axis]) / resolution
        z += u[axis] * u[axis]
    z = math.sqrt(z)
    if z > 0.0:
        for axis in range(len(point)):
            u[axis] /= z
    return z


@njit(cache=True, nogil=True)
def _range_sigma(u, covariance, resolution):
    """Standard deviation of a point along the beam, cells."""
    variance = 0.0
    for i in range(len(covariance)):
        for j in range(len(covariance)):
            variance += u[i] * covariance[i, j] * u[j]
    # rounding takes the variance across a flat covariance below zero
    return max(math.sqrt(max(variance, 0.0)) / resolution, MIN_RANGE_SIGMA)


@njit(cache=True, nogil=True)
def _update_end_cells(
    cells, entries, exits, weights, n, best, bounds, partial_surface, pending, updated_cells, count
):
    """Add what a beam says of the n cells in which it may have ended."""
    before = 0.0
    for k in range(n):
        update = beam_log_odds_fixed(weights[k], before, bounds[0], bounds[1])
        before += weights[k]
        cell = np.uint64(cells[k])
        current = pending[cell]
        updated_cells[np.uint64(count)] = cells[k]
        if partial_surface:
            if update < 0:
                update = scale_free_update(update, exits[k] - entries[k])
            if update == 0 and k == best:
                update = -1  # a cell that keeps the beam's point is one that was sampled
            count += current == 0 and update != 0
            pending[cell] = merge_updates(current, update)
        else:
            count += current == 0
            pending[cell] = current + update if current != -update else 1
        if before > POSTERIOR_CUTOFF and k >= best:
            break
    return count


@njit(cache=True, nogil=True)
def integrate_rays(
    origin, points, covariances, hit, lower, resolution, shape,
    bounds, surface_at_entry, partial_surface, precision, vector, pending, updated_cells,
):  # fmt: skip
    """Walk every beam of a scan; sum what they say per cell; merge the hits' Gaussians.

    Where surfaces are `partial_surface`, the strongest claim on a cell counts instead of the sum.
    `pending` (n_cells,) int32 holds the summed levels, zero between scans and kept off zero for
    the cells of this one, which `updated_cells` (n_cells + 1,) lists. Returns how many there are.
    """
    nx, ny, nz = shape
    lowest = bounds[0]
    dimension = points.shape[1]
    capacity = nx + ny + nz + 3
    cells = np.empty(capacity, np.int64)
    entries = np.empty(capacity)
    exits = np.empty(capacity)
    weights = np.empty(capacity)
    offset = np.zeros(dimension)
    p = np.full(3, 0.5)
    u = np.zeros(3)
    for axis in range(dimension):
        p[axis] = (origin[axis] - lower[axis]) / resolution
    count = 0
    for beam in range(points.shape[0]):
        z = _unit_direction(points[beam], origin, resolution, u)
        if z == 0.0:
            continue
        free_until, stop, sigma = z, z, 0.0
        if hit[beam]:
            sigma = _range_sigma(u, covariances[beam], resolution)
            free_until = z - RANGE_WINDOW * sigma - MAX_PATH_IN_CELL
            stop = z + RANGE_WINDOW * sigma
        cx, sx, tx, dx, end_x = init_axis(p[0], u[0], nx, ny * nz)
        cy, sy, ty, dy, end_y = init_axis(p[1], u[1], ny, nz)
        cz, sz, tz, dz, end_z = init_axis(p[2], u[2], nz, 1)
        cell = cx + cy + cz
        end = min(end_x, end_y, end_z)
        t = 0.0
        # free for certain
        until = min(free_until, end)
        while partial_surface and t < until:
            crossed, entry = cell, t
            cell, tx, ty, tz, t = step_voxel(cell, sx, sy, sz, tx, ty, tz, dx, dy, dz)
            update = scale_free_update(lowest, t - entry)
            index = np.uint64(crossed)  # the compiler guards signed indices against negative ones
            current = pending[index]
            updated_cells[np.uint64(count)] = crossed
            count += (current == 0) & (update != 0)
            pending[index] = merge_updates(current, update)
        while t < until:
            index = np.uint64(cell)
            current = pending[index]
            updated_cells[np.uint64(count)] = cell
            count += current == 0
            pending[index] = current + lowest if current != -lowest else 1
            cell, tx, ty, tz, t = step_voxel(cell, sx, sy, sz, tx, ty, tz, dx, dy, dz)
        if not hit[beam]:
            continue
        # cells in which the beam may have ended
        n = 0
        until = min(stop, end)
        while t < until:
            cells[n] = cell
            entries[n] = t
            cell, tx, ty, tz, t = step_voxel(cell, sx, sy, sz, tx, ty, tz, dx, dy, dz)
            exits[n] = t
            n += 1
        candidates = n
        if t < z:  # the surface may lie beyond the grid: one more cell, which no one maps
            entries[n] = z
            exits[n] = z + 1.0
            candidates = n + 1
        if partial_surface:
            best = partial_endpoint_posterior(entries, exits, candidates, z, sigma, weights)
        else:
            best = endpoint_posterior(
                entries, exits, candidates, z, sigma, surface_at_entry, weights
            )
        count = _update_end_cells(
            cells,
            entries,
            exits,
            weights,
            n,
            best,
            bounds,
            partial_surface,
            pending,
            updated_cells,
            count,
        )
        if best < n:
            _center_offset(points[beam], cells[best], lower, resolution, shape, offset)
            floor = (MIN_RANGE_SIGMA * resolution) ** 2
            add_observation(precision, vector, cells[best], covariances[beam], offset, floor)
    return count


@njit(cache=True, nogil=True)
def apply_updates(log_odds_fixed, sampled, pending, updated_cells, count, bounds, clamp, entropy):
    """Add one bounded update to each touched cell; return new cells and the drop of entropy.

    Levels are left unclamped, so that the scans of one team step can be added in any order;
    `clamp_levels` ends the step. The entropy is always that of the clamped level.
    """
    drop = 0.0
    new = 0
    for k in range(count):
        cell = np.uint64(updated_cells[k])
        update = min(max(pending[cell], bounds[0]), bounds[1])
        pending[cell] = 0
        before = log_odds_fixed[cell]
        after = before + update
        log_odds_fixed[cell] = after
        drop += entropy[np.uint64(min(max(before, -clamp), clamp) + clamp)]
        drop -= entropy[np.uint64(min(max(after, -clamp), clamp) + clamp)]
        new += 1 - sampled[cell]
        sampled[cell] = 1
    return new, drop


@njit(cache=True, nogil=True)
def integrate_scan(
    origin, points, covariances, hit, lower, resolution, shape, bounds, surface_at_entry, partial_surface,
    precision, vector, pending, updated_cells, log_odds_fixed, sampled, clamp, entropy,
):  # fmt: skip
    """Fuse one scan; return the touched cells' number, the new ones', the drop of entropy."""
    if partial_surface and len(origin) == 3:
        count = integrate_rays_simd(
            origin, points, covariances, hit, lower, resolution, shape, bounds,
            precision, vector, pending, updated_cells, MIN_RANGE_SIGMA, MAX_PATH_IN_CELL,
        )  # fmt: skip
    else:
        count = integrate_rays(
            origin, points, covariances, hit, lower, resolution, shape, bounds, surface_at_entry, partial_surface,
            precision, vector, pending, updated_cells,
        )  # fmt: skip
    new, drop = apply_updates(
        log_odds_fixed, sampled, pending, updated_cells, count, bounds, clamp, entropy
    )
    return count, new, drop


@njit(cache=True, nogil=True)
def clamp_levels(log_odds_fixed, updated_cells, clamp):
    """Clamp the touched cells."""
    for k in range(len(updated_cells)):
        cell = np.uint64(updated_cells[k])
        log_odds_fixed[cell] = min(max(log_odds_fixed[cell], -clamp), clamp)
