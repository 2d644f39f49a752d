"""Kernels that play a field team on in the true world, whose views from a set of poses are known.

What each pose newly covers is kept up to date: when a sample of the surface is covered, all poses
that cover it have one less. So a whole plan takes no longer than a pass over all views.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import PlainTuple, borrowing_kernel, kernel
from coopmap_env.evaluation.bounds import PoseSets

BASE = -1
"""A pose of a plan that the base policy chooses; one that is chosen if no pose is possible."""


class TrueViews(NamedTuple):
    """What does not change in an episode. Poses are numbered robot after robot."""

    start: NDArray[np.int64]
    """Samples that pose p covers: cells[start[p] : start[p + 1]]."""
    cells: NDArray[np.int32]
    inverse_start: NDArray[np.int64]
    """Poses that cover sample c: poses[inverse_start[c] : inverse_start[c + 1]]."""
    poses: NDArray[np.int32]
    first: NDArray[np.int64]
    """Poses of robot r: first[r] to first[r + 1]."""
    joints: NDArray[np.float64]
    """Of each pose (k, n); mounts with fewer joints have zeros after them."""
    speeds: NDArray[np.float64]
    """Of the joints of each robot (n_robots, n); infinite for those after them."""
    scan_time: float
    """Seconds."""

    @classmethod
    def from_sets(
        cls,
        sets: PoseSets,
        n_samples: int,
        joints: tuple[NDArray[np.float64], ...],
        speeds: list[NDArray[np.float64]],
        scan_time: float,
    ) -> TrueViews:
        """Those of the joints (k_r, n_r) of each robot, with their speeds (n_r,)."""
        n_poses, n = len(sets.start) - 1, max(own.shape[1] for own in joints)
        poses_of_entries = np.repeat(np.arange(n_poses, dtype=np.int32), np.diff(sets.start))
        order = np.argsort(sets.cells, kind="stable")
        return cls(
            sets.start,
            sets.cells,
            np.searchsorted(sets.cells[order], np.arange(n_samples + 1)),
            poses_of_entries[order],
            np.cumsum([0, *map(len, joints)]),
            np.vstack([np.pad(own, ((0, 0), (0, n - own.shape[1]))) for own in joints]),
            np.array([np.pad(v, (0, n - len(v)), constant_values=np.inf) for v in speeds]),
            scan_time,
        )


@borrowing_kernel
def _take(views: TrueViews, pose: int, covered: NDArray[np.bool_], gains: NDArray[np.int64]) -> int:
    """Scan from a pose; the number of samples that it newly covers."""
    count = 0
    for entry in range(views.start[pose], views.start[pose + 1]):
        sample = np.uint64(views.cells[np.uint64(entry)])
        if not covered[sample]:
            covered[sample] = True
            count += 1
            for k in range(views.inverse_start[sample], views.inverse_start[sample + np.uint64(1)]):
                gains[np.uint64(views.poses[np.uint64(k)])] -= 1
    return count


@borrowing_kernel
def _write_times(
    views: TrueViews, robot: int, at: NDArray[np.float64], times: NDArray[np.float64]
) -> None:
    """Seconds of a robot's motions from the joints `at` (n,) to each of its poses."""
    for p in range(views.first[robot], views.first[robot + 1]):
        slowest = 0.0
        for j in range(len(at)):
            seconds = abs(views.joints[p, j] - at[j]) / views.speeds[robot, j]
            slowest = max(slowest, seconds)
        times[p] = slowest


