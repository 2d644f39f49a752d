"""Kernels that fuse one scan: walk its beams, then apply one update to each touched cell."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from coopmap_env.geometry.traversal import advance, begin
from coopmap_env.mapping.beam import CUT, WINDOW, end_weights, end_weights_along, level_of_beam
from coopmap_env.mapping.gaussian import add_observation
from coopmap_env.mapping.integration_simd import walk_partial

MIN_SIGMA = 0.01
"""Cells: no observation is trusted beyond a hundredth of a cell, so a noise-free camera is fine."""
DIAGONAL = 1.75
"""Cells: no less than the longest way through one, so that no cell in which the beam may have
ended is left among the free ones."""
OUTSIDE = -2
"""What `find_fault` says of a camera out of the grid."""


@njit(cache=True, nogil=True)
def find_fault(origin, points, covariances, hit, lower, resolution, shape):
    """First beam with a NaN or an infinity, OUTSIDE if the camera is out of the grid, else -1.

    The covariance of a beam without return is not asked.
    """
    for axis in range(len(origin)):
        cell = (origin[axis] - lower[axis]) / resolution
        if not 0.0 <= cell < shape[axis]:
            return OUTSIDE
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
def strongest(one, other):
    """Which of two beams' levels counts where surfaces are partial: ends before passes."""
    return max(one, other) if one > 0 or other > 0 else min(one, other)


@njit(cache=True, nogil=True, inline="always")
def through(level, way):
    """A passing beam's level, in proportion to its way through the cell (in cells), at most 1."""
    return math.floor(level * min(way, 1.0) + 0.5)


@njit(cache=True, nogil=True)
def _aim(point, origin, resolution, u):
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
def _sigma_along(u, covariance, resolution):
    """Standard deviation of a point along the beam, cells."""
    variance = 0.0
    for i in range(len(covariance)):
        for j in range(len(covariance)):
            variance += u[i] * covariance[i, j] * u[j]
    # rounding takes the variance across a flat covariance below zero
    return max(math.sqrt(max(variance, 0.0)) / resolution, MIN_SIGMA)


@njit(cache=True, nogil=True)
def _claim_ends(cells, entries, exits, weights, n, best, bounds, partial, pending, touched, count):
    """Add what a beam says of the n cells in which it may have ended."""
    before = 0.0
    for k in range(n):
        level = level_of_beam(weights[k], before, bounds[0], bounds[1])
        before += weights[k]
        cell = np.uint64(cells[k])
        so_far = pending[cell]
        touched[np.uint64(count)] = cells[k]
        if partial:
            if level < 0:
                level = through(level, exits[k] - entries[k])
            if level == 0 and k == best:
                level = -1  # a cell that keeps the beam's point is one that was sampled
            count += so_far == 0 and level != 0
            pending[cell] = strongest(so_far, level)
        else:
            count += so_far == 0
            pending[cell] = so_far + level if so_far != -level else 1
        if before > CUT and k >= best:
            break
    return count


