import math
from dataclasses import replace

import numpy as np
import pytest
from plain import fiducials as plain
from scipy.spatial.transform import Rotation

from coopmap_env.geometry import Pose
from coopmap_env.localization.correction.fiducials import (
    Fiducials,
    FiducialSettings,
    select_fiducials,
)
from coopmap_env.mapping import OccupancyMap, VoxelGrid, to_log_odds_fixed
from coopmap_env.sensing import DepthCamera

GRID = VoxelGrid((40, 20, 20), 0.1, (-0.05, -1.05, -1.05))
"""Voxel (i, 10, 10) stands around (i / 10, 0, 0)."""
CAMERA = DepthCamera(near=0.2, far=6.0)
AHEAD = Pose(np.array([0.0, 0.0, 0.0]), np.eye(3))
SETTINGS = FiducialSettings(max_radius=0.8, min_rise=0.01, occlusion_tolerance=0.0, min_spacing=0.0)


def free_map():
    map_ = OccupancyMap(GRID)
    map_.mark_free(np.arange(GRID.n_cells))
    return map_


def put(map_, index, probability=0.95, offset=(0.0, 0.0, 0.0), sigma=0.02):
    """A surface point `offset` from the middle of a voxel, or none with sigma infinite."""
    cell = int(GRID.flat_index(index))
    map_.log_odds_fixed[cell], map_.sampled_mask[cell] = to_log_odds_fixed(probability), 1
    P = np.eye(3) / sigma**2
    (row,), sums = map_.surface_rows([cell]), map_.surface_sums
    sums.precision[row], sums.information_vector[row] = P, P @ offset
    return cell


def test_a_lone_voxel_is_a_peak_at_its_surface_point():
    map_ = free_map()
    cell = put(map_, (20, 10, 10), offset=(0.01, -0.02, 0.03), sigma=0.05)
    fiducials = select_fiducials(map_, AHEAD, CAMERA, SETTINGS)
    assert fiducials.cells.tolist() == [cell]
    np.testing.assert_allclose(fiducials.positions, [[2.01, -0.02, 0.03]], atol=1e-12)
    np.testing.assert_allclose(fiducials.covariances, [np.eye(3) * 0.05**2], atol=1e-12)
    np.testing.assert_allclose(fiducials.peaks, 0.95, atol=1e-4)


def test_the_ball_ends_at_the_nearest_voxel_that_increases_again():
    map_ = free_map()
    cell = put(map_, (20, 10, 10))
    put(map_, (25, 10, 10), 0.7)
    put(map_, (20, 13, 14), 0.6)
    put(map_, (20, 10, 16), 0.9)
    fiducials = select_fiducials(map_, AHEAD, CAMERA, SETTINGS)
    assert fiducials.cells[0] == cell
    # (0, 3, 4) and (5, 0, 0) are 5 voxels off, (0, 0, 6) is further
    assert fiducials.radii[0] == pytest.approx(0.5)


def test_a_ball_may_fall_off_slowly():
    map_ = free_map()
    put(map_, (20, 10, 10), 0.95)
    for i, p in ((21, 0.9), (22, 0.8), (23, 0.7), (24, 0.75)):
        put(map_, (i, 10, 10), p)
    fiducials = select_fiducials(map_, AHEAD, CAMERA, SETTINGS)
    assert fiducials.radii.tolist() == pytest.approx([0.4])


def test_smaller_rises_than_the_least_do_not_end_a_ball():
    map_ = free_map()
    put(map_, (20, 10, 10))
    put(map_, (25, 10, 10), 0.3)
    settings = replace(SETTINGS, min_rise=0.31)
    assert select_fiducials(map_, AHEAD, CAMERA, settings).radii.tolist() == pytest.approx([0.8])


def test_a_ball_ends_where_free_space_ends_and_unknown_begins():
    map_ = free_map()
    put(map_, (20, 10, 10))
    unknown = np.zeros(GRID.shape, dtype=bool)
    unknown[23:] = True
    map_.log_odds_fixed[unknown.ravel()] = map_.sampled_mask[unknown.ravel()] = 0
    assert select_fiducials(map_, AHEAD, CAMERA, SETTINGS).radii.tolist() == pytest.approx([0.3])


