"""Coverage, F-score and Chamfer distance of maps that are known by construction."""

import numpy as np
import pytest
from plain import true_surfaces as plain

from coopmap_env.evaluation.metrics import observed_mask
from coopmap_env.evaluation.metrics._triangle_distance import TriangleBins
from coopmap_env.evaluation.metrics.surface_scores import (
    SampleVoxels,
    distance_scores,
    surface_gaussians,
)
from coopmap_env.mapping import OccupancyMap, SurfaceArrays, VoxelGrid

GRID = VoxelGrid((20, 20, 10), 0.1, (0, 0, -0.55))
SQUARE = np.array([[[0.0, 0, 0], [2, 0, 0], [2, 2, 0]], [[0, 0, 0], [2, 2, 0], [0, 2, 0]]])
"""Two triangles at z = 0, from side to side of the grid."""
BINS = TriangleBins.from_triangles(SQUARE, GRID)
ON_IT = np.append(
    np.stack(np.meshgrid(*2 * [np.arange(0.05, 2, 0.1)]), -1), np.zeros((20, 20, 1)), 2
)
SAMPLES = ON_IT.reshape(-1, 3)
"""A sample in the middle of each voxel that the square runs through."""


def map_of(points, grid=GRID, level=2000):
    """A map whose voxels at these points are occupied, with these as surface means."""
    map_ = OccupancyMap(grid)
    cells = grid.flat_index(grid.index(points))
    log_odds_fixed, sampled = np.zeros(grid.n_cells, np.int32), np.zeros(grid.n_cells, np.uint8)
    log_odds_fixed[cells], sampled[cells] = level, 1
    precision = np.tile(1e4 * np.eye(3), (len(points), 1, 1))
    vectors = 1e4 * (points - grid.center(grid.index(points)))
    map_.set_state(log_odds_fixed, sampled, cells, SurfaceArrays.of_eq_4(precision, vectors))
    return map_


@pytest.mark.parametrize(("shift", "right"), [(0.0, 1), (0.04, 1), (0.09, 1), (0.12, 0), (0.3, 0)])
def test_a_shifted_plane_is_as_far_as_it_is_shifted(shift, right):
    f, precision, recall, chamfer = distance_scores(
        SAMPLES + np.array([0, 0, shift]), SAMPLES, BINS, 0.1
    )
    assert (f, precision, recall) == (right, right, right)
    assert chamfer == pytest.approx(shift, abs=1e-12)


def test_half_of_a_plane_has_half_the_recall():
    half = SAMPLES[SAMPLES[:, 0] < 1]
    f, precision, recall, chamfer = distance_scores(half, SAMPLES, BINS, 0.09)
    assert (precision, recall) == (1, 0.5)
    assert f == pytest.approx(2 / 3)  # 2 * 1 * 0.5 / 1.5
    # half of the samples is 0.1, 0.2, ... 1.0 m away, 0.275 m in the mean of all
    assert chamfer == pytest.approx(0.275 / 2)


def test_points_beside_the_surface_cost_precision_only():
    wrong = SAMPLES[:100] + np.array([0, 0, 0.4])
    f, precision, recall, _ = distance_scores(np.concatenate([SAMPLES, wrong]), SAMPLES, BINS, 0.1)
    assert (precision, recall) == (0.8, 1)
    assert f == pytest.approx(1.6 / 1.8)


def test_order_of_points_does_not_matter():
    rng = np.random.default_rng(0)
    points = rng.uniform((0, 0, -0.2), (2, 2, 0.2), (300, 3))
    expected = distance_scores(points, SAMPLES, BINS, 0.1)
    found = distance_scores(rng.permutation(points), rng.permutation(SAMPLES), BINS, 0.1)
    assert found == pytest.approx(expected, rel=1e-12)


def test_distance_scores_agree_with_all_pairs():
    rng = np.random.default_rng(1)
    points = rng.uniform((0, 0, -0.3), (2, 2, 0.3), (80, 3))
    samples = rng.permutation(SAMPLES)[:60]
    to_surface = np.abs(points[:, 2])
    to_map = np.linalg.norm(samples[:, None] - points, axis=2).min(axis=1)
    P, R = (to_surface <= 0.15).mean(), (to_map <= 0.15).mean()
    chamfer = (to_surface.mean() + to_map.mean()) / 2
    found = distance_scores(points, samples, BINS, 0.15)
    assert found == pytest.approx((2 * P * R / (P + R), P, R, chamfer), rel=1e-9)


