"""Views by cell codes are equal, to the last bit, to views entry by entry; and the codes."""

import math

import numpy as np
import pytest
from plain import planar_views
from plain.random_maps import random_map

from coopmap_env.information import (
    NewInformationCache,
    PlanarRatingFunction,
    PlanarRatingSettings,
    ViewContext,
)
from coopmap_env.information.planar.cell_codes import EMPTY, UNKNOWN, update_codes, write_codes
from coopmap_env.mapping import FREE_LOG_ODDS_FIXED, LogOddsRange, OccupancyMap, VoxelGrid
from coopmap_env.robots import PoseLattice
from coopmap_env.sensing import PlanarCamera

CAMERAS = [
    pytest.param(PlanarCamera(1.0, 7.0, 1), 7, id="one beam"),
    pytest.param(PlanarCamera(depth_of_field=8.0, n_beams=64), 16, id="one full word"),
    pytest.param(PlanarCamera(2 * math.pi, 9.0, 100), 3, id="two words"),
    pytest.param(PlanarCamera(1.0, 0.3, 4), 2, id="its own cell"),
]
READINGS = [
    pytest.param({"interpretation": i, "hidden": h, "n_gray_bins": n}, id=f"{i}-{h}-{n}")
    for i in ("distance_free", "literal")
    for h in ("empty", "printed")
    for n in (128, 7, 2)
]
SHAPE = (31, 26)


def rating_of(map_, camera, n_headings, **settings):
    lattice = PoseLattice(map_.grid, n_headings)
    return PlanarRatingFunction(
        camera, lattice, PlanarRatingSettings(**settings), map_.log_odds_range
    )


