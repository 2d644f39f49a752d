"""Start of planar episodes: a team close together, and the cells that are known around it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import borrowing_kernel
from coopmap_env.core.random_streams import draw_index
from coopmap_env.robots.planar.reachable_regions import neighbor
from coopmap_env.simulation.scenes.planar.regions import allocate_runs, find_largest_free_region

ROUNDING = 1 + 1e-9
"""A cell counts if its center is as near as a radius, but for rounding."""


class StartSettings(NamedTuple):
    """Where teams start, and what they know there; lengths in cells."""

    n_headings: int
    spread: float
    """Teammates start no further than this from the first robot."""
    known_radius: float
    """Free cells no further than this from a start are known, if connected to it."""


class StartBuffers(NamedTuple):
    """Scratch for worlds of n cells."""

    runs: NDArray[np.int32]
    """See `find_largest_free_region`."""
    cells: NDArray[np.int32]
    """Shape (n,)."""
    marks: NDArray[np.uint8]
    """Zeros (n,), before and after."""

    @classmethod
    def empty(cls, shape: tuple[int, int], cells: NDArray[np.int32]) -> StartBuffers:
        """Scratch for grids of this shape; `cells` (n,) may be scratch of others too."""
        return cls(
            allocate_runs(shape),
            cells,
            np.zeros(len(cells), dtype=np.uint8),
        )


@borrowing_kernel
def sample_start_poses(
    occupied: NDArray[np.bool_],
    settings: StartSettings,
    stream: NDArray[np.uint64],
    buffers: StartBuffers,
    pose_ids: NDArray[np.int64],
) -> None:
    """Write the start poses (n,) of a team in the largest free region of a world (nx, ny).

    The first robot is anywhere in it, the others no further than the spread from there. Cells are
    different as long as there are enough; then they repeat.
    """
    ny, near = occupied.shape[1], buffers.cells
    n_runs, size = find_largest_free_region(occupied, buffers.runs)
    runs = buffers.runs[:3, :n_runs]
    first = _find_nth(runs, ny, draw_index(stream, size))
    near[0] = first
    n_near = 1 + _list_disc(runs, first, ny, settings.spread, near[1:])
    n_robots, n = len(pose_ids), settings.n_headings
    for robot in range(1, min(n_robots, n_near)):
        picked = robot + draw_index(stream, n_near - robot)
        near[robot], near[picked] = near[picked], near[robot]
    for robot in range(n_robots):
        pose_ids[robot] = np.int64(near[robot % n_near]) * n + draw_index(stream, n)


@borrowing_kernel
def _find_nth(runs: NDArray[np.int32], ny: int, n: int) -> int:
    """Flat index of the n-th cell of some runs, counted from 0, of those that there are."""
    for k in range(runs.shape[1]):
        row, start, stop = runs[0, k], runs[1, k], runs[2, k]
        if n < stop - start:
            return row * ny + start + n
        n -= stop - start
    return -1


@borrowing_kernel
def _list_disc(
    runs: NDArray[np.int32], center: int, ny: int, radius: float, out: NDArray[np.int32]
) -> int:
    """Write the cells of some runs around one of them, without it; return how many they are."""
    x, y = center // ny, center % ny
    limit, count = (radius * ROUNDING) ** 2, 0
    reach = math.floor(min(radius * ROUNDING, float(runs[0, -1] + ny)))
    for k in range(runs.shape[1]):
        i = runs[0, k]
        if abs(i - x) > reach:
            continue
        for j in range(max(runs[1, k], y - reach), min(runs[2, k], y + reach + 1)):
            distance = (i - x) ** 2 + (j - y) ** 2
            if 0 < distance <= limit:
                out[count] = i * ny + j
                count += 1
    return count


@borrowing_kernel
def list_known_cells(
    occupied: NDArray[np.bool_], start: int, radius: float, buffers: StartBuffers
) -> int:
    """Write the free cells within a radius of a start that are connected to it by faces.

    The paths between them stay within the radius too. They are in `buffers.cells`; returns how many
    they are.
    """
    nx, ny = occupied.shape
    cells, marks = buffers.cells, buffers.marks
    limit = (radius * ROUNDING) ** 2
    x, y = start // ny, start % ny
    cells[0], marks[start], head, count = start, 1, 0, 1
    while head < count:
        cell = int(cells[head])
        head += 1
        for side in range(4):
            beside = neighbor(cell, side, (nx, ny, 1))
            if beside < 0 or marks[beside]:
                continue
            i, j = beside // ny, beside % ny
            if not occupied[i, j] and (i - x) ** 2 + (j - y) ** 2 <= limit:
                marks[beside] = 1
                cells[count] = beside
                count += 1
    for k in range(count):
        marks[cells[k]] = 0
    return count