@njit(cache=True, nogil=True)
def walk_beams(
    origin, points, covariances, hit, lower, resolution, shape,
    bounds, enters, partial, precision, vector, pending, touched,
):  # fmt: skip
    """Walk every beam of a scan; sum what they say per cell; merge the hits' Gaussians.

    Where surfaces are `partial`, the strongest claim on a cell counts instead of the sum.
    `pending` (n_cells,) int32 holds the summed levels, zero between scans and kept off zero for
    the cells of this one, which `touched` (n_cells + 1,) lists. Returns how many there are.
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
        z = _aim(points[beam], origin, resolution, u)
        if z == 0.0:
            continue
        clear, stop, sigma = z, z, 0.0
        if hit[beam]:
            sigma = _sigma_along(u, covariances[beam], resolution)
            clear = z - WINDOW * sigma - DIAGONAL
            stop = z + WINDOW * sigma
        cx, sx, tx, dx, end_x = begin(p[0], u[0], nx, ny * nz)
        cy, sy, ty, dy, end_y = begin(p[1], u[1], ny, nz)
        cz, sz, tz, dz, end_z = begin(p[2], u[2], nz, 1)
        cell = cx + cy + cz
        end = min(end_x, end_y, end_z)
        t = 0.0
        # free for certain
        until = min(clear, end)
        while partial and t < until:
            crossed, entry = cell, t
            cell, tx, ty, tz, t = advance(cell, sx, sy, sz, tx, ty, tz, dx, dy, dz)
            level = through(lowest, t - entry)
            index = np.uint64(crossed)  # the compiler guards signed indices against negative ones
            so_far = pending[index]
            touched[np.uint64(count)] = crossed
            count += (so_far == 0) & (level != 0)
            pending[index] = strongest(so_far, level)
        while t < until:
            index = np.uint64(cell)
            so_far = pending[index]
            touched[np.uint64(count)] = cell
            count += so_far == 0
            pending[index] = so_far + lowest if so_far != -lowest else 1
            cell, tx, ty, tz, t = advance(cell, sx, sy, sz, tx, ty, tz, dx, dy, dz)
        if not hit[beam]:
            continue
        # cells in which the beam may have ended
        n = 0
        until = min(stop, end)
        while t < until:
            cells[n] = cell
            entries[n] = t
            cell, tx, ty, tz, t = advance(cell, sx, sy, sz, tx, ty, tz, dx, dy, dz)
            exits[n] = t
            n += 1
        candidates = n
        if t < z:  # the surface may lie beyond the grid: one more cell, which no one maps
            entries[n] = z
            exits[n] = z + 1.0
            candidates = n + 1
        if partial:
            best = end_weights_along(entries, exits, candidates, z, sigma, weights)
        else:
            best = end_weights(entries, exits, candidates, z, sigma, enters, weights)
        count = _claim_ends(
            cells, entries, exits, weights, n, best, bounds, partial, pending, touched, count
        )
        if best < n:
            _center_offset(points[beam], cells[best], lower, resolution, shape, offset)
            floor = (MIN_SIGMA * resolution) ** 2
            add_observation(precision, vector, cells[best], covariances[beam], offset, floor)
    return count


@njit(cache=True, nogil=True)
def apply_updates(levels, sampled, pending, touched, count, bounds, clamp, entropy):
    """Add one bounded update to each touched cell; return new cells and the drop of entropy.

    Levels are left unclamped, so that the scans of one team step can be added in any order;
    `clamp_levels` ends the step. The entropy is always that of the clamped level.
    """
    drop = 0.0
    new = 0
    for k in range(count):
        cell = np.uint64(touched[k])
        update = min(max(pending[cell], bounds[0]), bounds[1])
        pending[cell] = 0
        before = levels[cell]
        after = before + update
        levels[cell] = after
        drop += entropy[np.uint64(min(max(before, -clamp), clamp) + clamp)]
        drop -= entropy[np.uint64(min(max(after, -clamp), clamp) + clamp)]
        new += 1 - sampled[cell]
        sampled[cell] = 1
    return new, drop


@njit(cache=True, nogil=True)
def integrate_scan(
    origin, points, covariances, hit, lower, resolution, shape, bounds, enters, partial,
    precision, vector, pending, touched, levels, sampled, clamp, entropy,
):  # fmt: skip
    """Fuse one scan; return the touched cells' number, the new ones', the drop of entropy."""
    if partial and len(origin) == 3:
        count = walk_partial(
            origin, points, covariances, hit, lower, resolution, shape, bounds,
            precision, vector, pending, touched, MIN_SIGMA, DIAGONAL,
        )  # fmt: skip
    else:
        count = walk_beams(
            origin, points, covariances, hit, lower, resolution, shape, bounds, enters, partial,
            precision, vector, pending, touched,
        )  # fmt: skip
    new, drop = apply_updates(levels, sampled, pending, touched, count, bounds, clamp, entropy)
    return count, new, drop


@njit(cache=True, nogil=True)
def clamp_levels(levels, touched, clamp):
    """Clamp the touched cells."""
    for k in range(len(touched)):
        cell = np.uint64(touched[k])
        levels[cell] = min(max(levels[cell], -clamp), clamp)
