"""Free cells of the known map, and the shortest paths through them.

A cell is free if it was sampled and P < 0.05. Paths lead through face-neighboring free cells only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import PlainTuple, borrowing_kernel, kernel
from coopmap_env.mapping import FREE_LOG_ODDS_FIXED, MapArrays, OccupancyMap


def free_mask(map_: OccupancyMap) -> NDArray[np.bool_]:
    """Cells known to be free, flat: sampled and P < 0.05."""
    return (map_.log_odds_fixed < FREE_LOG_ODDS_FIXED) & (map_.sampled_mask != 0)


@borrowing_kernel
def is_free(arrays: MapArrays, cell: int | np.uint64) -> bool:
    """Whether one cell is known to be free."""
    return arrays.sampled_mask[cell] != 0 and arrays.log_odds_fixed[cell] < FREE_LOG_ODDS_FIXED


@kernel
def breadth_first_search(
    map_tuple: PlainTuple,
    start: int,
    step_counts: NDArray[np.int32],
    queue: NDArray[np.int32],
) -> int:
    """Breadth-first search over free cells from `start`; return how many it reached.

    `queue` lists the cells by number of steps; `step_counts` is 1 + steps, 0 where no path leads.
    `map_tuple` is a plain `MapArrays`.
    """
    arrays = MapArrays(*map_tuple)
    nx, ny, _ = arrays.shape
    queue[0] = start
    step_counts[start] = 1
    head, tail = 0, 1
    while head < tail:
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


@dataclass(frozen=True)
class ReachableCells:
    """All cells that a camera can reach from its own, nearest first."""

    cells: NDArray[np.int32]
    """Shape (k,): flat cell indices by number of steps; the first is the start."""
    steps: NDArray[np.int32]
    """Shape (n_cells,): 1 + steps from the start, 0 where there is no path."""

    @classmethod
    def search(cls, map_: OccupancyMap, start: int) -> ReachableCells:
        """Search the known free space from the cell with flat index `start`.

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
        count = breadth_first_search(tuple(map_.arrays), start, steps, queue)
        return cls(queue[:count].copy(), steps)
