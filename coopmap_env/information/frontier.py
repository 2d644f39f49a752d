"""Frontiers: where the sampled part of the map meets the never-sampled one (Yamauchi 1997)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coopmap_env.mapping import OccupancyMap


def adjacent_to_unknown(map_: OccupancyMap) -> NDArray[np.bool_]:
    """Which cells have a never-sampled face neighbor inside the grid, flat, shape (n_cells,)."""
    unknown = ~map_.sampled
    beside = np.zeros_like(unknown)
    for axis in range(unknown.ndim):
        lower, upper = _shifted_pair(unknown, axis), _shifted_pair(beside, axis)
        upper[0][...] |= lower[1]
        upper[1][...] |= lower[0]
    return beside.ravel()


def _shifted_pair(
    array: NDArray[np.bool_], axis: int
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Views of all but the last and of all but the first layer along an axis."""
    moved = np.moveaxis(array, axis, 0)
    return moved[:-1], moved[1:]
