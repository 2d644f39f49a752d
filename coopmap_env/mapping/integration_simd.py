"""`integrate_rays` for 3-D scans with partial surfaces, equal to the last bit and faster.

Rays are stepped `LANES` at once (see `ray_lanes`). Only then do they update their cells, one beam
after the other in the scan's order.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import inlined_kernel, kernel
from coopmap_env.mapping._ray_lanes import (
    LANES,
    N_CROSSED,
    N_FREE,
    CrossedCells,
    allocate_lanes,
    init_lane,
    step_lanes,
)
from coopmap_env.mapping.arrays import UpdateBuffers
from coopmap_env.mapping.beam import (
    BeamParameters,
    half_power,
    partial_endpoint_posterior,
)
from coopmap_env.mapping.grid import GridGeometry
from coopmap_env.mapping.log_odds import STEPS_PER_NAT
from coopmap_env.sensing import ScanArrays


class EndCellFaces(NamedTuple):
    """Buffers for the n cells in which one beam may have ended, along the beam."""

    cells: NDArray[np.int64]
    """Flat indices."""
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
def _endpoint_posterior(
    n: int, z: float, sigma: float, ends_outside: int, ends: EndCellFaces
) -> int:
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
        weights[k] = half_power(faces[k] - first) * mass if mass > 0.0 else 0.0
        total += weights[k]
        if mass > highest:
            best, highest = k, mass
    if ends_outside:
        mass = math.erf((z + 1.0 - z) * scale) - math.erf(0.0)
        weights[n] = half_power(z - first) * mass
        total += weights[n]
        if mass > highest:
            best = n
    if total <= 0.0:
        return -1
    for k in range(n + ends_outside):
        weights[k] /= total
    return best


@kernel
def _fallback_posterior(
    n: int, z: float, sigma: float, ends_outside: int, ends: EndCellFaces
) -> int:
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
    ends: EndCellFaces,
    buffers: UpdateBuffers,
    count: int,
) -> int:
    """Update the n cells in which a beam may have ended, `best` most likely; return the count."""
    cells, faces, weights = ends
    pending, updated_cells, _ = buffers
    lowest, highest = beam.lowest, beam.highest
    behind, cutoff = beam.behind, beam.posterior_cutoff
    least, most = limits
    before = 0.0
    for k in range(n):
        p = min(max(weights[k] + behind * before, least), most)
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
        if before > cutoff and k >= best:
            break
    return count


@kernel
def _update_free_cells(
    lane: int, n: int, crossed: CrossedCells, buffers: UpdateBuffers, count: int
) -> int:
    """Update the n cells that a beam certainly passes; return the count."""
    cells, _, free_updates = crossed
    pending, updated_cells, _ = buffers
    k = np.uint64(lane)
    for _ in range(n):
        cell, update = cells[k], np.int64(free_updates[k])
        index = np.uint64(cell)
        current = np.int64(pending[index])
        updated_cells[np.uint64(count)] = cell
        count += (current == 0) & (update != 0)
        pending[index] = min(current, update) if current <= 0 else current
        k += np.uint64(LANES)
    return count


@kernel
def _copy_end_cells(
    lane: int, first: int, n: int, crossed: CrossedCells, ends: EndCellFaces
) -> None:
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
    hit_cells: NDArray[np.int64],
) -> int:
    """Follow every beam of a 3-D scan with partial surfaces; see `integrate_rays`."""
    origin, points, covariances, hit = scan
    lower, resolution, shape = grid
    n_beams = len(points)
    lanes, crossed = allocate_lanes(shape)
    longest = shape[0] + shape[1] + shape[2] + 6
    ends = EndCellFaces(np.empty(longest, np.int64), np.empty(longest), np.empty(longest))
    z, sigma = np.empty(LANES), np.empty(LANES)
    hit_cells[:] = -1
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
            z[lane], sigma[lane], steps = init_lane(
                lane, start, path, covariances[k], hit[k], grid, lanes
            )
            n_steps = max(n_steps, steps)
        step_lanes(n_steps, float(beam.lowest), lanes, crossed)
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
    return count
