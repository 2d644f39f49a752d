"""Feasible poses of a robot on the lattice: within reach, in a cell to which a free path leads.

One action moves a camera at most the reach ahead or back, and to either side, in its own frame.
`sample_feasible_poses` draws different poses uniformly: it tries random cells of the square around
the camera, which mostly takes a few tries for a pose, and lists what is left only where many tries
fail. No list of all feasible poses is made.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.elementary import sin_cos
from coopmap_env.core.kernels import borrowing_kernel, inlined_kernel, kernel
from coopmap_env.core.random_streams import random_block, take_blocks, uniform_index
from coopmap_env.robots.planar.pose_lattice import LatticeGeometry, pose_from_id
from coopmap_env.robots.planar.reachable_regions import RegionArrays, is_reachable

FARTHEST = 1e9
"""Cells: no grid is as large."""
TRIES_PER_POSE = 8
"""After so many tries for each pose, what is left is listed instead."""


class ReachSquare(NamedTuple):
    """The cells within reach of a camera: a square aligned with its heading."""

    cell_x: int
    cell_y: int
    """Cell of the camera."""
    sine: float
    cosine: float
    """Of its heading."""
    half_width: float
    """Metres, and a little more for the rounding of the rotation."""
    resolution: float
    """Edge of a cell, metres."""
    half_side: int
    """Cells: no cell within reach is further along an axis."""


@borrowing_kernel
def reach_square(pose_id: int, reach: float, lattice: LatticeGeometry) -> ReachSquare:
    """The cells within `reach` metres of a pose."""
    cell = pose_id // lattice.n_headings
    _, _, heading = pose_from_id(pose_id, lattice)
    s, c = sin_cos(heading)
    half_width = reach * (1.0 + 1e-9)
    half_side = math.floor(min((abs(s) + abs(c)) * half_width / lattice.resolution, FARTHEST))
    return ReachSquare(
        cell // lattice.ny, cell % lattice.ny, s, c, half_width, lattice.resolution, half_side
    )


@inlined_kernel
def is_within_reach(square: ReachSquare, i: int, j: int) -> bool:
    """Whether the center of the cell that is i and j cells away lies in the square."""
    dx, dy = i * square.resolution, j * square.resolution
    s, c = square.sine, square.cosine
    return abs(c * dx + s * dy) <= square.half_width and abs(c * dy - s * dx) <= square.half_width


class PoseSampling(NamedTuple):
    """What sampling feasible poses needs besides the map."""

    lattice: LatticeGeometry
    shape: tuple[int, int, int]
    """Cells of the grid."""
    reach: float
    """Metres."""


def check_reach(sampling: PoseSampling) -> None:
    """ValueError if so many poses are in reach that one word cannot choose among them."""
    lattice, (nx, ny, _) = sampling.lattice, sampling.shape
    side = min(math.sqrt(2.0) * sampling.reach / lattice.resolution, max(nx, ny))
    n_poses = (2 * math.floor(side) + 1) ** 2 * lattice.n_headings
    if n_poses >= 1 << 32:
        raise ValueError(
            f"reach {sampling.reach} m with n_headings {lattice.n_headings} gives a robot "
            f"{n_poses:,} poses to choose from, more than 2**32: lower one of them"
        )


@kernel
def write_feasible_cells(
    pose_id: int, robot: int, sampling: PoseSampling, regions: RegionArrays, out: NDArray[np.int32]
) -> int:
    """Write the cells (flat, ascending) that a robot reaches; return how many they are."""
    nx, ny, _ = sampling.shape
    square = reach_square(pose_id, sampling.reach, sampling.lattice)
    x, y, side = square.cell_x, square.cell_y, square.half_side
    count = 0
    for ix in range(max(x - side, 0), min(x + side + 1, nx)):
        for iy in range(max(y - side, 0), min(y + side + 1, ny)):
            cell = ix * ny + iy
            if is_within_reach(square, ix - x, iy - y) and is_reachable(
                regions, robot, x * ny + y, cell
            ):
                out[count] = cell
                count += 1
    return count


@borrowing_kernel
def _insert(picked: NDArray[np.int64], pose_id: int) -> bool:
    """Insert a pose into the hash table of picked ones; return False if it is there already.

    The table has a power of two of slots, -1 where empty.
    """
    last = len(picked) - 1
    slot = (pose_id ^ (pose_id >> 7)) & last
    while picked[slot] >= 0:
        if picked[slot] == pose_id:
            return False
        slot = (slot + 1) & last
    picked[slot] = pose_id
    return True


@borrowing_kernel
def _sample_from_list(
    pose_id: int,
    robot: int,
    sampling: PoseSampling,
    regions: RegionArrays,
    stream: NDArray[np.uint64],
    picked: NDArray[np.int64],
    out: NDArray[np.int64],
    count: int,
) -> int:
    """Draw the poses that are missing after `count` from a list of the feasible cells."""
    n, cells = sampling.lattice.n_headings, regions.queue
    n_poses = write_feasible_cells(pose_id, robot, sampling, regions, cells) * n
    n_wanted, n_blocks = min(len(out), n_poses), 0
    while count < n_wanted:
        words = random_block(stream, n_blocks)
        n_blocks += 1
        for word in words:
            index = uniform_index(word, n_poses)
            pose = cells[index // n] * np.int64(n) + index % n
            if count < n_wanted and _insert(picked, pose):
                out[count] = pose
                count += 1
    take_blocks(stream, n_blocks)
    return count


@kernel
def sample_feasible_poses(
    pose_id: int,
    robot: int,
    sampling: PoseSampling,
    regions: RegionArrays,
    stream: NDArray[np.uint64],
    picked: NDArray[np.int64],
    out: NDArray[np.int64],
) -> int:
    """Draw up to len(out) different feasible poses, uniformly; return how many there are.

    `picked` is scratch of `picked_size(len(out))`.
    """
    nx, ny, _ = sampling.shape
    n = sampling.lattice.n_headings
    square = reach_square(pose_id, sampling.reach, sampling.lattice)
    x, y = square.cell_x, square.cell_y
    side = min(square.half_side, max(nx, ny))
    width = 2 * side + 1
    picked[:] = -1
    count, n_blocks = 0, 0
    while count < len(out) and 4 * n_blocks < TRIES_PER_POSE * len(out):
        words = random_block(stream, n_blocks)
        n_blocks += 1
        for word in words:
            index = uniform_index(word, width * width * n)
            place, heading = index // n, index % n
            i, j = place // width - side, place % width - side
            ix, iy = x + i, y + j
            if count == len(out) or not (0 <= ix < nx and 0 <= iy < ny):
                continue
            cell = ix * ny + iy
            if not is_within_reach(square, i, j) or not is_reachable(
                regions, robot, x * ny + y, cell
            ):
                continue
            if _insert(picked, cell * n + heading):
                out[count] = cell * n + heading
                count += 1
    take_blocks(stream, n_blocks)
    if count < len(out):
        count = _sample_from_list(pose_id, robot, sampling, regions, stream, picked, out, count)
    return count


def picked_size(m: int) -> int:
    """Slots of the hash table for m poses: a power of two, at most half of them full."""
    return 1 << (2 * m).bit_length()
