"""Rays that are stepped side by side through a grid, without any branch, in vector registers.

A traversal asks at each step which face comes next, and a processor guesses the answer wrong so
often that this takes half of the time. `LANES` rays at once need no guess.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import (
    borrowing_kernel,
    inlined_kernel,
    kernel,
    unchecked_division_kernel,
)
from coopmap_env.geometry.traversal import BORDER_FACTOR
from coopmap_env.mapping.beam import MAX_PATH_IN_CELL, MIN_RANGE_SIGMA, RANGE_WINDOW
from coopmap_env.mapping.grid import GridGeometry
from coopmap_env.sensing import ScanArrays

LANES = 16
"""Beams that are stepped at once: two registers of eight, or four of four."""
MASSLESS = 6.0001 * math.sqrt(2.0)
"""Standard deviations from the end of a beam beyond which the error function is exactly 1."""

# Rows of `Lanes.distances`, of LANES numbers each, in cells. One array for all: of many, the
# compiler would not know that they do not overlap, and would not use vector registers.
NEXT_X, NEXT_Y, NEXT_Z = 0 * LANES, 1 * LANES, 2 * LANES
"""Distance to the next face across each axis."""
DELTA_X, DELTA_Y, DELTA_Z = 3 * LANES, 4 * LANES, 5 * LANES
"""Distance between two faces."""
ENTRY = 6 * LANES
"""Distance at which the current cell is entered."""
FREE_UNTIL, MASSLESS_UNTIL, STOP = 7 * LANES, 8 * LANES, 9 * LANES
"""Distances up to which cells are certainly free, cells have no part of the posterior, and the beam
may have ended."""
LENGTH, SIGMA = 10 * LANES, 11 * LANES
"""Measured length of the beam and its standard deviation."""
N_STEPS = 12 * LANES
"""Steps up to STOP, at most."""
PATH = 13 * LANES
"""Three rows: from the camera to the point, metres."""
COVARIANCE = 16 * LANES
"""Nine rows: covariance of the point, square metres; 0 without a hit."""
IS_HIT = 25 * LANES
"""1 for a hit, 0 for none."""
N_ROWS = 26

# rows of `Lanes.strides`
CELL = 0 * LANES
"""Flat index of the current cell."""
STRIDE_X, STRIDE_Y, STRIDE_Z = 1 * LANES, 2 * LANES, 3 * LANES
"""Change of it at a step along each axis."""

# rows of `Lanes.counts`
N_FREE, N_CROSSED = 0 * LANES, 1 * LANES
"""Cells that the beam certainly passes, and cells entered before STOP."""


class Lanes(NamedTuple):
    """The state of `LANES` rays that are stepped side by side; rows as named above."""

    distances: NDArray[np.float64]
    """Shape (N_ROWS LANES,)."""
    strides: NDArray[np.int64]
    """Shape (4 LANES,)."""
    counts: NDArray[np.int64]
    """Shape (2 LANES,)."""


class CrossedCells(NamedTuple):
    """The cells that the rays of all lanes cross; step k of a lane is at k LANES + lane."""

    cells: NDArray[np.int32]
    """Flat indices."""
    entries: NDArray[np.float64]
    """Distances at which they are entered, cells."""
    free_updates: NDArray[np.int32]
    """Updates by a beam that passes them."""


@kernel
def allocate_lanes(shape: tuple[int, int, int]) -> tuple[Lanes, CrossedCells]:
    """Buffers for `LANES` rays through a grid of this shape."""
    n = LANES * (shape[0] + shape[1] + shape[2] + 6)
    lanes = Lanes(
        np.zeros(N_ROWS * LANES), np.zeros(4 * LANES, np.int64), np.empty(2 * LANES, np.int64)
    )
    return lanes, CrossedCells(np.empty(n, np.int32), np.empty(n), np.empty(n, np.int32))


@borrowing_kernel
def load_beams(first: int, scan: ScanArrays, distances: NDArray[np.float64]) -> None:
    """Copy the beams from `first` on into the lanes; a lane without a beam gets one of length 0."""
    origin, points, covariances, hit = scan
    ox, oy, oz = origin[0], origin[1], origin[2]
    n = min(LANES, len(points) - first)
    for lane in range(n):
        k = np.uint64(first + lane)
        distances[IS_HIT + lane] = hit[k]
        distances[PATH + lane] = points[k, 0] - ox
        distances[PATH + LANES + lane] = points[k, 1] - oy
        distances[PATH + 2 * LANES + lane] = points[k, 2] - oz
        if hit[k]:
            for i in range(3):
                for j in range(3):
                    distances[COVARIANCE + (3 * i + j) * LANES + lane] = covariances[k, i, j]
        else:
            for m in range(9):
                distances[COVARIANCE + m * LANES + lane] = 0.0
    for row in range(PATH, N_ROWS * LANES, LANES):
        for lane in range(n, LANES):
            distances[row + lane] = 0.0


@inlined_kernel
def _init_axis(
    position: float, direction: float, size: int, stride: int
) -> tuple[int, float, float, float]:
    """`geometry.traversal.start_ray` along one axis, without branches.

    Returns the change of the flat index, the distances to the first face, between faces, and to the
    border of the grid.
    """
    cell = math.floor(position)
    ahead = direction > 0.0
    along = direction != 0.0
    face, n_faces = (cell + 1.0, size - 1.0 - cell) if ahead else (float(cell), float(cell))
    first, delta = (face - position) / direction, 1.0 / abs(direction)
    end = (first + n_faces * delta) * BORDER_FACTOR
    step = stride if ahead else -stride
    return (
        step if along else 0,
        first if along else math.inf,
        delta if along else math.inf,
        end if along else math.inf,
    )


@unchecked_division_kernel
def init_lanes(start: tuple[float, float, float], grid: GridGeometry, lanes: Lanes) -> float:
    """Set out from the camera, at `start` in cells, with the loaded beams; steps of the longest."""
    distances, strides, counts = lanes
    nx, ny, nz = grid.shape
    first_cell = (math.floor(start[0]) * ny + math.floor(start[1])) * nz + math.floor(start[2])
    for lane in range(LANES):
        ux = distances[PATH + lane] / grid.resolution
        uy = distances[PATH + LANES + lane] / grid.resolution
        uz = distances[PATH + 2 * LANES + lane] / grid.resolution
        z = math.sqrt(ux * ux + uy * uy + uz * uz)
        is_beam = z > 0.0
        scale = z if is_beam else 1.0
        ux, uy, uz = ux / scale, uy / scale, uz / scale
        C = COVARIANCE + lane
        variance = (
            ux * distances[C] * ux
            + ux * distances[C + LANES] * uy
            + ux * distances[C + 2 * LANES] * uz
            + uy * distances[C + 3 * LANES] * ux
            + uy * distances[C + 4 * LANES] * uy
            + uy * distances[C + 5 * LANES] * uz
            + uz * distances[C + 6 * LANES] * ux
            + uz * distances[C + 7 * LANES] * uy
            + uz * distances[C + 8 * LANES] * uz
        )
        sigma = math.sqrt(variance if variance > 0.0 else 0.0) / grid.resolution
        sigma = sigma if sigma > MIN_RANGE_SIGMA else MIN_RANGE_SIGMA
        is_hit = distances[IS_HIT + lane] > 0.0
        stride_x, next_x, delta_x, end_x = _init_axis(start[0], ux, nx, ny * nz)
        stride_y, next_y, delta_y, end_y = _init_axis(start[1], uy, ny, nz)
        stride_z, next_z, delta_z, end_z = _init_axis(start[2], uz, nz, 1)
        end = min(end_x, min(end_y, end_z))
        free_until = z - RANGE_WINDOW * sigma - MAX_PATH_IN_CELL if is_hit else z
        massless_until = z - MASSLESS * sigma if is_hit else -1.0
        stop = z + RANGE_WINDOW * sigma if is_hit else z
        stop = min(stop, end)
        distances[LENGTH + lane], distances[SIGMA + lane] = z, sigma
        distances[NEXT_X + lane], distances[DELTA_X + lane] = next_x, delta_x
        distances[NEXT_Y + lane], distances[DELTA_Y + lane] = next_y, delta_y
        distances[NEXT_Z + lane], distances[DELTA_Z + lane] = next_z, delta_z
        distances[ENTRY + lane] = 0.0
        distances[FREE_UNTIL + lane] = min(free_until, end) if is_beam else -1.0
        distances[MASSLESS_UNTIL + lane] = min(massless_until, end) if is_beam else -1.0
        distances[STOP + lane] = stop if is_beam else -1.0
        # along each axis one face more than whole cells, at most; and the step out of the last cell
        steps = stop * (abs(ux) + abs(uy) + abs(uz))
        distances[N_STEPS + lane] = steps + 5.0 if is_beam else 0.0
        strides[CELL + lane] = first_cell
        strides[STRIDE_X + lane] = stride_x
        strides[STRIDE_Y + lane] = stride_y
        strides[STRIDE_Z + lane] = stride_z
        counts[N_FREE + lane] = counts[N_CROSSED + lane] = 0
    longest = 0.0
    for lane in range(LANES):
        longest = max(longest, distances[N_STEPS + lane])
    return longest


@borrowing_kernel
def step_lanes(n: int, lowest: float, lanes: Lanes, crossed: CrossedCells) -> None:
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
            t = min(x, min(y, z))
            over_x = x == t
            over_y = (y == t) & (not over_x)
            over_z = not (over_x | over_y)
            cells[row + lane], entries[row + lane] = cell, entry
            free_updates[row + lane] = np.floor(lowest * min(t - entry, 1.0) + 0.5)
            is_free = entry < distances[FREE_UNTIL + lane]
            counts[N_FREE + lane] += is_free | (t <= distances[MASSLESS_UNTIL + lane])
            counts[N_CROSSED + lane] += entry < distances[STOP + lane]
            distances[NEXT_X + lane] = x + dx if over_x else x
            distances[NEXT_Y + lane] = y + dy if over_y else y
            distances[NEXT_Z + lane] = z + dz if over_z else z
            distances[ENTRY + lane] = t
            strides[CELL + lane] = cell + (sx if over_x else (sy if over_y else sz))
