"""Collision-free goals, reached by collision-free paths: constraints i and ii of the paper.

Both are decided on the *known* map alone: a cell is free if it was sampled and P < 0.05, and a
path leads through face-neighboring free cells only. A camera never moves through unknown space.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import PlainTuple, kernel
from coopmap_env.geometry import start_ray, step_ray
from coopmap_env.mapping import FREE_LOG_ODDS_FIXED, MapArrays, OccupancyMap


def free_mask(map_: OccupancyMap) -> NDArray[np.bool_]:
    """Cells known to be free, flat: sampled and P < 0.05."""
    return (map_.log_odds_fixed < FREE_LOG_ODDS_FIXED) & (map_.sampled_mask != 0)


@kernel
def is_free(arrays: MapArrays, cell: int | np.uint64) -> bool:
    """Whether one cell is known to be free."""
    return arrays.sampled_mask[cell] != 0 and arrays.log_odds_fixed[cell] < FREE_LOG_ODDS_FIXED


@kernel
def breadth_first_search(
    map_tuple: PlainTuple,
    start: int,
    goal: int,
    step_counts: NDArray[np.int32],
    queue: NDArray[np.int32],
) -> int:
    """Breadth-first search over free cells from `start`; return how many it reached.

    It ends at `goal`, if it gets there; with -1 it visits all cells. `queue` lists the cells by
    number of steps; `step_counts` is 1 + steps, 0 where no path leads. `map_tuple` is a plain
    `MapArrays`.
    """
    arrays = MapArrays(*map_tuple)
    nx, ny, _ = arrays.shape
    queue[0] = start
    step_counts[start] = 1
    head, tail = 0, 1
    while head < tail and (goal < 0 or step_counts[goal] == 0):
        cell = np.int64(queue[np.uint64(head)])
        head += 1
        iy = cell % ny
        steps = step_counts[np.uint64(cell)] + 1
        for side in range(4):
            if side == 0:
                neighbor, inside = cell - ny, cell >= ny
            elif side == 1:
                neighbor, inside = cell + ny, cell + ny < nx * ny
            elif side == 2:
                neighbor, inside = cell - 1, iy > 0
            else:
                neighbor, inside = cell + 1, iy + 1 < ny
            index = np.uint64(neighbor)
            if inside and step_counts[index] == 0 and is_free(arrays, index):
                step_counts[index] = steps
                queue[np.uint64(tail)] = neighbor
                tail += 1
    return tail


GOAL_UNKNOWN, GOAL_NOT_FREE, PATH_BLOCKED, PATH_FREE = range(4)


@kernel
def _straight_path_status(map_tuple: PlainTuple, start: int, goal: int) -> int:
    """What is known of the straight segment between two cell centers; the goal comes first.

    `map_tuple` is a plain `MapArrays`.
    """
    arrays = MapArrays(*map_tuple)
    nx, ny, _ = arrays.shape
    if start == goal:
        return PATH_FREE
    if not arrays.sampled_mask[goal]:
        return GOAL_UNKNOWN
    if not is_free(arrays, goal):
        return GOAL_NOT_FREE
    x0, y0 = start // ny + 0.5, start % ny + 0.5
    ux, uy = goal // ny + 0.5 - x0, goal % ny + 0.5 - y0
    length = np.sqrt(ux * ux + uy * uy)
    ray, position = start_ray((x0, y0, 0.5), (ux / length, uy / length, 0.0), (nx, ny, 1))
    while position.distance < length and position.cell != goal:
        if position.cell != start and not is_free(arrays, position.cell):
            return PATH_BLOCKED
        position = step_ray(ray, position)
    return PATH_FREE


def infeasibility_reason(map_: OccupancyMap, start: int, goal: int) -> str:
    """Why a camera cannot go from one cell to another; empty if it can.

    A free straight segment is a path of free face neighbors, and the quickest to find. Only if it
    is blocked, the known free space is searched for another path. The start cell, where the camera
    already stands, need not be free.
    """
    status = _straight_path_status(tuple(map_.arrays), start, goal)
    if status == GOAL_UNKNOWN:
        return "goal is unknown"
    if status == GOAL_NOT_FREE:
        return "goal is not known to be free"
    if status == PATH_BLOCKED and not ReachableCells.search(map_, start, goal).steps[goal]:
        return "no path through known free space leads there"
    return ""


def is_straight_path_free(map_: OccupancyMap, start: int, goal: int) -> bool:
    """Whether the straight segment between the centers of two cells is known to be free."""
    return _straight_path_status(tuple(map_.arrays), start, goal) == PATH_FREE


@dataclass(frozen=True)
class ReachableCells:
    """All cells that a camera can reach from its own, nearest first."""

    cells: NDArray[np.int32]
    """Shape (k,): flat cell indices by number of steps; the first is the start."""
    steps: NDArray[np.int32]
    """Shape (n_cells,): 1 + steps from the start, 0 where there is no path."""

    @classmethod
    def search(cls, map_: OccupancyMap, start: int, goal: int = -1) -> ReachableCells:
        """Search the known free space from the cell with flat index `start`.

        With a `goal`, the search ends there, and cells as far away may be missing.

        Raises
        ------
        ValueError
            If the start lies outside the map.
        """
        nx, ny = map_.grid.shape
        if not 0 <= start < nx * ny:
            raise ValueError(f"cell {start} lies outside the map of {nx} x {ny} cells")
        steps = np.zeros(nx * ny, dtype=np.int32)
        queue = np.empty(nx * ny, dtype=np.int32)
        count = breadth_first_search(tuple(map_.arrays), start, goal, steps, queue)
        return cls(queue[:count].copy(), steps)
