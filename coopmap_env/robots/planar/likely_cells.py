"""Cells that a camera will probably reach, for planners that look ahead.

Unlike the regions of known free space, the map here holds for each cell the probability that it
will be known to be free. A path leads through cells in which this is high enough, and stays near:
within the smallest square of cells that holds those in reach.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import PlainTuple, kernel
from coopmap_env.robots.planar.feasible_poses import PoseSampling, is_within_reach, reach_square
from coopmap_env.robots.planar.pose_lattice import LatticeGeometry


def likely_cells(
    free: NDArray[np.float32], least: float, pose_id: int, sampling: PoseSampling
) -> NDArray[np.int64]:
    """Cells in reach of a pose to which a path leads that is probably free, the nearest first.

    Parameters
    ----------
    free : ndarray, shape (n_cells,)
        Probability that a cell will be known to be free.
    least : float
        The least of them that a path leads through.
    pose_id : int
        The cell of this pose is among those that are returned.
    sampling : PoseSampling
        What one action can reach.
    """
    nx, ny, _ = sampling.shape
    queue, found = np.empty(nx * ny + 1, np.int64), np.empty(nx * ny + 1, np.int64)
    count = write_likely_cells(
        free, least, int(pose_id), (nx, ny), tuple(sampling.lattice), sampling.reach, queue, found
    )
    return found[:count]


@kernel
def write_likely_cells(
    free: NDArray[np.float32],
    least: float,
    pose_id: int,
    shape: tuple[int, int],
    geometry: PlainTuple,
    reach: float,
    queue: NDArray[np.int64],
    found: NDArray[np.int64],
) -> int:
    """Write the cells of `likely_cells`; return their number. `geometry` is a `LatticeGeometry`."""
    nx, ny = shape
    square = reach_square(pose_id, reach, LatticeGeometry(*geometry))
    x, y, side = square.cell_x, square.cell_y, min(square.half_side, max(nx, ny))
    width = 2 * side + 1
    visited = np.zeros(width * width, np.uint8)
    visited[side * width + side] = 1
    queue[0] = x * ny + y
    head, tail, count = 0, 1, 0
    while head < tail:
        cell = queue[head]
        head += 1
        ix, iy = cell // ny, cell % ny
        if is_within_reach(square, ix - x, iy - y):
            found[count] = cell
            count += 1
        for d in range(4):
            i = ix + (d == 1) - (d == 0)
            j = iy + (d == 3) - (d == 2)
            if 0 <= i < nx and 0 <= j < ny and abs(i - x) <= side and abs(j - y) <= side:
                at = (i - x + side) * width + j - y + side
                if not visited[at] and free[i * ny + j] >= least:
                    visited[at] = 1
                    queue[tail] = i * ny + j
                    tail += 1
    return count
