"""Maps with every kind of cell, and all their bits."""

import numpy as np
from plain.random_scans import random_scan

from coopmap_env.mapping import BeamModel, LogOddsRange, OccupancyMap, VoxelGrid

PLANAR_GRID = VoxelGrid((14, 11), 0.5, (-2.0, 1.0))
FIELD_GRID = VoxelGrid((9, 7, 8), 0.25, (0.55, -1.0, 2.0))


def scanned_map(grid, n_scans=8, seed=0, surface_fusion="eq_4"):
    rng = np.random.default_rng(seed)
    model = BeamModel(0.01, 0.97, "anywhere", surface_fusion=surface_fusion)
    map_ = OccupancyMap(grid, model, LogOddsRange(0.995))
    for _ in range(n_scans):
        map_.integrate(random_scan(rng, grid, 12))
    map_.log_odds_fixed[7], map_.sampled_mask[7] = 0, 1
    return map_


def state(map_):
    arrays = (map_.log_odds_fixed, map_.sampled_mask, map_.hit_cells, *map_.hit_cell_sums()[1])
    return [(array.dtype, array.tobytes()) for array in arrays]
