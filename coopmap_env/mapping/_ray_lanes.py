"""Rays that are stepped side by side through a grid, without any branch, in vector registers.

A traversal asks at each step which face comes next, and a processor guesses the answer wrong so
often that this takes half of the time. `LANES` rays at once need no guess.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import inlined_kernel, kernel
from coopmap_env.geometry import start_ray
from coopmap_env.mapping.beam import MAX_PATH_IN_CELL, MIN_RANGE_SIGMA, RANGE_WINDOW
from coopmap_env.mapping.grid import GridGeometry

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
"""Flat index of the current cell."""
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
    """Flat indices."""
    entries: NDArray[np.float64]
    """Distances at which they are entered, cells."""
    free_updates: NDArray[np.float64]
    """Updates by a beam that passes them: integers, as the numbers that registers hold."""


@kernel
def allocate_lanes(shape: tuple[int, int, int]) -> tuple[Lanes, CrossedCells]:
    """Buffers for `LANES` rays through a grid of this shape."""
    longest = LANES * (shape[0] + shape[1] + shape[2] + 6)
    lanes = Lanes(np.zeros(9 * LANES), np.zeros(4 * LANES, np.int64), np.empty(2 * LANES, np.int64))
    return lanes, CrossedCells(np.empty(longest, np.int64), np.empty(longest), np.empty(longest))


@kernel
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
            over_x = (x <= y) & (x <= z)
            over_y = (y <= z) & (not over_x)
            over_z = not (over_x | over_y)
            t = min(x, min(y, z))
            cells[row + lane], entries[row + lane] = cell, entry
            free_updates[row + lane] = np.floor(lowest * min(t - entry, 1.0) + 0.5)
            counts[N_FREE + lane] += entry < distances[FREE_UNTIL + lane]
            counts[N_CROSSED + lane] += entry < distances[STOP + lane]
            distances[NEXT_X + lane] = x + dx if over_x else x
            distances[NEXT_Y + lane] = y + dy if over_y else y
            distances[NEXT_Z + lane] = z + dz if over_z else z
            distances[ENTRY + lane] = t
            strides[CELL + lane] = (
                cell + (sx if over_x else 0) + (sy if over_y else 0) + (sz if over_z else 0)
            )


@inlined_kernel  # a call with so many arrays takes long
def init_lane(
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
