"""Random maps, written cell by cell rather than scanned."""

from coopmap_env.mapping import OccupancyMap, VoxelGrid, to_log_odds_fixed


def set_cells(map_, cells, probability):
    """Mark cells (flat indices) as sampled, with this probability."""
    map_.log_odds_fixed[cells] = to_log_odds_fixed(probability)
    map_.sampled_mask[cells] = 1
    map_.cells_changed()


def random_map(rng, shape, unknown=0.3, occupied=0.1, resolution=1.0, origin=(0.0, 0.0)):
    """Cells that are unknown, occupied, free, or sampled and undecided."""
    map_ = OccupancyMap(VoxelGrid(shape, resolution, origin))
    n, clamp = map_.grid.n_cells, map_.log_odds_range.clamp
    kind = rng.random(n)
    log_odds_fixed = rng.integers(-clamp, -clamp // 2, n)
    log_odds_fixed[kind < unknown + occupied] = rng.integers(0, clamp + 1)
    undecided = rng.random(n) < 0.1
    log_odds_fixed[undecided] = rng.integers(-clamp // 2, clamp // 2, undecided.sum())
    log_odds_fixed[kind < unknown] = 0
    map_.log_odds_fixed[:] = log_odds_fixed
    map_.sampled_mask[:] = kind >= unknown
    return map_
