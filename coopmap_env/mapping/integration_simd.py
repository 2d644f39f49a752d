"""`integrate_rays` for 3-D scans with partial surfaces, the same to the last bit and faster.

A walk asks at each step which face comes next, and a processor guesses the answer wrong so often
that this takes half of the time. So `LANES` beams are walked side by side, without any branch, in
vector registers; only then do they claim their cells, one after the other in the scan's order. The
points are merged in the end: they lie far from each other in memory, and what is near in the
program is fetched at once. 3000 beams of 60 cells: 0.73 ms instead of 0.99.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from coopmap_env.geometry.traversal import init_axis
from coopmap_env.mapping.beam import POSTERIOR_CUTOFF, RANGE_WINDOW, partial_endpoint_posterior
from coopmap_env.mapping.gaussian import add_observation
from coopmap_env.mapping.log_odds import STEPS_PER_NAT

LANES = 16
"""Beams that are walked at once: two registers of eight, or four of four."""


@njit(cache=True, nogil=True, inline="always")
def _merge_updates(one, other):
    """`integration.strongest` without branches."""
    high, low = max(one, other), min(one, other)
    return high if high > 0 else low


@njit(cache=True, nogil=True)
def _endpoint_posterior(faces, n, z, sigma, ends_outside, weights):
    """`partial_endpoint_posterior` of the cells between the n + 1 faces, and of one behind z if `ends_outside`.

    Returns the likeliest cell; -1 if none explains z.
    """
    scale = 1.0 / (sigma * math.sqrt(2.0))
    total, highest, best = 0.0, 0.0, -1
    first = faces[0] if n > 0 else z
    lower = math.erf((first - z) * scale)
    for k in range(n):
        upper = math.erf((faces[k + 1] - z) * scale)
        mass = upper - lower
        lower = upper
        weights[k] = 0.5 ** (faces[k] - first) * mass if mass > 0.0 else 0.0
        total += weights[k]
        if mass > highest:
            best, highest = k, mass
    if ends_outside:
        mass = math.erf((z + 1.0 - z) * scale) - math.erf(0.0)
        weights[n] = 0.5 ** (z - first) * mass
        total += weights[n]
        if mass > highest:
            best = n
    if total <= 0.0:
        return -1
    for k in range(n + ends_outside):
        weights[k] /= total
    return best


@njit(cache=True, nogil=True)
def _fallback_posterior(faces, n, z, sigma, ends_outside, weights):
    """What `partial_endpoint_posterior` does then."""
    entries, exits = np.append(faces[:n], z), np.append(faces[1 : n + 1], z + 1.0)
    return partial_endpoint_posterior(entries, exits, n + ends_outside, z, sigma, weights)


@njit(cache=True, nogil=True)
def _probability_limits(bounds):
    """Beyond these, rounding aside, a level is outside of its bounds: no logarithm is infinite."""
    least = 1.0 / (1.0 + math.exp((1.0 - bounds[0]) / STEPS_PER_NAT))
    return least, 1.0 / (1.0 + math.exp((-1.0 - bounds[1]) / STEPS_PER_NAT))


@njit(cache=True, nogil=True)
def _update_end_cells(
    cells, faces, weights, n, best, bounds, limits, pending, updated_cells, count
):
    """Add what a beam says of the n cells in which it may have ended; `limits` of its weights."""
    lowest, highest = bounds
    least, most = limits
    before = 0.0
    for k in range(n):
        p = min(max(weights[k] + 0.5 * before, least), most)
        update = lowest
        if p > least:
            update = math.floor(math.log(p / (1.0 - p)) * STEPS_PER_NAT + 0.5)
            update = min(max(update, lowest), highest)
        before += weights[k]
        passing = math.floor(update * min(faces[k + 1] - faces[k], 1.0) + 0.5)
        update = passing if update < 0 else update
        if update == 0 and k == best:
            update = -1
        cell = np.uint64(cells[k])
        current = pending[cell]
        updated_cells[np.uint64(count)] = cells[k]
        count += (current == 0) & (update != 0)
        pending[cell] = _merge_updates(current, update)
        if before > POSTERIOR_CUTOFF and k >= best:
            break
    return count


@njit(cache=True, nogil=True)
def _allocate_lanes(shape):
    """Arrays that hold `LANES` walks through a grid of this shape; see `_step_lanes`."""
    longest = LANES * (shape[0] + shape[1] + shape[2] + 6)
    distances, strides = np.zeros((9, LANES)), np.zeros((4, LANES), np.int64)
    counts = np.empty((2, LANES), np.int64)
    crossed = np.empty(longest, np.int64), np.empty(longest), np.empty(longest, np.int64)
    return (distances.ravel(), strides.ravel(), counts.ravel()), crossed


@njit(cache=True, nogil=True)
def _step_lanes(n, lowest, lanes, crossed):
    """Walk n steps with all beams at once.

    Step k of a lane fills place k LANES + lane of the `crossed`: cells, distances at which they are
    entered, and what a beam says of them that passes. `distances` holds for each beam the next face
    along three axes, the distance between faces, how far it is, and the two distances up to which
    `counts` counts the cells; `strides` the cell, and what it changes by.
    """
    distances, strides, counts = lanes
    cells, entries, log_odds_fixed = crossed
    for k in range(n):
        row = k * LANES
        for lane in range(LANES):
            x, y, z = distances[lane], distances[LANES + lane], distances[2 * LANES + lane]
            dx, dy, dz = (
                distances[3 * LANES + lane],
                distances[4 * LANES + lane],
                distances[5 * LANES + lane],
            )
            sx, sy, sz = strides[LANES + lane], strides[2 * LANES + lane], strides[3 * LANES + lane]
            cell, entry = strides[lane], distances[6 * LANES + lane]
            # the nearest face; of equals the first one, as `step_voxel` does
            over_x = (x <= y) & (x <= z)
            over_y = (y <= z) & (not over_x)
            over_z = not (over_x | over_y)
            t = min(x, min(y, z))
            cells[row + lane], entries[row + lane] = cell, entry
            log_odds_fixed[row + lane] = math.floor(lowest * min(t - entry, 1.0) + 0.5)
            counts[lane] += entry < distances[7 * LANES + lane]
            counts[LANES + lane] += entry < distances[8 * LANES + lane]
            distances[lane] = x + dx if over_x else x
            distances[LANES + lane] = y + dy if over_y else y
            distances[2 * LANES + lane] = z + dz if over_z else z
            distances[6 * LANES + lane] = t
            strides[lane] = (
                cell + (sx if over_x else 0) + (sy if over_y else 0) + (sz if over_z else 0)
            )


@njit(cache=True, nogil=True)
def _update_free_cells(lane, n, crossed, pending, updated_cells, count):
    """Claim the n cells that a beam passes for certain."""
    cells, _, log_odds_fixed = crossed
    k = np.uint64(lane)
    for _ in range(n):
        cell, update = cells[k], log_odds_fixed[k]
        index = np.uint64(cell)  # the compiler guards signed indices against negative ones
        current = np.int64(pending[index])
        updated_cells[np.uint64(count)] = cell
        count += (current == 0) & (update != 0)
        pending[index] = min(current, update) if current <= 0 else current
        k += np.uint64(LANES)
    return count


@njit(cache=True, nogil=True)
def _merge_hits(points, covariances, cells, lower, resolution, shape, min_sigma, precision, vector):
    """Merge the Gaussian of each beam's point into its cell; -1 for none."""
    _, ny, nz = shape
    offset = np.zeros(3)
    floor = (min_sigma * resolution) ** 2
    # Cells lie far from each other. Reads do not wait for one another as sums do: after these, what
    # is added to is near. They are kept, or the compiler would leave them out.
    for cell in cells:
        if cell >= 0:
            offset[0] += precision[cell, 0, 0] + precision[cell, 2, 2] + vector[cell, 2]
    for beam in range(len(cells)):
        cell = cells[beam]
        if cell >= 0:
            iz, iy, ix = cell % nz, cell // nz % ny, cell // (ny * nz)
            offset[0] = points[beam, 0] - ((ix + 0.5) * resolution + lower[0])
            offset[1] = points[beam, 1] - ((iy + 0.5) * resolution + lower[1])
            offset[2] = points[beam, 2] - ((iz + 0.5) * resolution + lower[2])
            add_observation(precision, vector, cell, covariances[beam], offset, floor)


