"""What never-sampled cells are expected to be, by their distance to the known surface.

Surfaces go on: most of what is still to be found of an object lies beside the part that is known.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coopmap_env.mapping import OccupancyMap

HAZARDS = (0.55, 0.22, 0.08, 0.08, 0.03)
"""Probability that a beam ends in a never-sampled cell that it has reached, in planar maps, where
the nearest cell that is known to be occupied is 1, 2, 3, 4, and 5 or more cells away (the longer of
dx and dy).

About the fractions of such cells beside known free ones that are occupied, on training worlds of
rooms, the house and obstacles: 0.5 to 0.7, 0.16 to 0.28, 0.05 to 0.14 and, from 5 on, 0.01 to 0.06.
The true numbers of new cells are 0.95 to 1.25 times the expected ones; their correlation is 0.84 to
0.94, against 0.80 to 0.89 with a hazard of 0.03 everywhere."""
NEAR_SURFACE = (
    0.12, 0.072, 0.054, 0.042, 0.034, 0.026, 0.022, 0.018, 0.014, 0.012, 0.01, 0.007, 0.006, 0.005,
    0.0036,
)  # fmt: skip
"""How much voxels count that are 1, 2, ..., 15 or more voxels (the longest of dx, dy and dz) from
the nearest one that is known to be occupied, as if it were their probability to be surface.

On training worlds of the field scenes, 12 to 17 % of those next to the known surface are surface,
8 % at 2 to 6 voxels and 3 % at 14 (voxels of 0.1 m). A faster fall covers more, so these are no
probabilities: see `docs/what_was_tried.md`."""


def near_surface_hazards(map_: OccupancyMap) -> NDArray[np.float32]:
    """`HAZARDS` of each cell of a planar map, (n_cells,); only those never sampled mean something.

    Raises
    ------
    ValueError
        If the map has three dimensions.
    """
    if map_.grid.dimension != 2:
        raise ValueError(
            "these hazards are of planar maps, and this one has three dimensions: choose "
            "near_surface_weights"
        )
    return _by_distance(map_, HAZARDS)


def near_surface_weights(map_: OccupancyMap) -> NDArray[np.float32]:
    """`NEAR_SURFACE` of each voxel, (n_cells,); only those never sampled mean something.

    Raises
    ------
    ValueError
        If the map is planar.
    """
    if map_.grid.dimension != 3:
        raise ValueError(
            "new surface is counted in maps of three dimensions, and this one is planar: choose "
            "lookahead"
        )
    return _by_distance(map_, NEAR_SURFACE)


def _by_distance(map_: OccupancyMap, values: tuple[float, ...]) -> NDArray[np.float32]:
    """The value of each cell (n_cells,) for its distance; 0 where it is occupied itself."""
    from scipy.ndimage import distance_transform_cdt  # a third of a second, seldom needed

    occupied = (map_.log_odds_fixed >= 0) & (map_.sampled_mask != 0)
    steps = np.full(occupied.shape, len(values))
    if occupied.any():
        far = distance_transform_cdt(~occupied.reshape(map_.grid.shape), "chessboard").ravel()
        steps = np.minimum(far, len(values))
    found: NDArray[np.float32] = np.array([0.0, *values], dtype=np.float32)[steps]
    return found
