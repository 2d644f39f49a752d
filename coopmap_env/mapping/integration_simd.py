"""`integrate_rays` for 3-D scans with partial surfaces, equal to the last bit and faster.

A traversal asks at each step which face comes next, and a processor guesses the answer wrong so
often that this takes half of the time. So `LANES` beams are stepped side by side, without any
branch, in vector registers. Only then do they update their cells, one beam after the other in the
scan's order. The points are merged at the end: they lie far from each other in memory, and reads
that are close in the program are fetched together. 3000 beams of 60 cells: 0.73 ms instead of
0.99.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import inlined_kernel, kernel
from coopmap_env.geometry.traversal import start_ray
from coopmap_env.mapping.arrays import SurfaceArrays, UpdateBuffers
from coopmap_env.mapping.beam import (
    MAX_PATH_IN_CELL,
    MIN_RANGE_SIGMA,
    POSTERIOR_CUTOFF,
    RANGE_WINDOW,
    BeamParameters,
    partial_endpoint_posterior,
)
from coopmap_env.mapping.gaussian import add_observation
from coopmap_env.mapping.grid import GridGeometry
from coopmap_env.mapping.log_odds import STEPS_PER_NAT
from coopmap_env.sensing.scan import ScanArrays

LANES = 16
"""Beams that are stepped at once: two registers of eight, or four of four."""

# Rows of `Lanes.distances`, of LANES numbers each, in cells. One array for all: of nine, the
# compiler would not know that they do not overlap, and would not use vector registers.
NEXT_X, NEXT_Y, NEXT_Z = 0 * LANES, 1 * LANES, 2 * LANES
"""Distance to the next face across each axis."""
DELTA_X, DELTA_Y, DELTA_Z = 3 * LANES, 4 * LANES, 5 * LANES
"""Distance between two faces."""
ENTRY = 6 * LANES
"""Distance at which the current cell is entered."""
FREE_UNTIL, STOP = 7 * LANES, 8 * LANES
"""Distances up to which cells are certainly free, and up to which the beam may have ended."""

# rows of `Lanes.strides`
CELL = 0 * LANES
"""Flat number of the current cell."""
STRIDE_X, STRIDE_Y, STRIDE_Z = 1 * LANES, 2 * LANES, 3 * LANES
"""Change of it at a step along each axis."""

# rows of `Lanes.counts`
N_FREE, N_CROSSED = 0 * LANES, 1 * LANES
"""Cells entered before FREE_UNTIL, and before STOP."""


class Lanes(NamedTuple):
    """The state of `LANES` rays that are stepped side by side; rows as named above."""

    distances: NDArray[np.float64]
    """Shape (9 LANES,)."""
    strides: NDArray[np.int64]
    """Shape (4 LANES,)."""
    counts: NDArray[np.int64]
    """Shape (2 LANES,)."""


class CrossedCells(NamedTuple):
    """The cells that the rays of all lanes cross; step k of a lane is at k LANES + lane."""

    cells: NDArray[np.int64]
    """Flat numbers."""
    entries: NDArray[np.float64]
    """Distances at which they are entered, cells."""
    free_updates: NDArray[np.int64]
    """Updates by a beam that passes them."""


class EndCells(NamedTuple):
    """Buffers for the n cells in which one beam may have ended, along the beam."""

    cells: NDArray[np.int64]
    """Flat numbers."""
    faces: NDArray[np.float64]
    """The n + 1 distances at which the beam crosses their faces, cells."""
    weights: NDArray[np.float64]
    """Probabilities that the beam ended there; one more for beyond the grid."""


@inlined_kernel
def _merge_updates(one: int, other: int) -> int:
    """`beam.merge_updates` without branches."""
    high, low = max(one, other), min(one, other)
    return high if high > 0 else low


@kernel
def _endpoint_posterior(n: int, z: float, sigma: float, ends_outside: int, ends: EndCells) -> int:
    """`partial_endpoint_posterior` of n cells, and of one behind z if `ends_outside` is 1.

    Returns the likeliest cell; -1 if none explains z.
    """
    _, faces, weights = ends
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


@kernel
def _fallback_posterior(n: int, z: float, sigma: float, ends_outside: int, ends: EndCells) -> int:
    """The result of `partial_endpoint_posterior` when no cell explains z."""
    entries, exits = np.append(ends.faces[:n], z), np.append(ends.faces[1 : n + 1], z + 1.0)
    return partial_endpoint_posterior(entries, exits, n + ends_outside, z, sigma, ends.weights)


@kernel
def _probability_limits(beam: BeamParameters) -> tuple[float, float]:
    """Probabilities beyond which an update is outside of its bounds: no logarithm is infinite."""
    least = 1.0 / (1.0 + math.exp((1.0 - beam.lowest) / STEPS_PER_NAT))
    return least, 1.0 / (1.0 + math.exp((-1.0 - beam.highest) / STEPS_PER_NAT))


@kernel
def _update_end_cells(
    n: int,
    best: int,
    beam: BeamParameters,
    limits: tuple[float, float],
    ends: EndCells,
    buffers: UpdateBuffers,
    count: int,
) -> int:
    """Update the n cells in which a beam may have ended, `best` most likely; return the count."""
    cells, faces, weights = ends
    pending, updated_cells = buffers
    lowest, highest = beam.lowest, beam.highest
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


@kernel
def _allocate_lanes(shape: tuple[int, int, int]) -> tuple[Lanes, CrossedCells]:
    """Buffers for `LANES` rays through a grid of this shape."""
    longest = LANES * (shape[0] + shape[1] + shape[2] + 6)
    lanes = Lanes(np.zeros(9 * LANES), np.zeros(4 * LANES, np.int64), np.empty(2 * LANES, np.int64))
    return lanes, CrossedCells(
        np.empty(longest, np.int64), np.empty(longest), np.empty(longest, np.int64)
    )


@kernel
def _step_lanes(n: int, lowest: float, lanes: Lanes, crossed: CrossedCells) -> None:
    """Step all rays n times; list the cells that they cross, and count them."""
    distances, strides, counts = lanes
    cells, entries, free_updates = crossed
    for k in range(n):
        row = k * LANES
        for lane in range(LANES):
            x, y, z = distances[NEXT_X + lane], distances[NEXT_Y + lane], distances[NEXT_Z + lane]
            dx, dy, dz = (
                distances[DELTA_X + lane],
                distances[DELTA_Y + lane],
                distances[DELTA_Z + lane],
            )
            sx, sy, sz = (
                strides[STRIDE_X + lane],
                strides[STRIDE_Y + lane],
                strides[STRIDE_Z + lane],
            )
            cell, entry = strides[CELL + lane], distances[ENTRY + lane]
            # the nearest face; of equals the first one, as `step_ray` does
            over_x = (x <= y) & (x <= z)
            over_y = (y <= z) & (not over_x)
            over_z = not (over_x | over_y)
            t = min(x, min(y, z))
            cells[row + lane], entries[row + lane] = cell, entry
            free_updates[row + lane] = math.floor(lowest * min(t - entry, 1.0) + 0.5)
            counts[N_FREE + lane] += entry < distances[FREE_UNTIL + lane]
            counts[N_CROSSED + lane] += entry < distances[STOP + lane]
            distances[NEXT_X + lane] = x + dx if over_x else x
            distances[NEXT_Y + lane] = y + dy if over_y else y
            distances[NEXT_Z + lane] = z + dz if over_z else z
            distances[ENTRY + lane] = t
            strides[CELL + lane] = (
                cell + (sx if over_x else 0) + (sy if over_y else 0) + (sz if over_z else 0)
            )


@kernel
def _update_free_cells(
    lane: int, n: int, crossed: CrossedCells, buffers: UpdateBuffers, count: int
) -> int:
    """Update the n cells that a beam certainly passes; return the count."""
    cells, _, free_updates = crossed
    pending, updated_cells = buffers
    k = np.uint64(lane)
    for _ in range(n):
        cell, update = cells[k], free_updates[k]
        index = np.uint64(cell)  # the compiler guards signed indices against negative ones
        current = np.int64(pending[index])
        updated_cells[np.uint64(count)] = cell
        count += (current == 0) & (update != 0)
        pending[index] = min(current, update) if current <= 0 else current
        k += np.uint64(LANES)
    return count


@kernel
def _merge_hits(
    points: NDArray[np.float64],
    covariances: NDArray[np.float64],
    cells: NDArray[np.int64],
    grid: GridGeometry,
    surfaces: SurfaceArrays,
) -> None:
    """Merge the Gaussian of each beam's point into its cell; -1 for none."""
    lower, resolution, (_, ny, nz) = grid
    precision, information_vector = surfaces
    offset = np.zeros(3)
    floor = (MIN_RANGE_SIGMA * resolution) ** 2
    # Cells lie far from each other. Reads do not wait for one another as sums do: after these, what
    # is added to is near. They are kept, or the compiler would leave them out.
    for cell in cells:
        if cell >= 0:
            offset[0] += precision[cell, 0, 0] + precision[cell, 2, 2] + information_vector[cell, 2]
    for beam in range(len(cells)):
        cell = cells[beam]
        if cell >= 0:
            iz, iy, ix = cell % nz, cell // nz % ny, cell // (ny * nz)
            offset[0] = points[beam, 0] - ((ix + 0.5) * resolution + lower[0])
            offset[1] = points[beam, 1] - ((iy + 0.5) * resolution + lower[1])
            offset[2] = points[beam, 2] - ((iz + 0.5) * resolution + lower[2])
            add_observation(surfaces, cell, covariances[beam], offset, floor)