@kernel
def best_limit(
    first: NDArray[np.int64],
    possible: NDArray[np.bool_],
    times: NDArray[np.float64],
    gains: NDArray[np.int64],
    given: NDArray[np.int64],
    scan_time: float,
    seconds_left: float,
) -> float:
    """Seconds that motions of the team may take for the most new samples per second of its clock.

    The sum over the robots counts, as if they covered nothing twice. The step that ends the episode
    costs no more than what is left. `given` poses (n_robots,) are taken in any case; the others are
    BASE. All robots with a possible pose get one.
    """
    n_robots = len(given)
    best, least = np.full(n_robots, -1, np.int64), 0.0
    for robot in range(n_robots):
        if given[robot] != BASE:
            best[robot] = gains[given[robot]]
            least = max(least, times[given[robot]])
        elif not possible[first[robot] : first[robot + 1]].any():
            best[robot] = 0
    limit, highest = math.inf, -1.0
    order = np.argsort(times, kind="mergesort")
    robot_of = np.searchsorted(first, np.arange(len(times)), side="right") - 1
    for k in range(len(order)):
        p = order[k]
        robot = robot_of[p]
        if possible[p] and given[robot] == BASE:
            best[robot] = max(best[robot], gains[p])
        is_last = k + 1 == len(order) or times[order[k + 1]] > times[p]
        if not is_last or best.min() < 0 or times[p] < least:
            continue
        rate = best.sum() / min(max(times[p], least) + scan_time, seconds_left)
        if rate > highest:
            limit, highest = times[p], rate
    return limit


@kernel
def choose_step(
    plain_views: PlainTuple,
    possible: NDArray[np.bool_],
    times: NDArray[np.float64],
    covered: NDArray[np.bool_],
    gains: NDArray[np.int64],
    seconds_left: float,
    chosen: NDArray[np.int64],
) -> int:
    """Fill in what is BASE in `chosen` (n_robots,), and scan; the samples newly covered.

    Each robot in turn takes the possible pose that newly covers most, of equal ones the one with
    the shortest motion. Where the clock may run out, motions take no longer than `best_limit`. It
    stays BASE where no pose is possible.
    """
    views = TrueViews(*plain_views)
    limit = math.inf
    if seconds_left < math.inf:
        limit = best_limit(
            views.first, possible, times, gains, chosen, views.scan_time, seconds_left
        )
    count = 0
    for robot in range(len(chosen)):
        if chosen[robot] == BASE:
            most, least = -1, math.inf
            for p in range(views.first[robot], views.first[robot + 1]):
                is_better = gains[p] > most or (gains[p] == most and times[p] < least)
                if is_better and possible[p] and times[p] <= limit:
                    chosen[robot], most, least = p, gains[p], times[p]
        if chosen[robot] != BASE:
            count += _take(views, chosen[robot], covered, gains)
    return count


@kernel
def play_on(
    plain_views: PlainTuple,
    possible: tuple[NDArray[np.bool_], NDArray[np.bool_]],
    joints: NDArray[np.float64],
    covered: NDArray[np.bool_],
    gains: NDArray[np.int64],
    seconds_left: float,
    plan: NDArray[np.int64],
    shown: NDArray[np.int64],
) -> int:
    """Play a plan (h, n_robots) until it or the time ends, and fill in what is BASE.

    `joints` (n_robots, n) are those at the start; `covered` and `gains` change. Poses are possible
    at the first scan and at later ones; those of the plan that are not are left to the base policy.
    `shown` (h,) gets the samples that each scan of the team newly covers. Returns the scans.
    """
    views = TrueViews(*plain_views)
    times, at = np.zeros(len(views.joints)), joints.copy()
    for scan in range(len(plan)):
        now, chosen = possible[min(scan, 1)], plan[scan]
        for robot in range(len(chosen)):
            _write_times(views, robot, at[robot], times)
            if chosen[robot] != BASE and not now[chosen[robot]]:
                chosen[robot] = BASE
        shown[scan] = choose_step(plain_views, now, times, covered, gains, seconds_left, chosen)
        slowest = 0.0
        for robot in range(len(chosen)):
            if chosen[robot] != BASE:
                slowest = max(slowest, times[chosen[robot]])
                at[robot] = views.joints[chosen[robot]]
        seconds_left -= slowest + views.scan_time
        if seconds_left <= 0.0:
            return scan + 1
    return len(plan)