def test_an_empty_map_scores_nothing_and_is_as_far_as_can_be():
    scores = distance_scores(np.empty((0, 3)), SAMPLES, BINS, 0.1)
    assert scores == (0, 0, 0, pytest.approx(0.1 * np.sqrt(20**2 + 20**2 + 10**2)))


def test_where_nothing_is_reachable_nothing_is_scored():
    f, precision, recall, chamfer = distance_scores(SAMPLES, np.empty((0, 3)), BINS, 0.1)
    assert precision == 1
    assert np.isnan([f, recall, chamfer]).all()
    assert np.isnan(SampleVoxels.from_points(np.empty((0, 3)), GRID).coverage(OccupancyMap(GRID)))


@pytest.mark.parametrize("tau", [0.0, -1.0, np.nan, np.inf])
def test_tau_must_be_a_distance(tau):
    with pytest.raises(ValueError, match="tau must be finite"):
        distance_scores(SAMPLES, SAMPLES, BINS, tau)


def test_points_of_a_map_are_the_means_of_its_occupied_voxels():
    points = SAMPLES[:30] + np.array([0.03, -0.02, 0.04])
    np.testing.assert_allclose(
        np.sort(surface_gaussians(map_of(points))[0], axis=0), np.sort(points, axis=0), atol=1e-12
    )
    assert len(surface_gaussians(map_of(points, level=-2000))[0]) == 0
    assert len(surface_gaussians(map_of(points, level=0))[0]) == 0


def test_a_voxel_covers_samples_up_to_one_voxel_away():
    cells = SampleVoxels.from_points(SAMPLES, GRID)
    middle, up = np.array([[1.05, 1.05, 0.0]]), np.array([0, 0, 0.1])
    assert cells.coverage(map_of(middle)) == 9 / 400
    assert cells.coverage(map_of(middle + up)) == 9 / 400
    assert cells.coverage(map_of(middle + 2 * up)) == 0
    assert cells.coverage(map_of(np.array([[0.01, 0.01, 0.0]]))) == 4 / 400
    assert cells.coverage(map_of(SAMPLES)) == 1
    assert cells.coverage(map_of(SAMPLES, level=0)) == 0


def test_coverage_agrees_with_a_check_of_every_voxel():
    rng = np.random.default_rng(2)
    grid = VoxelGrid((7, 5, 6), 0.2, (-1, 0, -0.5))
    low, size = np.array(grid.origin), np.array(grid.shape) * grid.resolution
    for fraction in (0.0, 0.01, 0.1):
        map_ = OccupancyMap(grid)
        occupied = rng.random(grid.n_cells) < fraction
        map_.mark_occupied(np.flatnonzero(occupied))
        map_.mark_free(np.flatnonzero(~occupied & (rng.random(grid.n_cells) < 0.5)))
        points = low + rng.random((200, 3)) * size
        found = SampleVoxels.from_points(points, grid).coverage(map_)
        assert found == plain.covered_mask(map_, points).mean()
        assert SampleVoxels.from_points(rng.permutation(points), grid).coverage(map_) == found


def test_samples_belong_to_the_grid_of_the_map():
    edge = np.array([[2.0, 2.0, 0.45]])  # the grid's upper corner
    assert SampleVoxels.from_points(edge, GRID).coverage(map_of(edge - 0.01)) == 1
    with pytest.raises(ValueError, match="must lie inside"):
        SampleVoxels.from_points(edge + 0.2, GRID)
    with pytest.raises(ValueError, match="the map in"):
        SampleVoxels.from_points(edge, GRID).coverage(OccupancyMap(VoxelGrid((20, 20, 10), 0.1)))


def test_voxels_known_from_the_start_are_not_scored():
    known, sampled = np.array([1, 0, 0], bool), np.array([1, 1, 0], bool)
    np.testing.assert_array_equal(observed_mask(sampled, known), [False, True, False])
    with pytest.raises(ValueError, match="voxels that are not in sampled"):
        observed_mask(known, sampled)
    with pytest.raises(ValueError, match="one shape"):
        observed_mask(known, sampled[:2])
