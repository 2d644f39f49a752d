"""Kernels that play a team on in the true world: plans that begin with poses, and a base policy."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import PlainTuple, borrowing_kernel, kernel
from coopmap_env.robots.planar.feasible_poses import is_within_reach, reach_square
from coopmap_env.robots.planar.motion_time import lattice_motion_time
from coopmap_env.studies.clairvoyant._base_choices import choose_pose
from coopmap_env.studies.clairvoyant._timed_choices import (
    Clock,
    Step,
    choose_timed_pose,
    name_clock,
)
from coopmap_env.studies.clairvoyant._true_scans import (
    Progress,
    Scratch,
    TrueWorld,
    count_view,
    mark_scan,
    name_world,
    open_scan,
)

BASE = -1
"""A pose of a plan that the base policy chooses."""


@borrowing_kernel
def _is_possible(progress: Progress, world: TrueWorld, robot: int, pose_id: int) -> bool:
    """Whether a robot can go to a pose now."""
    sampling = world.sampling
    ny, cell = sampling.shape[1], pose_id // sampling.lattice.n_headings
    square = reach_square(progress.pose_ids[robot], sampling.reach, sampling.lattice)
    i, j = cell // ny - square.cell_x, cell % ny - square.cell_y
    return progress.regions[robot, cell] != 0 and is_within_reach(square, i, j)


@kernel
def _copy(source: Progress, target: Progress) -> None:
    target.cells[:] = source.cells
    target.regions[:] = source.regions
    target.pose_ids[:] = source.pose_ids
    target.bounds[:] = source.bounds
    target.gains[:] = source.gains
    target.headings[:] = source.headings
    target.counted_at[:] = source.counted_at
    target.step[:] = source.step


@kernel
def play_on(
    plain_start: PlainTuple,
    plain_world: PlainTuple,
    plain_progress: PlainTuple,
    plain_scratch: PlainTuple,
    plain_clock: PlainTuple,
    plan: NDArray[np.int64],
    shown: NDArray[np.int64],
) -> None:
    """Play a plan (h, n_robots) from a start, of which a copy is made; fill in what is BASE.

    The poses of the first scan must be possible; later ones that are not are left to the base
    policy. `shown` (h,) gets the cells that each scan of the team newly shows; none that would
    begin when the time is over.
    """
    progress, world = Progress(*plain_progress), name_world(plain_world)
    w, clock = Scratch(*plain_scratch), name_clock(plain_clock)
    lattice = world.sampling.lattice
    _copy(Progress(*plain_start), progress)
    shown[:] = 0
    left = clock.left
    for scan in range(plan.shape[0]):
        if left <= 0.0:
            break
        slowest = 0.0
        for robot in range(plan.shape[1]):
            pose_id = plan[scan, robot]
            is_given = pose_id != BASE and (
                scan == 0 or _is_possible(progress, world, robot, pose_id)
            )
            if not is_given:
                if math.isinf(left):
                    pose_id = choose_pose(progress, world, robot, w)
                else:
                    now = Clock(left, clock.scan_time, clock.speeds)
                    step = Step(shown[scan], slowest)
                    pose_id = choose_timed_pose(progress, world, robot, now, step, w)
            motion = lattice_motion_time(
                progress.pose_ids[robot], pose_id, lattice.n_headings, lattice.ny, clock.speeds
            )
            slowest = max(slowest, motion)
            plan[scan, robot] = pose_id
            shown[scan] += mark_scan(progress, world, robot, pose_id, w)
        for robot in range(plan.shape[1]):
            open_scan(progress, world, plan[scan, robot], w)
        left -= slowest + clock.scan_time


@kernel
def count_best_views(
    plain_world: PlainTuple,
    plain_progress: PlainTuple,
    plain_scratch: PlainTuple,
    cells: NDArray[np.int64],
) -> None:
    """Count all views from some cells (k,), and keep them in the progress."""
    progress, world = Progress(*plain_progress), name_world(plain_world)
    w = Scratch(*plain_scratch)
    for cell in cells:
        progress.gains[cell] = -1
        for heading in range(progress.bounds.shape[1]):
            count = count_view(progress.cells, world, cell, heading, w.alive)
            progress.bounds[cell, heading] = count
            if count > progress.gains[cell]:
                progress.gains[cell], progress.headings[cell] = count, heading
        progress.counted_at[cell] = progress.step[0]
