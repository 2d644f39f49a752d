"""Rays through the map one by one, in two and three dimensions: the updates of a scan's beams."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import borrowing_kernel, inlined_kernel, kernel
from coopmap_env.geometry import Ray, RayPosition, start_ray, step_ray
from coopmap_env.mapping.arrays import UpdateBuffers
from coopmap_env.mapping.beam import (
    MAX_PATH_IN_CELL,
    MIN_RANGE_SIGMA,
    RANGE_WINDOW,
    BeamParameters,
    beam_log_odds_fixed,
    endpoint_posterior,
    merge_updates,
    partial_endpoint_posterior,
    weight_by_path_length,
)
from coopmap_env.mapping.grid import GridGeometry
from coopmap_env.sensing import ScanArrays


class EndCells(NamedTuple):
    """Buffers for the cells in which one beam may have ended, along the beam."""

    cells: NDArray[np.int64]
    """Flat indices."""
    entries: NDArray[np.float64]
    """Distances at which the beam enters the cells, in cells."""
    exits: NDArray[np.float64]
    """Distances at which it leaves them, in cells."""
    weights: NDArray[np.float64]
    """Probabilities that the beam ended there."""


@borrowing_kernel
def _unit_direction(
    point: NDArray[np.float64],
    origin: NDArray[np.float64],
    resolution: float,
    direction: NDArray[np.float64],
) -> float:
    """Write the unit direction from `origin` to `point`; return the distance, cells."""
    z = 0.0
    for axis in range(len(point)):
        direction[axis] = (point[axis] - origin[axis]) / resolution
        z += direction[axis] * direction[axis]
    z = math.sqrt(z)
    if z > 0.0:
        for axis in range(len(point)):
            direction[axis] /= z
    return z


@borrowing_kernel
def _range_sigma(
    direction: NDArray[np.float64], covariance: NDArray[np.float64], resolution: float
) -> float:
    """Standard deviation of a point along the beam, cells."""
    variance = 0.0
    for i in range(len(covariance)):
        for j in range(len(covariance)):
            variance += direction[i] * covariance[i, j] * direction[j]
    # rounding takes the variance across a flat covariance below zero
    return max(math.sqrt(max(variance, 0.0)) / resolution, MIN_RANGE_SIGMA)


@inlined_kernel
def add_nonzero(current: int, update: int) -> int:
    """Sum of two updates, but 1 in place of 0: a pending update of zero means "not in the list"."""
    return current + update if current != -update else 1


@inlined_kernel
def _update_free_cells(
    ray: Ray,
    position: RayPosition,
    until: float,
    beam: BeamParameters,
    buffers: UpdateBuffers,
    count: int,
) -> tuple[RayPosition, int]:
    """Update the cells that a beam certainly passes; return its new position and the count."""
    pending, updated_cells, _ = buffers
    lowest = beam.lowest
    while beam.partial_surface and position.distance < until:
        cell, entry = position.cell, position.distance
        position = step_ray(ray, position)
        update = weight_by_path_length(lowest, position.distance - entry)
        index = np.uint64(cell)
        current = pending[index]
        updated_cells[np.uint64(count)] = cell
        count += (current == 0) & (update != 0)
        pending[index] = merge_updates(current, update)
    while position.distance < until:
        index = np.uint64(position.cell)
        current = pending[index]
        updated_cells[np.uint64(count)] = position.cell
        count += current == 0
        pending[index] = add_nonzero(current, lowest)
        position = step_ray(ray, position)
    return position, count


@inlined_kernel
def _find_end_cells(
    ray: Ray, position: RayPosition, until: float, ends: EndCells
) -> tuple[int, float]:
    """List the cells up to `until`; return how many, and the distance reached."""
    n = 0
    while position.distance < until:
        ends.cells[n] = position.cell
        ends.entries[n] = position.distance
        position = step_ray(ray, position)
        ends.exits[n] = position.distance
        n += 1
    return n, position.distance


@borrowing_kernel
def _weigh_end_cells(
    n: int, reached: float, z: float, sigma: float, beam: BeamParameters, ends: EndCells
) -> int:
    """Write the posterior over n cells; return the likeliest, n if it lies beyond the grid."""
    _, entries, exits, weights = ends
    candidates = n
    if reached < z:  # the surface may lie beyond the grid: one more cell, which no map has
        entries[n] = z
        exits[n] = z + 1.0
        candidates = n + 1
    if beam.partial_surface:
        return partial_endpoint_posterior(entries, exits, candidates, z, sigma, weights)
    at_entry = beam.surface_at_entry
    return endpoint_posterior(entries, exits, candidates, z, sigma, at_entry, weights)


@borrowing_kernel
def _update_end_cells(
    n: int, best: int, beam: BeamParameters, ends: EndCells, buffers: UpdateBuffers, count: int
) -> int:
    """Update the n cells in which a beam may have ended, `best` most likely; return the count."""
    cells, entries, exits, weights = ends
    pending, updated_cells, _ = buffers
    before = 0.0
    for k in range(n):
        update = beam_log_odds_fixed(weights[k], before, beam)
        before += weights[k]
        cell = np.uint64(cells[k])
        current = pending[cell]
        updated_cells[np.uint64(count)] = cells[k]
        if beam.partial_surface:
            if update < 0:
                update = weight_by_path_length(update, exits[k] - entries[k])
            if update == 0 and k == best:
                update = -1  # a cell that keeps the beam's point is one that was sampled
            count += current == 0 and update != 0
            pending[cell] = merge_updates(current, update)
        else:
            count += current == 0
            pending[cell] = add_nonzero(current, update)
        if before > beam.posterior_cutoff and k >= best:
            break
    return count


class BeamBuffers(NamedTuple):
    """Scratch for following one beam."""

    ends: EndCells
    start: NDArray[np.float64]
    """Position of the camera (3,), cells; in 2-D the last one is 0.5."""
    direction: NDArray[np.float64]
    """Unit direction of the beam (3,)."""
    offset: NDArray[np.float64]
    """Deviation of a point from its cell's center (D,)."""