def random_maps(rng):
    """Maps of every kind: mostly unknown, mostly known, full of occluders, full of doubt."""
    for unknown, occupied in ((0.5, 0.02), (0.1, 0.0), (0.3, 0.2)):
        yield random_map(rng, SHAPE, unknown, occupied)
    doubtful = OccupancyMap(VoxelGrid(SHAPE), log_odds_range=LogOddsRange(0.7))
    clamp = doubtful.log_odds_range.clamp
    doubtful.sampled_mask[:] = rng.random(doubtful.grid.n_cells) < 0.7
    doubtful.log_odds_fixed[:] = rng.integers(-clamp, clamp // 8, doubtful.grid.n_cells)
    doubtful.log_odds_fixed[doubtful.sampled_mask == 0] = 0
    yield doubtful


def random_poses(rng, rating, n=6):
    """Poses anywhere, and in the four corners."""
    (nx, ny), n_headings = SHAPE, rating.lattice.n_headings
    corners = [0, ny - 1, (nx - 1) * ny, nx * ny - 1]
    cells = np.append(corners, rng.integers(0, nx * ny, n))
    return cells * n_headings + rng.integers(0, n_headings, len(cells))


@pytest.mark.parametrize("settings", READINGS)
@pytest.mark.parametrize(("camera", "n_headings"), CAMERAS)
def test_views_equal_the_plain_ones_to_the_last_bit_eqs_6_to_8(camera, n_headings, settings):
    rng = np.random.default_rng(0)
    for map_ in random_maps(rng):
        rating = rating_of(map_, camera, n_headings, **settings)
        poses = random_poses(rng, rating)
        nothing = np.zeros(map_.grid.n_cells, dtype=np.uint8)
        some = (rng.random(map_.grid.n_cells) < 0.2).astype(np.uint8)
        for mask, context in ((nothing, ViewContext()), (some, ViewContext(some))):
            ni, unknown = rating.new_information_and_unknown(map_, poses, context)
            plain = [planar_views.new_information(map_, rating, pose, mask) for pose in poses]
            assert list(zip(ni.tolist(), unknown.tolist(), strict=True)) == plain
        cells = [at for _, at in planar_views.visible_entries(map_, rating.fan, poses[-1])]
        assert rating.visible_cells(map_, int(poses[-1])).tolist() == cells


@pytest.mark.parametrize("hidden", ["empty", "printed"])
@pytest.mark.parametrize(("camera", "n_headings"), CAMERAS)
def test_of_a_team_an_overlap_counts_once_as_in_plain_views(camera, n_headings, hidden):
    rng = np.random.default_rng(1)
    for map_ in random_maps(rng):
        rating = rating_of(map_, camera, n_headings, hidden=hidden)
        # three robots that see much the same, then others
        pose = rng.integers(0, rating.lattice.n_poses)
        poses = np.append([pose] * 2, [*random_poses(rng, rating, 2), pose])
        found = rating.rate_team(map_, poses, np.zeros(len(poses))).new_information
        assert found.tolist() == planar_views.sequential_new_information(map_, rating, poses)


@pytest.mark.parametrize("n_poses", [1, 2, 5, 40])
def test_a_view_is_the_same_whether_few_or_all_cells_are_coded(n_poses):
    rng = np.random.default_rng(2)
    map_ = random_map(rng, (60, 50))
    rating = rating_of(map_, PlanarCamera(depth_of_field=8.0), 16)
    poses = rng.integers(0, rating.lattice.n_poses, 200)
    everything = rating.new_information(map_, poses)
    assert (rating.new_information(map_, poses[:n_poses]) == everything[:n_poses]).all()


@pytest.mark.parametrize("settings", READINGS)
def test_the_cache_equals_rating_again_however_cells_change(settings):
    rng = np.random.default_rng(3)
    map_ = random_map(rng, SHAPE, 0.5, 0.02)
    rating = rating_of(map_, PlanarCamera(depth_of_field=6.0), 8, **settings)
    cache, poses = NewInformationCache(rating), np.arange(rating.lattice.n_poses)
    for _ in range(5):
        assert (cache.new_information(map_, poses) == rating.new_information(map_, poses)).all()
        cells = rng.integers(0, map_.grid.n_cells, 4)
        clamp = map_.log_odds_range.clamp
        map_.sampled_mask[cells] = 1
        map_.log_odds_fixed[cells] += rng.integers(-900, 900, 4, dtype=np.int32)
        np.clip(map_.log_odds_fixed, -clamp, clamp, out=map_.log_odds_fixed)
    assert cache.n_rated < 4 * len(poses)


# the codes


@pytest.mark.parametrize("interpretation", ["distance_free", "literal"])
@pytest.mark.parametrize("n_gray_bins", [2, 7, 128, 256])
@pytest.mark.parametrize("max_probability", [0.6, 0.999, 0.9999])
def test_codes_hold_the_bins_and_both_thresholds_eq_8a(
    interpretation, n_gray_bins, max_probability
):
    map_ = OccupancyMap(VoxelGrid((9, 9)), log_odds_range=LogOddsRange(max_probability))
    rating = rating_of(
        map_, PlanarCamera(1.0, 4.0, 5), 4, interpretation=interpretation, n_gray_bins=n_gray_bins
    )
    clamp, table, gray = map_.log_odds_range.clamp, rating.codes, rating.gray
    log_odds, codes = np.arange(-clamp, clamp + 1), table.of_log_odds.astype(int)
    assert (table.bins[:, codes] == gray.sampled).all()
    assert ((codes < table.first_not_free) == (log_odds < FREE_LOG_ODDS_FIXED)).all()
    assert ((codes >= table.first_occupied) == (log_odds >= 0)).all()
    is_empty = (gray.sampled == 0).all(axis=0) & (log_odds < FREE_LOG_ODDS_FIXED)
    assert ((codes == EMPTY) == is_empty).all()
    assert (np.diff(codes) >= 0).all()
    assert codes.min() >= EMPTY
    assert codes.max() < 200  # of 254


def test_codes_of_a_map_by_hand():
    """Never sampled, empty, occupied; and one cell that changes."""
    map_ = OccupancyMap(VoxelGrid((1, 4)))
    rating = rating_of(map_, PlanarCamera(1.0, 4.0, 5), 4, n_gray_bins=4)
    # free for motion or not in bin 0, not counted, occupied in bin 1
    assert np.unique(rating.codes.of_log_odds).tolist() == [EMPTY, 2, 4]
    cells, table = (map_.log_odds_fixed, map_.sampled_mask), rating.codes.of_log_odds
    map_.log_odds_fixed[:] = [0, -7000, 7000, 0]
    map_.sampled_mask[1:] = 1
    codes = np.full(4, 99, dtype=np.uint8)
    write_codes(*cells, table, codes)
    assert codes.tolist() == [UNKNOWN, EMPTY, 4, 4]
    map_.log_odds_fixed[1:3] = [-1, -1]
    update_codes(*cells, np.array([1, 2]), 1, table, codes)
    assert codes.tolist() == [UNKNOWN, 2, 4, 4]
