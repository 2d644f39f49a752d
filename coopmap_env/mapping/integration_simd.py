"""`integrate_rays` for 3-D scans with partial surfaces, equal to the last bit and faster.

Rays are stepped `LANES` at once (see `ray_lanes`). Only then do they update their cells, one beam
after the other in the scan's order.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.elementary import inlined_erf
from coopmap_env.core.kernels import (
    borrowing_kernel,
    inlined_kernel,
    kernel,
    unchecked_division_kernel,
)
from coopmap_env.mapping._ray_lanes import (
    FREE_UNTIL,
    IS_HIT,
    LANES,
    LENGTH,
    N_CROSSED,
    N_FREE,
    SIGMA,
    CrossedCells,
    Lanes,
    allocate_lanes,
    init_lanes,
    load_beams,
    step_lanes,
)
from coopmap_env.mapping.arrays import UpdateBuffers
from coopmap_env.mapping.beam import BeamParameters, inlined_half_power, partial_endpoint_posterior
from coopmap_env.mapping.grid import GridGeometry
from coopmap_env.mapping.log_odds import STEPS_PER_NAT
from coopmap_env.sensing import ScanArrays


class EndWindows(NamedTuple):
    """The cells in which the hits of all lanes may have ended."""

    start: NDArray[np.int64]
    """First face of each lane in the lists of all faces (LANES + 1,)."""
    deviations: NDArray[np.float64]
    """Distances of the faces from the points, in sqrt(2) standard deviations; then their error
    functions."""
    distances: NDArray[np.float64]
    """Distances of the faces from the first one, cells; then the prior: 0.5 to that power."""
    weights: NDArray[np.float64]
    """Probabilities that a beam ended in its cells."""


@kernel
def allocate_windows(shape: tuple[int, int, int]) -> EndWindows:
    """Buffers for `LANES` beams through a grid of this shape."""
    n = shape[0] + shape[1] + shape[2] + 9
    start = np.empty(LANES + 1, np.int64)
    return EndWindows(start, np.empty(LANES * n), np.empty(LANES * n), np.empty(n))


@inlined_kernel
def _merge_updates(one: int, other: int) -> int:
    """`beam.merge_updates` without branches."""
    high, low = max(one, other), min(one, other)
    return high if high > 0 else low


@borrowing_kernel
def _probability_limits(beam: BeamParameters) -> tuple[float, float]:
    """Probabilities beyond which an update is outside of its bounds: no logarithm is infinite."""
    least = 1.0 / (1.0 + math.exp((1.0 - beam.lowest) / STEPS_PER_NAT))
    return least, 1.0 / (1.0 + math.exp((-1.0 - beam.highest) / STEPS_PER_NAT))


@borrowing_kernel
def _update_free_cells(
    lane: int, n: int, crossed: CrossedCells, buffers: UpdateBuffers, count: int
) -> int:
    """Update the n cells that a beam certainly passes; return the count."""
    cells, _, free_updates = crossed
    pending, updated_cells, _ = buffers
    for k in range(lane, lane + n * LANES, LANES):
        cell, update = cells[np.uint64(k)], free_updates[np.uint64(k)]
        index = np.uint64(cell)
        current = pending[index]
        updated_cells[np.uint64(count)] = cell
        count += (current == 0) & (update != 0)
        pending[index] = min(current, update) if current <= 0 else current
    return count


@borrowing_kernel
def _window_start(lane: int, n_free: int, lanes: Lanes, crossed: CrossedCells) -> float:
    """Distance at which a beam enters the first cell in which it may have ended.

    The n_free cells that it certainly passes may count more: those whose mass is exactly 0.
    """
    k = n_free
    while k > 0 and crossed.entries[(k - 1) * LANES + lane] >= lanes.distances[FREE_UNTIL + lane]:
        k -= 1
    return crossed.entries[k * LANES + lane]


@borrowing_kernel
def _list_faces(lanes: Lanes, crossed: CrossedCells, windows: EndWindows) -> int:
    """List the faces of the cells in which the hits of all lanes may have ended; how many.

    Those of a lane are one more than its cells, and two more if the surface may lie beyond the
    grid: z and z + 1.
    """
    count = 0
    for lane in range(LANES):
        windows.start[lane] = count
        first = lanes.counts[N_FREE + lane]
        n = lanes.counts[N_CROSSED + lane] - first
        if n == 0 or lanes.distances[IS_HIT + lane] == 0.0:
            continue
        z, sigma = lanes.distances[LENGTH + lane], lanes.distances[SIGMA + lane]
        start, scale = _window_start(lane, first, lanes, crossed), 1.0 / (sigma * math.sqrt(2.0))
        for k in range(first, first + n + 1):
            face = crossed.entries[k * LANES + lane]
            windows.deviations[count] = (face - z) * scale
            windows.distances[count] = face - start
            count += 1
        if crossed.entries[(first + n) * LANES + lane] < z:
            windows.deviations[count], windows.deviations[count + 1] = 0.0, (z + 1.0 - z) * scale
            windows.distances[count] = windows.distances[count + 1] = z - start
            count += 2
    windows.start[LANES] = count
    return count


@unchecked_division_kernel
def _evaluate_faces(n: int, windows: EndWindows) -> None:
    """Write the error function of the first n deviations, and the prior at the distances."""
    deviations, distances = windows.deviations, windows.distances
    for k in range(n):
        deviations[k] = inlined_erf(deviations[k])
    for k in range(n):
        distances[k] = inlined_half_power(distances[k])


@borrowing_kernel
def _endpoint_posterior(first: int, n: int, n_faces: int, windows: EndWindows) -> int:
    """`partial_endpoint_posterior` of n cells whose faces are listed from `first` on.

    If there are more faces than those of the cells, the surface may also lie beyond the grid; the
    result then is n. It is -1 if no cell explains the beam's length.
    """
    errors, priors, weights = windows.deviations, windows.distances, windows.weights
    total, highest, best = 0.0, 0.0, -1
    for k in range(n):
        mass = errors[first + k + 1] - errors[first + k]
        weights[k] = priors[first + k] * mass if mass > 0.0 else 0.0
        total += weights[k]
        if mass > highest:
            best, highest = k, mass
    if n_faces > n + 1:
        mass = errors[first + n + 2] - errors[first + n + 1]
        total += priors[first + n + 1] * mass
        if mass > highest:
            best = n
    if total <= 0.0:
        return -1
    for k in range(n):
        weights[k] /= total
    return best


@borrowing_kernel
def _fallback_posterior(
    lane: int, first: int, n: int, lanes: Lanes, crossed: CrossedCells, windows: EndWindows
) -> int:
    """The result of `partial_endpoint_posterior` when no cell explains the length.

    What the windows hold of the lane's faces is overwritten.
    """
    z, sigma = lanes.distances[LENGTH + lane], lanes.distances[SIGMA + lane]
    begin = windows.start[lane]
    entries = windows.deviations[begin : begin + n + 1]
    exits = windows.distances[begin : begin + n + 1]
    for k in range(n):
        entries[k] = crossed.entries[(first + k) * LANES + lane]
        exits[k] = crossed.entries[(first + k + 1) * LANES + lane]
    reached = crossed.entries[(first + n) * LANES + lane]
    entries[n], exits[n] = z, z + 1.0
    return partial_endpoint_posterior(
        entries, exits, n + int(reached < z), z, sigma, windows.weights
    )


@borrowing_kernel
def _update_end_cells(
    lane: int,
    first: int,
    n: int,
    best: int,
    beam: BeamParameters,
    limits: tuple[float, float],
    crossed: CrossedCells,
    weights: NDArray[np.float64],
    buffers: UpdateBuffers,
    count: int,
) -> int:
    """Update n cells of a lane from `first` on, `best` the likeliest end; return the count."""
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
        step = np.uint64((first + k) * LANES + lane)
        path = crossed.entries[step + np.uint64(LANES)] - crossed.entries[step]
        passing = math.floor(update * min(path, 1.0) + 0.5)
        update = passing if update < 0 else update
        if update == 0 and k == best:
            update = -1
        cell = np.uint64(crossed.cells[step])
        current = pending[cell]
        updated_cells[np.uint64(count)] = cell
        count += (current == 0) & (update != 0)
        pending[cell] = _merge_updates(current, update)
        if before > cutoff and k >= best:
            break
    return count


@kernel
def integrate_rays_simd(
    scan: ScanArrays,
    grid: GridGeometry,
    beam: BeamParameters,
    buffers: UpdateBuffers,
    hit_cells: NDArray[np.int64],
) -> int:
    """Follow every beam of a 3-D scan with partial surfaces; see `integrate_rays`."""
    lanes, crossed = allocate_lanes(grid.shape)
    windows = allocate_windows(grid.shape)
    return _integrate_rays(scan, grid, beam, lanes, crossed, windows, buffers, hit_cells)


@borrowing_kernel
def _integrate_rays(
    scan: ScanArrays,
    grid: GridGeometry,
    beam: BeamParameters,
    lanes: Lanes,
    crossed: CrossedCells,
    windows: EndWindows,
    buffers: UpdateBuffers,
    hit_cells: NDArray[np.int64],
) -> int:
    origin, lower, resolution = scan.origin, grid.lower, grid.resolution
    limits = _probability_limits(beam)
    start = (
        (origin[0] - lower[0]) / resolution,
        (origin[1] - lower[1]) / resolution,
        (origin[2] - lower[2]) / resolution,
    )
    count = 0
    for first_beam in range(0, len(hit_cells), LANES):
        load_beams(first_beam, scan, lanes.distances)
        n_steps = int(init_lanes(start, grid, lanes))
        step_lanes(n_steps, float(beam.lowest), lanes, crossed)
        _evaluate_faces(_list_faces(lanes, crossed, windows), windows)
        for k in range(first_beam, min(first_beam + LANES, len(hit_cells))):
            lane = k - first_beam
            first = lanes.counts[N_FREE + lane]
            n = lanes.counts[N_CROSSED + lane] - first
            count = _update_free_cells(lane, first, crossed, buffers, count)
            hit_cells[k] = -1
            n_faces = windows.start[lane + 1] - windows.start[lane]
            if n_faces == 0:
                continue
            best = _endpoint_posterior(windows.start[lane], n, n_faces, windows)
            if best < 0:
                best = _fallback_posterior(lane, first, n, lanes, crossed, windows)
            count = _update_end_cells(
                lane, first, n, best, beam, limits, crossed, windows.weights, buffers, count
            )
            if best < n:
                hit_cells[k] = crossed.cells[(first + best) * LANES + lane]
    return count
