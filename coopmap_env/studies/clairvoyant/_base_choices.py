"""The base policy, which plays plans on: what it chooses where only scans are limited.

It sends each robot in turn to the view that shows most for each scan that it takes to get there; of
the cells, it considers every second one along each axis. Gains only fall, so the view that a cell
had last bounds what it has now: few cells are counted again at a time.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import borrowing_kernel
from coopmap_env.robots.planar.feasible_poses import ReachSquare, is_within_reach, reach_square
from coopmap_env.robots.planar.reachable_regions import neighbor
from coopmap_env.studies.clairvoyant._true_scans import (
    Progress,
    Scratch,
    TrueWorld,
    count_again,
)

STRIDE = 2
"""Cells along an axis, of which the base policy considers one: four times as fast."""


@borrowing_kernel
def list_near_cells(
    square: ReachSquare,
    region: NDArray[np.uint8],
    shape: tuple[int, int, int],
    out: NDArray[np.int32],
) -> int:
    """Write the cell of the robot and considered ones of a region within reach; their number."""
    nx, ny, _ = shape
    x, y, side, n = square.cell_x, square.cell_y, square.half_side, 1
    out[0] = x * ny + y
    for ix in range(max(x - side, 0), min(x + side + 1, nx)):
        if ix % STRIDE != 0:
            continue
        for iy in range(max(y - side, 0), min(y + side + 1, ny)):
            is_considered = iy % STRIDE == 0 and region[ix * ny + iy]
            if is_considered and is_within_reach(square, ix - x, iy - y):
                out[n] = ix * ny + iy
                n += 1
    return n


@borrowing_kernel
def _best_of(
    progress: Progress, world: TrueWorld, near: NDArray[np.int32], start: int, w: Scratch
) -> int:
    """Of some cells the one whose best view shows most; of equal ones the nearest to the start."""
    ny = world.sampling.shape[1]
    while True:
        best, most, least, second = start, -1, 0, -1
        for one in near:
            gain = progress.gains[np.uint64(one)]
            if gain < most:
                second = max(second, gain)
                continue
            i, j = one // ny - start // ny, one % ny - start % ny
            if gain > most or i * i + j * j < least:
                second = most
                best, most, least = int(one), gain, i * i + j * j
        if progress.counted_at[best] == progress.step[0]:
            return best
        while progress.counted_at[best] != progress.step[0] and progress.gains[best] >= second:
            count_again(progress, world, best, w.alive)


@borrowing_kernel
def scans_to(square: ReachSquare, i: int, j: int) -> int:
    """Scans that it takes to be in a cell further than reach, i and j cells away, at least."""
    distance = math.sqrt(i * i + j * j) * square.resolution
    return max(2, math.ceil(distance / square.half_width))


@borrowing_kernel
def _better_far_cell(
    progress: Progress,
    world: TrueWorld,
    robot: int,
    square: ReachSquare,
    near_gain: int,
    w: Scratch,
) -> int:
    """A cell out of reach that shows more for each scan than the best near one; -1 if none."""
    nx, ny, _ = world.sampling.shape
    x, y, n = square.cell_x, square.cell_y, 0
    for ix in range(0, nx, STRIDE):
        for iy in range(0, ny, STRIDE):
            c = np.uint64(ix * ny + iy)
            if progress.gains[c] > 2 * near_gain and progress.regions[robot, c]:
                i, j = ix - x, iy - y
                is_better = progress.gains[c] > near_gain * scans_to(square, i, j)
                if is_better and not is_within_reach(square, i, j):
                    w.queue[n] = ix * ny + iy
                    n += 1
    while True:
        found, best = -1, float(near_gain)
        for k in range(n):
            cell = int(w.queue[np.uint64(k)])
            gain = progress.gains[np.uint64(cell)]
            if gain > 2.0 * best:
                value = gain / scans_to(square, cell // ny - x, cell % ny - y)
                if value > best:
                    found, best = cell, value
        if found < 0 or progress.counted_at[found] == progress.step[0]:
            return found
        while (
            progress.counted_at[found] != progress.step[0] and progress.gains[found] > 2 * near_gain
        ):
            count_again(progress, world, found, w.alive)


@borrowing_kernel
def first_on_path(
    goal: int,
    region: NDArray[np.uint8],
    square: ReachSquare,
    shape: tuple[int, int, int],
    w: Scratch,
) -> int:
    """The cell within reach that is nearest to a goal by a path through a region."""
    ny, found, head, n = shape[1], -1, 0, 1
    w.queue[0] = goal
    w.marks[goal] = 1
    while head < n and found < 0:
        cell = int(w.queue[head])
        head += 1
        if is_within_reach(square, cell // ny - square.cell_x, cell % ny - square.cell_y):
            found = cell
        for side in range(4):
            beside = neighbor(cell, side, shape)
            if beside >= 0 and region[beside] and not w.marks[beside]:
                w.marks[beside] = 1
                w.queue[n] = beside
                n += 1
    for k in range(n):
        w.marks[w.queue[k]] = 0
    return found


@borrowing_kernel
def choose_pose(progress: Progress, world: TrueWorld, robot: int, w: Scratch) -> int:
    """What the base policy chooses for a robot."""
    sampling, region = world.sampling, progress.regions[robot]
    n_headings = sampling.lattice.n_headings
    square = reach_square(progress.pose_ids[robot], sampling.reach, sampling.lattice)
    start = progress.pose_ids[robot] // n_headings
    n = list_near_cells(square, region, sampling.shape, w.queue)
    cell = _best_of(progress, world, w.queue[:n], start, w)
    far = _better_far_cell(progress, world, robot, square, progress.gains[cell], w)
    if far >= 0:
        cell = first_on_path(far, region, square, sampling.shape, w)
        while progress.counted_at[cell] != progress.step[0]:
            count_again(progress, world, cell, w.alive)
    return cell * n_headings + progress.headings[cell]