@inlined_kernel  # a call with so many arrays takes 20 ns
def _init_lane(
    lane: int,
    start: tuple[float, float, float],
    path: tuple[float, float, float],
    covariance: NDArray[np.float64],
    is_hit: bool,
    grid: GridGeometry,
    lanes: Lanes,
) -> tuple[float, float, int]:
    """Put a ray into a lane; return its length z and sigma, in cells, and the steps it takes.

    `start` is the camera in cells and `path` leads from there to the point, in cells.
    """
    distances, strides, counts = lanes
    counts[N_FREE + lane] = counts[N_CROSSED + lane] = 0
    ux, uy, uz = path
    z = math.sqrt(ux * ux + uy * uy + uz * uz)
    if z == 0.0:
        distances[FREE_UNTIL + lane] = distances[STOP + lane] = -1.0
        return z, 0.0, 0
    ux, uy, uz = ux / z, uy / z, uz / z
    free_until, stop, sigma = z, z, 0.0
    if is_hit:
        C = covariance
        variance = (
            ux * C[0, 0] * ux + ux * C[0, 1] * uy + ux * C[0, 2] * uz
            + uy * C[1, 0] * ux + uy * C[1, 1] * uy + uy * C[1, 2] * uz
            + uz * C[2, 0] * ux + uz * C[2, 1] * uy + uz * C[2, 2] * uz
        )  # fmt: skip
        sigma = max(math.sqrt(max(variance, 0.0)) / grid.resolution, MIN_RANGE_SIGMA)
        free_until = z - RANGE_WINDOW * sigma - MAX_PATH_IN_CELL
        stop = z + RANGE_WINDOW * sigma
    ray, position = start_ray(start, (ux, uy, uz), grid.shape)
    stop = min(stop, ray.end)
    distances[NEXT_X + lane] = position.next_x
    distances[NEXT_Y + lane] = position.next_y
    distances[NEXT_Z + lane] = position.next_z
    distances[DELTA_X + lane], distances[DELTA_Y + lane], distances[DELTA_Z + lane] = ray.deltas
    distances[ENTRY + lane] = 0.0
    distances[FREE_UNTIL + lane], distances[STOP + lane] = min(free_until, ray.end), stop
    strides[CELL + lane] = position.cell
    strides[STRIDE_X + lane], strides[STRIDE_Y + lane], strides[STRIDE_Z + lane] = ray.strides
    # along each axis one face more than whole cells, at most; and the step out of the last cell
    return z, sigma, int(stop * (abs(ux) + abs(uy) + abs(uz))) + 5


