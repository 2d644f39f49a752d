"""The interpretation of recorded data, surface="partial": a wall fills a part of its cells."""

import math

import numpy as np
import pytest

from coopmap_env.mapping import (
    BeamModel,
    OccupancyMap,
    VoxelGrid,
    beam_occupancy,
    to_log_odds_fixed,
)
from coopmap_env.sensing import Scan

PARTIAL = BeamModel(free=0.2, occupied=0.7, surface="partial")


def scan(*ends, origin=(0.5, 2.5), hit=True, sigma=0.05):
    """Beams from one origin to each end."""
    points = np.array(ends, dtype=float)
    covariances = np.tile(np.eye(2) * sigma**2, (len(points), 1, 1))
    return Scan(np.array(origin), points, covariances, np.broadcast_to(hit, len(points)).copy())


def fused(*scans, shape=(8, 5), model=PARTIAL):
    map_ = OccupancyMap(VoxelGrid(shape), model)
    for one in scans:
        map_.integrate(one)
    return map_


def log_odds_fixed(map_):
    return map_.log_odds_fixed.reshape(map_.grid.shape)


def test_three_cells_by_hand():
    # Path through the cells: 1, 1/2, 1. A flat likelihood leaves the lengths and the prior, which
    # halves with every cell's length: 1, 1/2 * 1/2, 2**-1.5.
    p = beam_occupancy([0.0, 1.0, 1.5], [1.0, 1.5, 2.5], 1.25, 1e3, PARTIAL)
    w = np.array([1.0, 0.25, 2.0**-1.5])
    w /= w.sum()
    np.testing.assert_allclose(p, [w[0], w[1] + w[0] / 2, w[2] + (w[0] + w[1]) / 2], rtol=1e-6)


def test_splitting_the_path_into_more_cells_does_not_change_where_the_beam_ends():
    whole = beam_occupancy([0.0, 1.0, 2.0], [1.0, 2.0, 3.0], 1.4, 0.2, PARTIAL)
    cut = beam_occupancy(
        [0.0, 1.0, 1.0 + 1e-9, 2.0], [1.0, 1.0 + 1e-9, 2.0, 3.0], 1.4, 0.2, PARTIAL
    )
    np.testing.assert_allclose(cut[[0, 2, 3]], whole, atol=1e-6)


def test_a_distance_that_no_cell_explains_belongs_to_the_cell_that_holds_it():
    p = beam_occupancy([0.0, 1.0], [1.0, 2.0], 90.0, 0.01, PARTIAL)
    np.testing.assert_allclose(p, [0.0, 1.0])


def test_a_beam_through_entire_cells_updates_them_up_to_the_bounds_of_a_scan():
    map_ = fused(scan((6.5, 2.5)))
    lowest, highest = PARTIAL.log_odds_bounds
    assert log_odds_fixed(map_)[1:6, 2].tolist() == [lowest] * 5
    assert log_odds_fixed(map_)[6, 2] == highest
    assert log_odds_fixed(map_)[0, 2] == pytest.approx(lowest / 2, abs=1)  # half of it is crossed
    assert not map_.sampled[7, 2]


def test_a_beam_that_ends_counts_before_beams_that_pass():
    # both cross cell (3, 2): one ends there, the other passes on to cell (6, 2)
    ends, passes = (3.5, 2.4), (6.5, 2.6)
    one, other = fused(scan(ends, passes)), fused(scan(passes, ends))
    assert log_odds_fixed(one)[3, 2] == PARTIAL.log_odds_bounds[1]
    np.testing.assert_array_equal(one.log_odds_fixed, other.log_odds_fixed)
    np.testing.assert_array_equal(one.sampled, other.sampled)


def test_of_beams_that_pass_the_one_with_the_longest_path_counts():
    # through cell (1, 3): one beam along its diagonal, the other over 1/3 along x and 1/7 along y
    diagonal, flatter = (4.5, 6.5), (7.5, 5.5)
    only = fused(scan(flatter, hit=False), shape=(8, 8))
    both = fused(scan(diagonal, flatter, diagonal, hit=False), shape=(8, 8))
    lowest, _ = PARTIAL.log_odds_bounds
    assert log_odds_fixed(only)[1, 3] == pytest.approx(math.hypot(1 / 3, 1 / 7) * lowest, abs=1)
    assert log_odds_fixed(both)[1, 3] == lowest


def test_a_corner_crossed_with_almost_no_length_is_not_updated():
    # rises by 1e-5 over one cell's border: the path through cell (2, 2) is far below one step
    map_ = fused(scan((5.5, 3.00001), origin=(0.5, 2.99999), hit=False))
    update = log_odds_fixed(map_)
    assert update[1, 2] == update[4, 3] == PARTIAL.log_odds_bounds[0]
    sampled = map_.sampled
    assert np.array_equal(sampled.ravel(), map_.log_odds_fixed != 0)


def test_scans_add_up():
    once, twice = fused(scan((6.5, 2.5))), fused(*[scan((6.5, 2.5))] * 2)
    np.testing.assert_array_equal(twice.log_odds_fixed, 2 * once.log_odds_fixed)


def test_no_scan_updates_a_cell_beyond_its_bounds():
    rng = np.random.default_rng(3)
    for _ in range(20):
        one = scan(*rng.uniform(0, (8, 5), (30, 2)), origin=rng.uniform(1, 4, 2), sigma=0.3)
        map_ = fused(one)
        assert map_.log_odds_fixed.min() >= PARTIAL.log_odds_bounds[0]
        assert map_.log_odds_fixed.max() <= PARTIAL.log_odds_bounds[1]
        shuffled = rng.permutation(30)
        again = fused(Scan(one.origin, one.points[shuffled], one.covariances, one.hit))
        np.testing.assert_array_equal(map_.log_odds_fixed, again.log_odds_fixed)


def test_partial_surfaces_in_three_dimensions():
    map_ = OccupancyMap(VoxelGrid((5, 3, 3)), PARTIAL)
    covariances = np.tile(np.eye(3) * 0.05**2, (1, 1, 1))
    map_.integrate(
        Scan(np.array([0.5, 1.5, 1.5]), np.array([[3.5, 1.5, 1.5]]), covariances, np.array([True]))
    )
    assert log_odds_fixed(map_)[3, 1, 1] == to_log_odds_fixed(0.7)
    assert log_odds_fixed(map_)[1, 1, 1] == to_log_odds_fixed(0.2)
    assert math.isclose(map_.surfaces()[1][0][0], 3.5, abs_tol=1e-6)
