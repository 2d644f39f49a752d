"""Choices of planar views that show many cells together: threshold accepting.

At first each scan takes the best of some random poses. Then random exchanges, most of them to a
pose nearby, are accepted unless they lose more cells than a threshold that falls to zero (Dueck &
Scheuer 1990, "Threshold accepting"). All is counted in integers, with random numbers of its own.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import PlainTuple, borrowing_kernel, kernel
from coopmap_env.core.random_streams import draw_index, random_block, take_blocks, uniform_index
from coopmap_env.sensing.beam_fan import FanArrays

N_TRIED = 200
"""Random poses of which each scan takes the best at first."""
JUMPS = 10
"""One exchange in so many goes to any pose; the others go to a neighbour."""
MAX_MOVE = 3
"""Cells along an axis to a neighbour, at most."""
THRESHOLD = 24
"""The first threshold is the largest view divided by this."""
HALF = np.uint64(32)
"""Bits of half of a random word."""


class FramedPoses(NamedTuple):
    """Where robots can be, in a framed world; the frame, `MAX_MOVE` wide at least, is known."""

    occupied: NDArray[np.int8]
    """-1, all whose bits are set, where a cell (n_framed,) of the true world is occupied; or 0."""
    width: int
    """Cells along y."""
    known: NDArray[np.bool_]
    """Cells (n_framed,) that need not be shown."""
    earliest: NDArray[np.int64]
    """First scan (n_robots, n_framed) in each cell; more than there are where it takes none."""
    ordered: NDArray[np.int64]
    """Cells (n_robots, k) by that scan."""
    n_possible: NDArray[np.int64]
    """How many of them are possible at each scan (n_scans, n_robots)."""


@borrowing_kernel
def _random_pose(
    poses: FramedPoses, scan: int, robot: int, n_headings: int, stream: NDArray[np.uint64]
) -> int:
    """A pose that is possible at a scan, counted from 0."""
    words = random_block(stream, 0)
    take_blocks(stream, 1)
    cell = poses.ordered[robot, uniform_index(words[0], poses.n_possible[scan, robot])]
    return cell * n_headings + uniform_index(words[1], n_headings)


@borrowing_kernel
def _near_pose(
    poses: FramedPoses,
    scan: int,
    robot: int,
    pose: int,
    n_headings: int,
    stream: NDArray[np.uint64],
) -> int:
    """A pose near another one, with its heading or one beside it; the same if it is impossible."""
    words = random_block(stream, 0)
    take_blocks(stream, 1)
    most = 1 + uniform_index(words[0], MAX_MOVE)
    dx = uniform_index(words[1], 2 * most + 1) - most
    dy = uniform_index(words[1] << HALF, 2 * most + 1) - most
    cell = pose // n_headings + dx * poses.width + dy
    if poses.earliest[robot, cell] > scan + 1:
        return pose
    turn = max(uniform_index(words[2], 4) - 1, 0)  # 0, 0, 1 or 2: as far as the other way around
    return cell * n_headings + (pose + (turn if turn < 2 else n_headings - 1)) % n_headings


@borrowing_kernel
def _list_view(
    poses: FramedPoses,
    pose: int,
    fan: FanArrays,
    alive: NDArray[np.uint64],
    times: NDArray[np.int32],
    cells: NDArray[np.int32],
) -> tuple[int, int]:
    """List the cells in view of a pose; how many there are, and those that nothing shows yet.

    As `list_planar_view`, without branches: every cell is written, and kept only if it is in view.
    """
    n_headings = len(fan.start) - 1
    cell, heading = np.uint64(pose // n_headings), pose % n_headings
    first, n_words, n = fan.all_beams[0], np.uint64(len(alive)), np.uint64(0)
    for word in range(n_words):
        alive[word] = fan.all_beams[word]
    for entry in range(np.uint64(fan.start[heading]), np.uint64(fan.start[heading + 1])):
        crossed = cell + np.uint64(fan.flat_offsets[entry])
        blocked = np.uint64(np.int64(poses.occupied[crossed]))
        seen = first & fan.beams[0, entry]
        first &= ~(seen & blocked)
        for word in range(np.uint64(1), n_words):
            crossing = alive[word] & fan.beams[word, entry]
            alive[word] &= ~(crossing & blocked)
            seen |= crossing
        cells[n] = crossed
        n += np.uint64(seen != 0)
    gain = 0
    for k in range(n):
        gain += times[np.uint64(cells[k])] == 0
    return int(n), gain


@kernel
def choose_views(
    plain_poses: PlainTuple,
    plain_fan: PlainTuple,
    n_exchanges: int,
    stream: NDArray[np.uint64],
    chosen: NDArray[np.int64],
) -> None:
    """Write the best choice of poses (n_scans, n_robots) that was found in so many exchanges."""
    poses, fan = FramedPoses(*plain_poses), FanArrays(*plain_fan)
    n_headings, n_robots = len(fan.start) - 1, chosen.shape[1]
    alive = np.empty(len(fan.all_beams), np.uint64)
    times = poses.known.astype(np.int32)
    views = np.empty((chosen.size, fan.max_visible_cells + 1), np.int32)
    sizes, new = np.zeros(chosen.size, np.int64), np.empty(views.shape[1], np.int32)
    current = chosen.copy()
    for v in range(chosen.size):
        scan, robot, most = v // n_robots, v % n_robots, -1
        for _ in range(N_TRIED):
            pose = _random_pose(poses, scan, robot, n_headings, stream)
            n, gain = _list_view(poses, pose, fan, alive, times, new)
            if gain > most:
                most, current[scan, robot], sizes[v] = gain, pose, n
                views[v, :n] = new[:n]
        for k in range(sizes[v]):
            times[views[v, k]] += 1
    chosen[:] = current
    balance = best = 0
    for t in range(n_exchanges):
        threshold = fan.max_visible_cells * (n_exchanges - t) // (THRESHOLD * n_exchanges)
        v = draw_index(stream, chosen.size)
        scan, robot = v // n_robots, v % n_robots
        if draw_index(stream, JUMPS) == 0:
            pose = _random_pose(poses, scan, robot, n_headings, stream)
        else:
            pose = _near_pose(poses, scan, robot, current[scan, robot], n_headings, stream)
        if pose == current[scan, robot]:
            continue
        loss = 0
        own = views[v, : sizes[v]]
        for k in range(np.uint64(sizes[v])):
            cell = np.uint64(own[k])
            left = times[cell] - np.int32(1)
            times[cell] = left
            loss += left == 0
        n, gain = _list_view(poses, pose, fan, alive, times, new)
        if gain >= loss - threshold:
            current[scan, robot], sizes[v] = pose, n
            views[v, :n] = new[:n]
            balance += gain - loss
        own = views[v, : sizes[v]]
        for k in range(np.uint64(sizes[v])):
            times[np.uint64(own[k])] += np.int32(1)
        if balance > best:
            best = balance
            chosen[:] = current