@kernel
def allocate_beam(shape: tuple[int, int, int], dimension: int) -> BeamBuffers:
    """Scratch for the longest beam of a grid of 2 or 3 dimensions."""
    n = shape[0] + shape[1] + shape[2] + 3
    ends = EndCells(np.empty(n, np.int64), np.empty(n), np.empty(n), np.empty(n))
    return BeamBuffers(ends, np.full(3, 0.5), np.zeros(3), np.zeros(dimension))


@borrowing_kernel
def set_camera(origin: NDArray[np.float64], grid: GridGeometry, scratch: BeamBuffers) -> None:
    """Set the camera (D,), metres, from which the next beams come."""
    for axis in range(len(origin)):
        scratch.start[axis] = (origin[axis] - grid.lower[axis]) / grid.resolution


@borrowing_kernel
def integrate_beam(
    k: int,
    scan: ScanArrays,
    grid: GridGeometry,
    beam: BeamParameters,
    scratch: BeamBuffers,
    buffers: UpdateBuffers,
    count: int,
) -> tuple[int, int]:
    """Follow beam k of a scan; return the count of updated cells, and its hit cell or -1."""
    ends, start, direction, _ = scratch
    z = _unit_direction(scan.points[k], scan.origin, grid.resolution, direction)
    if z == 0.0:
        return count, -1
    free_until, stop, sigma = z, z, 0.0
    if scan.hit[k]:
        sigma = _range_sigma(direction, scan.covariances[k], grid.resolution)
        free_until = z - RANGE_WINDOW * sigma - MAX_PATH_IN_CELL
        stop = z + RANGE_WINDOW * sigma
    ray, position = start_ray(start, direction, grid.shape)
    free_until = min(free_until, ray.end)
    position, count = _update_free_cells(ray, position, free_until, beam, buffers, count)
    if not scan.hit[k]:
        return count, -1
    n, reached = _find_end_cells(ray, position, min(stop, ray.end), ends)
    best = _weigh_end_cells(n, reached, z, sigma, beam, ends)
    count = _update_end_cells(n, best, beam, ends, buffers, count)
    return count, ends.cells[best] if best < n else -1


@borrowing_kernel
def integrate_rays(
    scan: ScanArrays,
    grid: GridGeometry,
    beam: BeamParameters,
    scratch: BeamBuffers,
    buffers: UpdateBuffers,
    hit_cells: NDArray[np.int64],
) -> int:
    """Follow every beam of a scan; collect its updates per cell, and the cells of its points.

    The updates of a cell are summed; where surfaces are partial, the strongest counts instead.
    Writes the cell to which each beam's point belongs (n_beams,), -1 for none. Returns how many
    cells `buffers.updated_cells` lists.
    """
    set_camera(scan.origin, grid, scratch)
    count = 0
    for k in range(len(scan.points)):
        count, hit_cells[k] = integrate_beam(k, scan, grid, beam, scratch, buffers, count)
    return count
