"""Maps of random knowledge, written down cell by cell rather than scanned."""

from coopmap_env.mapping import OccupancyMap, VoxelGrid
from coopmap_env.mapping.log_odds import level_of


def write(map_, cells, probability):
    """Say that cells (flat numbers) were sampled and have this probability."""
    map_.levels[cells] = level_of(probability)
    map_.sampled_cells[cells] = 1


def random_map(rng, shape, unknown=0.3, occupied=0.1, resolution=1.0, origin=(0.0, 0.0)):
    """Cells that are unknown, occupied, free, or sampled and undecided."""
    map_ = OccupancyMap(VoxelGrid(shape, resolution, origin))
    n, clamp = map_.grid.n_cells, map_.range.clamp
    kind = rng.random(n)
    levels = rng.integers(-clamp, -clamp // 2, n)
    levels[kind < unknown + occupied] = rng.integers(0, clamp + 1)
    undecided = rng.random(n) < 0.1
    levels[undecided] = rng.integers(-clamp // 2, clamp // 2, undecided.sum())
    levels[kind < unknown] = 0
    map_.levels[:] = levels
    map_.sampled_cells[:] = kind >= unknown
    return map_