@kernel
def _copy_end_cells(lane: int, first: int, n: int, crossed: CrossedCells, ends: EndCells) -> None:
    """Copy the n cells of a lane from `first` on, and the n + 1 faces around them."""
    for k in range(n):
        ends.cells[k] = crossed.cells[(first + k) * LANES + lane]
        ends.faces[k] = crossed.entries[(first + k) * LANES + lane]
    ends.faces[n] = crossed.entries[(first + n) * LANES + lane]


@kernel
def integrate_rays_simd(
    scan: ScanArrays,
    grid: GridGeometry,
    beam: BeamParameters,
    buffers: UpdateBuffers,
    surfaces: SurfaceArrays,
) -> int:
    """Follow every beam of a 3-D scan with partial surfaces; see `integrate_rays`."""
    origin, points, covariances, hit = scan
    lower, resolution, shape = grid
    n_beams = len(points)
    lanes, crossed = _allocate_lanes(shape)
    longest = shape[0] + shape[1] + shape[2] + 6
    ends = EndCells(np.empty(longest, np.int64), np.empty(longest), np.empty(longest))
    z, sigma, hit_cells = np.empty(LANES), np.empty(LANES), np.full(n_beams, -1)
    limits = _probability_limits(beam)
    start = (
        (origin[0] - lower[0]) / resolution,
        (origin[1] - lower[1]) / resolution,
        (origin[2] - lower[2]) / resolution,
    )
    count = 0
    for first in range(0, n_beams, LANES):
        n_steps = 0
        last = min(first + LANES, n_beams)
        for k in range(first, last):
            path = (
                (points[k, 0] - origin[0]) / resolution,
                (points[k, 1] - origin[1]) / resolution,
                (points[k, 2] - origin[2]) / resolution,
            )
            lane = k - first
            z[lane], sigma[lane], steps = _init_lane(
                lane, start, path, covariances[k], hit[k], grid, lanes
            )
            n_steps = max(n_steps, steps)
        _step_lanes(n_steps, float(beam.lowest), lanes, crossed)
        for k in range(first, last):
            lane = k - first
            n_free = lanes.counts[N_FREE + lane]
            n = lanes.counts[N_CROSSED + lane] - n_free
            count = _update_free_cells(lane, n_free, crossed, buffers, count)
            if not hit[k] or z[lane] == 0.0:
                continue
            # cells in which the beam may have ended; the surface may also lie beyond the grid
            _copy_end_cells(lane, n_free, n, crossed, ends)
            ends_outside = int(ends.faces[n] < z[lane])
            best = _endpoint_posterior(n, z[lane], sigma[lane], ends_outside, ends)
            if best < 0:
                best = _fallback_posterior(n, z[lane], sigma[lane], ends_outside, ends)
            count = _update_end_cells(n, best, beam, limits, ends, buffers, count)
            if best < n:
                hit_cells[k] = ends.cells[best]
    _merge_hits(points, covariances, hit_cells, grid, surfaces)
    return count