def test_a_ball_ends_at_the_border_of_the_map():
    map_ = free_map()
    put(map_, (30, 16, 10))
    assert select_fiducials(map_, AHEAD, CAMERA, SETTINGS).radii.tolist() == pytest.approx([0.4])


def test_the_score_is_radius_times_peak_over_distance():
    map_ = free_map()
    near, far = put(map_, (10, 10, 10), 0.95), put(map_, (30, 14, 10), 0.99)
    put(map_, (10, 10, 12), 0.5)
    fiducials = select_fiducials(map_, AHEAD, CAMERA, SETTINGS)
    # 0.6 m to the border of the map against 0.2 m to the next voxel
    assert fiducials.cells.tolist() == [far, near]
    expected = [0.6 * 0.99 / math.hypot(3.0, 0.4), 0.2 * 0.95 / 1.0]
    np.testing.assert_allclose(fiducials.scores, expected, rtol=1e-4)


def test_of_a_plateau_the_best_known_voxel_is_the_peak_and_then_the_first():
    map_ = free_map()
    cells = [put(map_, (20, j, 10), sigma=s) for j, s in ((9, 0.03), (10, 0.02), (11, 0.03))]
    assert select_fiducials(map_, AHEAD, CAMERA, SETTINGS).cells.tolist() == [cells[1]]
    for j in (9, 10, 11):
        put(map_, (20, j, 10), sigma=0.02)
    assert select_fiducials(map_, AHEAD, CAMERA, SETTINGS).cells.tolist() == [cells[0]]


def test_a_voxel_without_a_surface_point_is_no_peak_but_may_overtop_one():
    map_ = free_map()
    put(map_, (20, 10, 10), 0.95)
    map_.mark_occupied([GRID.flat_index((21, 11, 11))])
    assert len(select_fiducials(map_, AHEAD, CAMERA, SETTINGS)) == 0


def test_voxels_below_the_least_peak_are_left_out():
    map_ = free_map()
    put(map_, (20, 10, 10), 0.85)
    assert len(select_fiducials(map_, AHEAD, CAMERA, SETTINGS)) == 0
    assert (
        len(select_fiducials(map_, AHEAD, CAMERA, replace(SETTINGS, min_peak_probability=0.8))) == 1
    )


def test_the_best_are_chosen_and_spaced_apart():
    map_ = free_map()
    best = put(map_, (15, 10, 10))
    second = put(map_, (18, 10, 13))
    third = put(map_, (25, 6, 10))
    settings = replace(SETTINGS, min_rise=0.99)
    assert select_fiducials(map_, AHEAD, CAMERA, settings).cells.tolist() == [best, second, third]
    apart = replace(settings, min_spacing=0.5)
    assert select_fiducials(map_, AHEAD, CAMERA, apart).cells.tolist() == [best, third]
    one = replace(settings, max_fiducials=1)
    assert select_fiducials(map_, AHEAD, CAMERA, one).cells.tolist() == [best]


def test_what_is_hidden_behind_an_occupied_voxel_is_not_chosen():
    map_ = free_map()
    cell = put(map_, (20, 10, 10))
    assert select_fiducials(map_, AHEAD, CAMERA, SETTINGS).cells.tolist() == [cell]
    map_.mark_occupied([GRID.flat_index((15, 10, 10))])
    assert len(select_fiducials(map_, AHEAD, CAMERA, SETTINGS)) == 0
    slack = replace(SETTINGS, occlusion_tolerance=0.6)
    assert select_fiducials(map_, AHEAD, CAMERA, slack).cells.tolist() == [cell]


