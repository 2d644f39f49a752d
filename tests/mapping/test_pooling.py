"""Maps at half their resolution, kept up to date."""

import math

import numpy as np
from plain.random_scans import random_scan
from plain.scanned_maps import FIELD_GRID, scanned_map

from coopmap_env.mapping import MapArrays, OccupancyMap, VoxelGrid
from coopmap_env.mapping.pooling import PooledMap, pool_mask, pooled_grid


def test_a_pooled_block_is_occupied_by_any_and_unknown_by_most_of_its_voxels():
    rng = np.random.default_rng(3)
    # an odd number of voxels along x: the last blocks hold four
    grid = VoxelGrid((7, 6, 4), 0.1, (1.0, 2.0, 3.0))
    coarse = pooled_grid(grid)
    assert coarse == VoxelGrid((4, 3, 2), 0.2, (1.0, 2.0, 3.0))
    log_odds_fixed = rng.integers(-900, 90, grid.n_cells).astype(np.int32)
    sampled, reserved_mask = (rng.random((2, grid.n_cells)) < 0.5).astype(np.uint8)
    arrays = MapArrays(log_odds_fixed * sampled, sampled, grid.shape_3d, 1000)
    pooled, pooled_mask = PooledMap(arrays).arrays, pool_mask(reserved_mask, grid)
    assert (pooled.shape, pooled.clamp) == (coarse.shape_3d, 1000)
    block = {}
    for cell, index in enumerate(np.ndindex(grid.shape)):
        block.setdefault(tuple(i // 2 for i in index), []).append(cell)
    kinds = set()
    for index, cells in block.items():
        k = int(coarse.flat_index(index))
        known = [log_odds_fixed[c] for c in cells if sampled[c]]
        occupied = any(level >= 0 for level in known)
        unknown = not occupied and len(cells) - len(known) > len(cells) / 2
        assert pooled.sampled_mask[k] == (not unknown)
        level = max(known) if occupied else 0 if unknown else math.floor(np.mean(known))
        assert pooled.log_odds_fixed[k] == level
        assert pooled_mask[k] == (sum(reserved_mask[c] for c in cells) > len(cells) / 2)
        kinds.add((occupied, unknown))
    assert len(kinds) == 3


def occludes(arrays):
    return (arrays.sampled_mask == 1) & (arrays.log_odds_fixed >= 0)


def is_up_to_date(map_):
    fresh = PooledMap(map_.arrays).arrays
    pairs = zip(map_.pooled[:2], fresh[:2], strict=True)
    views = [map_.viewed(), map_.viewed(pooled=True)]
    assert views[0].arrays is map_.arrays
    return all(np.array_equal(kept, made) for kept, made in pairs) and all(
        bits_of(occluders, occludes(arrays)) for arrays, occluders in views
    )


def bits_of(words, flags):
    """Whether the bits of some words are these flags, and zero after the last one."""
    bits = np.unpackbits(words.view(np.uint8), bitorder="little")
    return np.array_equal(bits[: len(flags)], flags) and not bits[len(flags) :].any()


def test_the_bits_of_the_occluders_by_hand():
    map_ = OccupancyMap(VoxelGrid((5, 5, 3)))
    for cell, log_odds in ((0, 0), (3, -1), (63, 1), (64, 7), (74, 1)):
        map_.log_odds_fixed[cell], map_.sampled_mask[cell] = log_odds, 1
    assert map_.viewed().occluders.tolist() == [(1 << 63) + 1, (1 << 10) + 1]
    map_.log_odds_fixed[0] = -1
    map_.cells_changed()
    assert map_.viewed().occluders.tolist() == [1 << 63, (1 << 10) + 1]


def test_the_pooled_map_stays_that_of_the_map_whatever_changes_the_map():
    rng = np.random.default_rng(0)
    map_ = scanned_map(FIELD_GRID)
    assert is_up_to_date(map_)
    for _ in range(5):
        before, occluders = map_.pooled.log_odds_fixed.copy(), map_.viewed().occluders.copy()
        map_.integrate([random_scan(rng, FIELD_GRID) for _ in range(3)])
        assert is_up_to_date(map_)
        assert not np.array_equal(map_.pooled.log_odds_fixed, before)
        assert (map_.viewed().occluders != occluders).any()
    map_.mark_free([5, 80])
    assert is_up_to_date(map_)
    map_.mark_occupied([5, 200])
    assert is_up_to_date(map_)
    copied, state = map_.copy(), (map_.log_odds_fixed.copy(), map_.sampled_mask.copy())
    map_.integrate(random_scan(rng, FIELD_GRID))
    assert is_up_to_date(copied)
    assert not np.array_equal(copied.pooled.log_odds_fixed, map_.pooled.log_odds_fixed)
    map_.clear()
    assert is_up_to_date(map_)
    assert not map_.pooled.sampled_mask.any()
    map_.set_state(*state, *copied.hit_cell_sums())
    assert is_up_to_date(map_)


def test_the_first_pooled_map_is_made_after_the_scans_it_holds():
    map_ = OccupancyMap(FIELD_GRID)
    map_.integrate(random_scan(np.random.default_rng(1), FIELD_GRID))
    assert is_up_to_date(map_)
    assert map_.pooled.sampled_mask.any()
