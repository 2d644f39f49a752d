"""How much a never-sampled voxel counts as surface, by its distance to the known surface.

Surfaces go on: most of what is still to be found of an object lies beside the part that is known.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coopmap_env.mapping import OccupancyMap

NEAR_SURFACE = (
    0.12, 0.072, 0.054, 0.042, 0.034, 0.026, 0.022, 0.018, 0.014, 0.012, 0.01, 0.007, 0.006, 0.005,
    0.0036,
)  # fmt: skip
"""How much voxels count that are 1, 2, ..., 15 or more voxels (the longest of dx, dy and dz) from
the nearest one that is known to be occupied, as if it were their probability to be surface.

On training worlds of the field scenes, 12 to 17 % of those next to the known surface are surface,
8 % at 2 to 6 voxels and 3 % at 14 (voxels of 0.1 m). A faster fall covers more, so these are no
probabilities: see `docs/what_was_tried.md`."""


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
    from scipy.ndimage import distance_transform_cdt  # a third of a second, seldom needed

    occupied = (map_.log_odds_fixed >= 0) & (map_.sampled_mask != 0)
    steps = np.full(occupied.shape, len(NEAR_SURFACE))
    if occupied.any():
        far = distance_transform_cdt(~occupied.reshape(map_.grid.shape), "chessboard").ravel()
        steps = np.minimum(far, len(NEAR_SURFACE))
    weights: NDArray[np.float32] = np.array([0.0, *NEAR_SURFACE], dtype=np.float32)[steps]
    return weights
