"""Which cells each robot of a team reaches, kept up to date from scan to scan.

Constraints i and ii of the paper, decided on the *known* map alone: a cell is free if it was
sampled and P < 0.05, and a path leads through face-neighboring free cells only. A camera never
moves through unknown space.

Free cells that are connected form a region; every region that a robot can enter has a label. A
robot in a free cell reaches the region of that cell. A cell in which a robot stands need not be
free (its map may have changed): then the robot reaches the regions around it, and its own cell.

A scan mostly makes cells free, and regions grow by a search from these cells alone. Where a free
cell is lost or two regions meet, all regions are searched again.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import borrowing_kernel, kernel
from coopmap_env.mapping import MapArrays
from coopmap_env.robots.planar.reachable_cells import is_free

MAX_LABEL = 60_000
"""Labels are 16 bits wide; before they run out, all regions are searched again."""
_N_SIDES = 4
FEASIBLE, OUTSIDE_WORLD, GOAL_UNKNOWN, GOAL_NOT_FREE, NO_PATH = range(5)
"""Why a robot cannot go to a cell: results of `feasibility`."""


class RegionArrays(NamedTuple):
    """The regions that a team reaches."""

    labels: NDArray[np.uint16]
    """Region of each cell (n_cells,), 0 for none; only free cells have one."""
    access: NDArray[np.uint16]
    """Regions that each robot reaches (n_robots, 4), 0 for none."""
    n_labels: NDArray[np.int64]
    """Labels that are in use (1,): 1 ... n_labels."""
    queue: NDArray[np.int32]
    """Scratch (n_cells,)."""

    @classmethod
    def empty(cls, n_cells: int, n_robots: int) -> RegionArrays:
        """Those of a team that reaches nothing."""
        return cls(
            np.zeros(n_cells, dtype=np.uint16),
            np.zeros((n_robots, _N_SIDES), dtype=np.uint16),
            np.zeros(1, dtype=np.int64),
            np.empty(n_cells, dtype=np.int32),
        )


@borrowing_kernel
def neighbor(cell: int, side: int, shape: tuple[int, int, int]) -> int:
    """The cell beyond a side (0 to 3) of a planar cell; -1 outside of the grid."""
    nx, ny, _ = shape
    if side == 0:
        return cell - ny if cell >= ny else -1
    if side == 1:
        return cell + ny if cell + ny < nx * ny else -1
    if side == 2:
        return cell - 1 if cell % ny > 0 else -1
    return cell + 1 if cell % ny + 1 < ny else -1


@borrowing_kernel
def is_reachable(regions: RegionArrays, robot: int, start: int, cell: int) -> bool:
    """Whether a robot that stands in the cell `start` reaches a cell."""
    label = regions.labels[np.uint64(cell)]
    if label == 0:
        return cell == start
    for slot in range(_N_SIDES):
        if label == regions.access[robot, slot]:
            return True
    return cell == start


@borrowing_kernel
def _grow(arrays: MapArrays, regions: RegionArrays, n: int, label: int) -> bool:
    """Extend a region from the first n cells of the queue; return if it met no other region."""
    labels, _, _, queue = regions
    head, tail = 0, n
    while head < tail:
        cell = int(queue[head])
        head += 1
        for side in range(_N_SIDES):
            beside = neighbor(cell, side, arrays.shape)
            if beside < 0:
                continue
            found = labels[np.uint64(beside)]
            if found == 0 and is_free(arrays, np.uint64(beside)):
                labels[np.uint64(beside)] = label
                queue[tail] = beside
                tail += 1
            elif found != 0 and found != label:
                return False
    return True


@borrowing_kernel
def _region_of(arrays: MapArrays, regions: RegionArrays, cell: int) -> int:
    """Label of a free cell's region, which is searched if it has none yet."""
    if regions.labels[cell] == 0:
        regions.n_labels[0] += 1
        label = regions.n_labels[0]
        regions.labels[cell] = label
        regions.queue[0] = cell
        _grow(arrays, regions, 1, label)
    return regions.labels[cell]


@borrowing_kernel
def _find_access(arrays: MapArrays, regions: RegionArrays, robot: int, start: int) -> None:
    """Write the regions that a robot reaches from the cell in which it stands."""
    access = regions.access[robot]
    access[:] = 0
    if is_free(arrays, start):
        access[0] = _region_of(arrays, regions, start)
        return
    for side in range(_N_SIDES):
        beside = neighbor(start, side, arrays.shape)
        if beside >= 0 and is_free(arrays, beside):
            access[side] = _region_of(arrays, regions, beside)


@kernel
def find_regions(
    arrays: MapArrays, poses: NDArray[np.int64], n_headings: int, regions: RegionArrays
) -> None:
    """Search all regions that the robots at these pose ids (n_robots,) reach."""
    regions.labels[:] = 0
    regions.n_labels[0] = 0
    label_regions(arrays, poses, n_headings, regions)


@borrowing_kernel
def label_regions(
    arrays: MapArrays, poses: NDArray[np.int64], n_headings: int, regions: RegionArrays
) -> None:
    """`find_regions` where no cell has a label yet."""
    for robot in range(len(poses)):
        _find_access(arrays, regions, robot, poses[robot] // n_headings)


@borrowing_kernel
def _extend_regions(
    arrays: MapArrays, regions: RegionArrays, changed_cells: NDArray[np.int64], n: int
) -> bool:
    """Let regions grow over n changed cells; return False where they must be searched again."""
    labels, _, _, queue = regions
    for k in range(n):
        cell = np.uint64(changed_cells[k])
        label = labels[cell]
        free = is_free(arrays, cell)
        if label != 0:
            if not free:
                return False
            continue
        if not free:
            continue
        for side in range(_N_SIDES):
            beside = neighbor(int(cell), side, arrays.shape)
            if beside >= 0 and labels[np.uint64(beside)] != 0:
                label = labels[np.uint64(beside)]
        if label != 0:
            labels[cell] = label
            queue[0] = cell
            if not _grow(arrays, regions, 1, label):
                return False
    return True


@borrowing_kernel
def update_regions(
    arrays: MapArrays,
    changed_cells: NDArray[np.int64],
    n: int,
    poses: NDArray[np.int64],
    n_headings: int,
    regions: RegionArrays,
) -> None:
    """`find_regions` after n cells changed and the robots moved.

    The first n of `changed_cells` are flat indices; a cell may be listed twice.
    """
    if regions.n_labels[0] > MAX_LABEL or not _extend_regions(arrays, regions, changed_cells, n):
        find_regions(arrays, poses, n_headings, regions)
        return
    for robot in range(len(poses)):
        _find_access(arrays, regions, robot, poses[robot] // n_headings)


@kernel
def feasibility(arrays: MapArrays, regions: RegionArrays, robot: int, start: int, goal: int) -> int:
    """Whether a robot can go from one cell to another: FEASIBLE, or why not.

    The start, where the camera already stands, need not be free.
    """
    if goal == start:
        return FEASIBLE
    if not arrays.sampled_mask[np.uint64(goal)]:
        return GOAL_UNKNOWN
    if not is_free(arrays, np.uint64(goal)):
        return GOAL_NOT_FREE
    return FEASIBLE if is_reachable(regions, robot, start, goal) else NO_PATH
