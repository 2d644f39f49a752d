"""The base policy where time ends the episode: most newly shown cells for each second of the team.

The team waits for its slowest robot, so a motion costs nothing that is as short as those of the
robots before. Seconds that the team does not have cost nothing either: a scan counts that begins in
time.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import PlainTuple, borrowing_kernel, inlined_kernel
from coopmap_env.robots.planar.feasible_poses import ReachSquare, is_within_reach, reach_square
from coopmap_env.robots.planar.motion_time import LatticeSpeeds, lattice_motion_time
from coopmap_env.studies.clairvoyant._base_choices import (
    STRIDE,
    first_on_path,
    list_near_cells,
    scans_to,
)
from coopmap_env.studies.clairvoyant._true_scans import (
    Progress,
    Scratch,
    TrueWorld,
    count_again,
    count_view,
)


class Clock(NamedTuple):
    """The clock of the team."""

    left: float
    """Seconds; infinite without ``max_time``."""
    scan_time: float
    """Seconds."""
    speeds: LatticeSpeeds


class Step(NamedTuple):
    """What robots before have chosen for the same scan of the team."""

    gain: int
    """Cells that they newly show."""
    slowest: float
    """Seconds of their longest motion."""


@inlined_kernel
def name_clock(plain: PlainTuple) -> Clock:
    """A plain `Clock` with its names."""
    left, scan_time, speeds = plain
    return Clock(left, scan_time, LatticeSpeeds(*speeds))


@borrowing_kernel
def _rate_of(gain: int, motion: float, clock: Clock, step: Step) -> float:
    """Cells for each second of the team's next scan, if a robot moves that long and shows these."""
    seconds = max(step.slowest, motion) + clock.scan_time
    return (step.gain + gain) / min(seconds, clock.left)


@borrowing_kernel
def _best_heading(
    progress: Progress, world: TrueWorld, robot: int, cell: int, clock: Clock, step: Step
) -> tuple[int, float]:
    """Of the views from a cell the one with the highest rate, by what was last counted."""
    lattice = world.sampling.lattice
    best, most = 0, -1.0
    for heading in range(lattice.n_headings):
        motion = lattice_motion_time(
            progress.pose_ids[robot],
            cell * lattice.n_headings + heading,
            lattice.n_headings,
            lattice.ny,
            clock.speeds,
        )
        rate = _rate_of(progress.bounds[cell, heading], motion, clock, step)
        if rate > most:
            best, most = heading, rate
    return best, most


@borrowing_kernel
def _best_of(
    progress: Progress,
    world: TrueWorld,
    robot: int,
    near: NDArray[np.int32],
    clock: Clock,
    step: Step,
    w: Scratch,
) -> int:
    """The pose in some cells with the highest rate; of equal ones, that in the first cell."""
    lattice, start = (
        world.sampling.lattice,
        progress.pose_ids[robot] // world.sampling.lattice.n_headings,
    )
    for k in range(len(near)):  # without turns, which no rate exceeds
        i, j = (
            near[k] // lattice.ny - start // lattice.ny,
            near[k] % lattice.ny - start % lattice.ny,
        )
        motion = math.sqrt(float(i * i + j * j)) / clock.speeds.cells
        w.rates[k] = _rate_of(progress.gains[near[k]], motion, clock, step)
    while True:
        k = int(np.argmax(w.rates[: len(near)]))
        cell = int(near[k])
        heading, rate = _best_heading(progress, world, robot, cell, clock, step)
        if rate == w.rates[k]:
            count = count_view(progress.cells, world, cell, heading, w.alive)
            if count == progress.bounds[cell, heading]:
                return cell * lattice.n_headings + heading
            progress.bounds[cell, heading] = count
            _, rate = _best_heading(progress, world, robot, cell, clock, step)
        w.rates[k] = rate


@borrowing_kernel
def _seconds_to(square: ReachSquare, i: int, j: int, clock: Clock) -> float:
    """Seconds until a scan begins in a cell further than reach, i and j cells away, at least."""
    motion = math.sqrt(float(i * i + j * j)) / clock.speeds.cells
    return motion + (scans_to(square, i, j) - 1) * clock.scan_time


@borrowing_kernel
def _better_far_cell(
    progress: Progress,
    world: TrueWorld,
    robot: int,
    square: ReachSquare,
    near_rate: float,
    clock: Clock,
    w: Scratch,
) -> int:
    """A cell out of reach with a higher rate than the best near one, in time; -1 if none."""
    nx, ny, _ = world.sampling.shape
    x, y, n = square.cell_x, square.cell_y, 0
    least = 2.0 * near_rate * clock.scan_time  # two scans, at least
    for ix in range(0, nx, STRIDE):
        for iy in range(0, ny, STRIDE):
            c = np.uint64(ix * ny + iy)
            if progress.gains[c] > least and progress.regions[robot, c]:
                i, j = ix - x, iy - y
                seconds = _seconds_to(square, i, j, clock)
                is_better = progress.gains[c] > near_rate * (seconds + clock.scan_time)
                if is_better and seconds < clock.left and not is_within_reach(square, i, j):
                    w.queue[n] = ix * ny + iy
                    n += 1
    while True:
        found, best = -1, near_rate
        for k in range(n):
            cell = int(w.queue[np.uint64(k)])
            seconds = _seconds_to(square, cell // ny - x, cell % ny - y, clock)
            rate = progress.gains[np.uint64(cell)] / (seconds + clock.scan_time)
            if rate > best:
                found, best = cell, rate
        if found < 0 or progress.counted_at[found] == progress.step[0]:
            return found
        count_again(progress, world, found, w.alive)


@borrowing_kernel
def choose_timed_pose(
    progress: Progress, world: TrueWorld, robot: int, clock: Clock, step: Step, w: Scratch
) -> int:
    """What the base policy chooses for a robot; `clock.left` is what is left now."""
    sampling, region = world.sampling, progress.regions[robot]
    lattice, start = sampling.lattice, progress.pose_ids[robot]
    square = reach_square(start, sampling.reach, lattice)
    n = list_near_cells(square, region, sampling.shape, w.queue)
    pose_id = _best_of(progress, world, robot, w.queue[:n], clock, step, w)
    cell, heading = pose_id // lattice.n_headings, pose_id % lattice.n_headings
    motion = lattice_motion_time(start, pose_id, lattice.n_headings, lattice.ny, clock.speeds)
    own_rate = _rate_of(progress.bounds[cell, heading], motion, clock, Step(0, 0.0))
    far = _better_far_cell(progress, world, robot, square, own_rate, clock, w)
    if far < 0:
        return pose_id
    w.queue[0] = first_on_path(far, region, square, sampling.shape, w)
    return _best_of(progress, world, robot, w.queue[:1], clock, step, w)