@njit(cache=True, nogil=True, inline="always")  # a call with so many arrays takes 20 ns
def _init_lane(lane, p, ray, C, is_hit, resolution, shape, min_sigma, diagonal, lanes):
    """Put a beam into a lane; return its length z and sigma, in cells, and the steps it takes.

    `p` is the camera in cells, `ray` leads to the beam's end, in cells, and C is its covariance.
    """
    distances, strides, counts = lanes
    counts[lane] = counts[LANES + lane] = 0
    ux, uy, uz = ray
    z = math.sqrt(ux * ux + uy * uy + uz * uz)
    if z == 0.0:
        distances[7 * LANES + lane] = distances[8 * LANES + lane] = -1.0
        return z, 0.0, 0
    ux, uy, uz = ux / z, uy / z, uz / z
    free_until, stop, sigma = z, z, 0.0
    if is_hit:
        variance = (
            ux * C[0, 0] * ux + ux * C[0, 1] * uy + ux * C[0, 2] * uz
            + uy * C[1, 0] * ux + uy * C[1, 1] * uy + uy * C[1, 2] * uz
            + uz * C[2, 0] * ux + uz * C[2, 1] * uy + uz * C[2, 2] * uz
        )  # fmt: skip
        sigma = max(math.sqrt(max(variance, 0.0)) / resolution, min_sigma)
        free_until = z - RANGE_WINDOW * sigma - diagonal
        stop = z + RANGE_WINDOW * sigma
    nx, ny, nz = shape
    cx, sx, tx, dx, end_x = init_axis(p[0], ux, nx, ny * nz)
    cy, sy, ty, dy, end_y = init_axis(p[1], uy, ny, nz)
    cz, sz, tz, dz, end_z = init_axis(p[2], uz, nz, 1)
    end = min(end_x, end_y, end_z)
    distances[lane], distances[LANES + lane], distances[2 * LANES + lane] = tx, ty, tz
    distances[3 * LANES + lane], distances[4 * LANES + lane], distances[5 * LANES + lane] = (
        dx,
        dy,
        dz,
    )
    distances[6 * LANES + lane] = 0.0
    distances[7 * LANES + lane], distances[8 * LANES + lane] = min(free_until, end), min(stop, end)
    strides[lane] = cx + cy + cz
    strides[LANES + lane], strides[2 * LANES + lane], strides[3 * LANES + lane] = sx, sy, sz
    # along each axis one face more than whole cells, at most; and the step out of the last cell
    return z, sigma, int(min(stop, end) * (abs(ux) + abs(uy) + abs(uz))) + 5