def test_those_out_of_range_or_of_the_field_of_view_less_its_border_are_not_chosen():
    map_ = free_map()
    # the left edge of the view passes 20 tan(30 deg) = 11.5 voxels beside the axis, less a tenth
    put(map_, (15, 18, 10))
    assert len(select_fiducials(map_, AHEAD, CAMERA, SETTINGS)) == 0
    assert len(select_fiducials(map_, AHEAD, CAMERA, replace(SETTINGS, border_fraction=0.0))) == 1
    assert (
        len(
            select_fiducials(
                map_, AHEAD, CAMERA, replace(SETTINGS, border_fraction=0.0, max_distance=1.6)
            )
        )
        == 0
    )
    assert (
        len(
            select_fiducials(
                map_, AHEAD, replace(CAMERA, near=1.8), replace(SETTINGS, border_fraction=0.0)
            )
        )
        == 0
    )


def test_a_kept_one_stays_until_it_leaves_the_view():
    map_ = free_map()
    far, near = put(map_, (30, 10, 10)), put(map_, (12, 6, 10))
    one = replace(SETTINGS, max_fiducials=1)
    turned = Pose(AHEAD.translation, Rotation.from_euler("z", 25, degrees=True).as_matrix())
    away = Pose(AHEAD.translation, Rotation.from_euler("z", -40, degrees=True).as_matrix())
    kept = select_fiducials(map_, turned, CAMERA, one)
    assert kept.cells.tolist() == [far]
    assert select_fiducials(map_, AHEAD, CAMERA, one).cells.tolist() == [near]
    assert select_fiducials(map_, AHEAD, CAMERA, one, kept).cells.tolist() == [far]
    both = select_fiducials(map_, AHEAD, CAMERA, SETTINGS, kept)
    assert both.cells.tolist() == [far, near]
    assert select_fiducials(map_, away, CAMERA, SETTINGS, both).cells.tolist() == [near]


def test_a_kept_one_stays_while_no_neighbour_is_more_likely():
    map_ = free_map()
    cell = put(map_, (20, 10, 10))
    kept = select_fiducials(map_, AHEAD, CAMERA, SETTINGS)
    better_known = put(map_, (20, 11, 10), sigma=0.01)
    assert select_fiducials(map_, AHEAD, CAMERA, SETTINGS).cells.tolist() == [better_known]
    spaced = replace(SETTINGS, min_spacing=0.3)
    assert select_fiducials(map_, AHEAD, CAMERA, spaced, kept).cells.tolist() == [cell]
    put(map_, (20, 11, 10), 0.97)
    assert select_fiducials(map_, AHEAD, CAMERA, spaced, kept).cells.tolist() == [better_known]


def random_map(rng, density):
    grid = VoxelGrid((16, 15, 9), 0.1, (-0.8, -0.7, -0.2))
    map_ = OccupancyMap(grid)
    n, clamp = grid.n_cells, map_.log_odds_range.clamp
    map_.log_odds_fixed[:] = rng.choice([-clamp, -3000, 0], n)
    map_.sampled_mask[:] = map_.log_odds_fixed != 0
    hit = np.flatnonzero(rng.random(n) < density)
    map_.log_odds_fixed[hit] = rng.choice([500, 3000, 5000, clamp, clamp, clamp], len(hit))
    map_.sampled_mask[hit] = 1
    hit = hit[rng.random(len(hit)) < 0.8]
    A = rng.normal(size=(len(hit), 3, 3))
    rows = map_.surface_rows(hit)
    sums = map_.surface_sums
    sums.precision[rows] = (A @ A.transpose(0, 2, 1) + np.eye(3)) * 500
    offsets = rng.uniform(-0.04, 0.04, (len(hit), 3))
    sums.information_vector[rows] = np.einsum("nij,nj->ni", sums.precision[rows], offsets)
    return map_


def random_pose(rng):
    return Pose(
        rng.uniform((-0.7, -0.6, -0.1), (0.7, 0.7, 0.6)), Rotation.random(rng=rng).as_matrix()
    )