@njit(cache=True, nogil=True)
def _copy_end_cells(lane, first, n, crossed, cells, faces):
    """Copy the n cells of a walk from `first` on, and the n + 1 faces around them."""
    for c in range(n):
        cells[c], faces[c] = (
            crossed[0][(first + c) * LANES + lane],
            crossed[1][(first + c) * LANES + lane],
        )
    faces[n] = crossed[1][(first + n) * LANES + lane]


@njit(cache=True, nogil=True)
def integrate_rays_simd(
    origin, points, covariances, hit, lower, resolution, shape, bounds,
    precision, vector, pending, updated_cells, min_sigma, diagonal,
):  # fmt: skip
    """Walk every beam of a 3-D scan; keep the strongest claim per cell; merge the Gaussians.

    Arguments and result are those of `integrate_rays`; `min_sigma` and `diagonal` its constants.
    """
    n_beams = len(points)
    lanes, crossed = _allocate_lanes(shape)
    longest = shape[0] + shape[1] + shape[2] + 6
    cells, faces, weights = np.empty(longest, np.int64), np.empty(longest), np.empty(longest)
    z, sigma, ends = np.empty(LANES), np.empty(LANES), np.full(n_beams, -1)
    limits = _probability_limits(bounds)
    p = (
        (origin[0] - lower[0]) / resolution,
        (origin[1] - lower[1]) / resolution,
        (origin[2] - lower[2]) / resolution,
    )
    count = 0
    for first in range(0, n_beams, LANES):
        n_steps = 0
        last = min(first + LANES, n_beams)
        for beam in range(first, last):
            ray = (
                (points[beam, 0] - origin[0]) / resolution,
                (points[beam, 1] - origin[1]) / resolution,
                (points[beam, 2] - origin[2]) / resolution,
            )
            lane = beam - first
            z[lane], sigma[lane], steps = _init_lane(
                lane, p, ray, covariances[beam], hit[beam], resolution, shape,
                min_sigma, diagonal, lanes,
            )  # fmt: skip
            n_steps = max(n_steps, steps)
        _step_lanes(n_steps, float(bounds[0]), lanes, crossed)
        for beam in range(first, last):
            lane = beam - first
            n_free, n = lanes[2][lane], lanes[2][LANES + lane] - lanes[2][lane]
            count = _update_free_cells(lane, n_free, crossed, pending, updated_cells, count)
            if not hit[beam] or z[lane] == 0.0:
                continue
            # cells in which the beam may have ended; the surface may also lie beyond the grid
            _copy_end_cells(lane, n_free, n, crossed, cells, faces)
            ends_outside = int(faces[n] < z[lane])
            best = _endpoint_posterior(faces, n, z[lane], sigma[lane], ends_outside, weights)
            if best < 0:
                best = _fallback_posterior(faces, n, z[lane], sigma[lane], ends_outside, weights)
            count = _update_end_cells(
                cells, faces, weights, n, best, bounds, limits, pending, updated_cells, count
            )
            if best < n:
                ends[beam] = cells[best]
    _merge_hits(points, covariances, ends, lower, resolution, shape, min_sigma, precision, vector)
    return count