@pytest.mark.parametrize("density", [0.05, 0.15, 0.4])
def test_fiducials_equal_those_of_the_plain_reference(density):
    rng = np.random.default_rng(int(100 * density))
    camera = DepthCamera(math.radians(80), math.radians(60), near=0.1, far=1.3)
    seen = 0
    for slack in (0.0, 0.3):
        map_ = random_map(rng, density)
        settings = FiducialSettings(
            max_fiducials=6,
            max_radius=0.35,
            min_spacing=0.2,
            max_distance=1.2,
            occlusion_tolerance=slack,
        )
        kept = None
        pose = random_pose(rng)
        for _ in range(7):
            fiducials = select_fiducials(map_, pose, camera, settings, kept)
            before = [] if kept is None else kept.cells.tolist()
            expected = plain.select_fiducials(map_, pose, camera, settings, before)
            assert fiducials.cells.tolist() == [e[0] for e in expected]
            if expected:
                np.testing.assert_allclose(fiducials.positions, [e[1] for e in expected], atol=1e-9)
                np.testing.assert_allclose(fiducials.radii, [e[2] for e in expected], atol=1e-9)
                np.testing.assert_allclose(fiducials.scores, [e[3] for e in expected], rtol=1e-9)
            seen += len(expected)
            kept, turn = fiducials, Rotation.from_rotvec(rng.normal(0, 0.3, 3)).as_matrix()
            pose = (
                Pose(pose.translation, turn @ pose.rotation) if len(fiducials) else random_pose(rng)
            )
    assert seen > 8


def test_covariances_are_those_of_the_map():
    map_ = random_map(np.random.default_rng(3), 0.03)
    pose = Pose(np.array([-0.7, 0.0, 0.2]), np.eye(3))
    fiducials = select_fiducials(map_, pose, replace(CAMERA, near=0.0))
    cells, means, covariances = map_.surfaces()
    rows = np.searchsorted(cells, fiducials.cells)
    assert len(rows) > 3
    np.testing.assert_allclose(fiducials.covariances, covariances[rows], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(fiducials.positions, means[rows], atol=1e-12)


def test_the_choice_is_the_same_each_time():
    map_ = random_map(np.random.default_rng(4), 0.03)
    pose = Pose(np.array([-0.7, 0.0, 0.2]), np.eye(3))
    one, other = select_fiducials(map_, pose, CAMERA), select_fiducials(map_.copy(), pose, CAMERA)
    assert len(one) > 0
    for name in ("cells", "positions", "covariances", "radii", "peaks", "scores"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def test_a_camera_outside_the_map_sees_none():
    map_ = free_map()
    put(map_, (20, 10, 10))
    kept = select_fiducials(map_, AHEAD, CAMERA, SETTINGS)
    outside = Pose(np.array([-0.5, 0.0, 0.0]), np.eye(3))
    assert len(select_fiducials(map_, outside, CAMERA, SETTINGS, kept)) == 0


def test_planar_maps_and_foreign_fiducials_are_rejected():
    with pytest.raises(ValueError, match="in space"):
        select_fiducials(OccupancyMap(VoxelGrid((5, 5))), AHEAD, CAMERA)
    with pytest.raises(ValueError, match="in space"):
        select_fiducials(free_map(), Pose.planar(0, 0, 0), CAMERA)
    one = np.ones(1)
    foreign = Fiducials(
        np.array([GRID.n_cells]), np.ones((1, 3)), np.ones((1, 3, 3)), one, one, one
    )
    with pytest.raises(ValueError, match=f"{GRID.n_cells}"):
        select_fiducials(free_map(), AHEAD, CAMERA, previous=foreign)
    with pytest.raises(ValueError, match="shapes"):
        Fiducials(np.array([1]), np.ones((2, 3)), np.ones((1, 3, 3)), one, one, one)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("max_fiducials", 0), ("max_fiducials", 1.5), ("min_peak_probability", 0.5),
        ("min_peak_probability", 1.0),
        ("min_rise", -0.1), ("border_fraction", 1.0), ("max_radius", 0.0),
        ("max_distance", math.inf),
        ("min_spacing", -1.0), ("occlusion_tolerance", math.nan),
    ],
)  # fmt: skip
def test_settings_name_the_value_that_is_out_of_range(name, value):
    with pytest.raises(ValueError, match=rf"{name}.*{value}"):
        FiducialSettings(**{name: value})
