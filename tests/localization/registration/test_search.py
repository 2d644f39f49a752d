import dataclasses
import itertools

import numpy as np
import pytest
from plain.triangle_camera import box, look_at_pose, render_scan

from coopmap_env.geometry import Pose, rotation_about_z
from coopmap_env.localization import SearchSettings, TargetModel, View
from coopmap_env.localization.registration._branch_and_bound import (
    Probes,
    SearchGrid,
    SearchLimits,
    best_first_search,
    count_seen_through,
    field_score,
    points_to_cells,
)
from coopmap_env.localization.registration._likelihood_field import distance_field, likelihood_field
from coopmap_env.localization.registration.search import search, voxel_centroids
from coopmap_env.localization.registration.views import Beams, ViewBatch
from coopmap_env.robots import PoseEstimate
from coopmap_env.sensing import DepthCamera, PointCloud, RangeNoise

CAMERA, NOISE = DepthCamera(), RangeNoise()


@pytest.fixture(scope="module")
def hook():
    """A box of a metre with an arm: no rotation maps it onto itself."""
    return TargetModel(
        np.concatenate([box((1.0, 0.6, 1.2), (0, 0, 0.6)), box((0.4, 1.2, 0.3), (0.3, 0.9, 0.9))])
    )


def view_of(triangles, T_target_base, eye, at, seed=0):
    """A scan from an eye towards a point of the base frame, with the estimated camera pose."""
    pose = look_at_pose(eye, at)
    cloud = render_scan(triangles, T_target_base @ pose, CAMERA, NOISE, np.random.default_rng(seed))
    return View(cloud, PoseEstimate(pose, 1e-8 * np.eye(6)))


def test_by_hand_the_field_is_255_on_the_surface_and_falls_off_as_a_gaussian(hook):
    field = likelihood_field(hook, 0.1, 0.08, 0)
    at = np.floor(([-0.5, 0.0, 0.6] - field.origin) / field.cell).astype(int)
    assert field.pooled[0][tuple(at)] == 255
    # two cells further out: 0.1 m
    assert field.pooled[0][at[0] - 2, at[1], at[2]] == round(255 * np.exp(-0.5 * (0.1 / 0.08) ** 2))


def test_pooled_fields_hold_the_largest_value_of_all_their_steps(hook):
    levels = likelihood_field(hook, 0.1, 0.08, 2).pooled
    base = np.pad(levels[0], ((0, 6), (0, 6), (0, 0)))
    nx, ny, _ = levels[0].shape
    for level in (1, 2):
        shifts = range(0, 2 << level, 2)
        plain = np.max([base[i : i + nx, j : j + ny] for i in shifts for j in shifts], axis=0)
        np.testing.assert_array_equal(levels[level], plain)


def test_distances_are_those_to_the_surface_within_a_cell(hook):
    distances, origin, _ = distance_field(hook, 0.05, 0.2)
    at = np.floor(([-0.65, 0.0, 0.6] - origin) / 0.05).astype(int)
    assert distances[tuple(at)] == pytest.approx(0.15, abs=0.05)


def test_a_voxel_with_many_points_has_one_vote_and_the_ground_none():
    points = np.array([[1, 1, 0.52], [1.02, 1, 0.54], [1, 1, 0.05], [2, 1, 0.5], [2, 1, 3.0]])
    np.testing.assert_allclose(
        sorted(voxel_centroids(points, ground_height=0.15, top=1.0, voxel_size=0.1).tolist()),
        [[1.01, 1, 0.53], [2, 1, 0.5]],
    )


def test_a_ray_that_passes_a_probe_sees_through_it_and_one_that_stops_before_does_not():
    """A camera at the origin looks along x at a wall 4 m away; probes are at 3 m and 5 m."""
    n, probes = CAMERA.n_pixels, np.array([[3.0, 0, 0], [5.0, 0, 0], [-3.0, 0, 0]])
    beams = Beams(
        np.full((1, n), 4.0), np.eye(3)[None], np.zeros((1, 3)), CAMERA.intrinsics, margin=0.2
    )
    assert count_seen_through(probes, 0.0, 0.0, 0.0, beams, 9.0) == 1
    # turned by half: the probe behind is now in front
    assert count_seen_through(probes, 0.0, 0.0, np.pi, beams, 9.0) == 1
    assert count_seen_through(probes, 0.0, 0.0, 0.0, beams._replace(margin=1.2), 9.0) == 0


def test_best_first_finds_what_trying_all_leaves_finds(hook):
    T = Pose(np.array([3.1, -0.8, 0.0]), rotation_about_z(2.6))
    views = [view_of(hook.triangles, T, (0.3, 0.2, 1.5), T.inverse().transform([0, 0, 0.6]))]
    batch = ViewBatch.from_views(views, CAMERA)
    points = voxel_centroids(batch.points_in_base(), 0.15, hook.bounds[1, 2], 0.1)
    step, n_steps, corner = 0.2, 40, hook.center_xy - 4.0
    yaws = np.arange(24) * np.radians(15.0)
    grid = SearchGrid(n_steps, corner, step, yaws, hook.center_xy, 2.0, 4.0)
    field = likelihood_field(hook, step, 0.15, 3)
    cells = points_to_cells(points, grid, field.finest)
    probes, beams = Probes(hook.sample_surface(100)[0], 0.5), batch.beams(0.3)
    limits = SearchLimits((0.3, 0.2), 5.0, 0.0, 1, 10**6)
    found, scores = best_first_search(cells, field.pooled, grid, probes, beams, limits)
    plain = {}
    for a, i, j in itertools.product(range(24), range(n_steps), range(n_steps)):
        x, y = corner + step * np.array([i, j])
        if 2.0 <= np.hypot(*(np.array([x, y]) - hook.center_xy)) <= 4.0:
            score = field_score(cells[a], field.pooled[0], i, j)
            if score > 5.0:
                score -= 0.5 * count_seen_through(probes.points, x, y, yaws[a], beams, 1e9)
            plain[x, y, yaws[a]] = score
    best = max(plain, key=plain.get)
    np.testing.assert_allclose(scores, [plain[best]])
    np.testing.assert_allclose(found, [best])


@pytest.mark.parametrize("seed", range(3))
def test_the_pose_is_among_the_hypotheses_within_a_step(hook, seed):
    rng = np.random.default_rng(seed)
    angle, far = rng.uniform(-np.pi, np.pi), rng.uniform(2.5, 4.5)
    T = Pose(
        far * np.array([np.cos(angle), np.sin(angle), 0.0]), rotation_about_z(rng.uniform(-3, 3))
    )
    clutter = box((0.8, 0.7, 0.6), (1.5, -1.6, 0.3), 0.4)
    world = np.concatenate([hook.triangles, clutter, box((20, 20, 1), (0, 0, -0.5))])
    at = T.inverse().transform([0, 0.3, 0.6])
    batch = ViewBatch.from_views([view_of(world, T, (0.2, 0, 1.6), at, seed)], CAMERA)
    errors = [
        max(np.abs(h.T_target_base.translation - T.translation).max(),
            np.abs(h.T_target_base.rotation - T.rotation).max())
        for h in search(hook, batch, SearchSettings())
    ]  # fmt: skip
    assert min(errors) < 0.1


def test_without_points_above_the_ground_there_is_no_hypothesis(hook):
    T = Pose(np.array([3.0, 0.0, 0.0]), np.eye(3))
    views = [view_of(box((20, 20, 1), (0, 0, -0.5)), T, (0, 0, 1.5), (2, 0, 0))]
    assert search(hook, ViewBatch.from_views(views, CAMERA), SearchSettings()) == []


@pytest.mark.parametrize(
    ("name", "value"), [("xy_step", 0.0), ("max_hypotheses", 0), ("field_sigma", float("nan"))]
)
def test_settings_out_of_range_are_rejected_with_their_value(name, value):
    with pytest.raises(ValueError, match=f"{name}.*{value}"):
        dataclasses.replace(SearchSettings(), **{name: value})


def test_an_empty_ring_is_rejected():
    with pytest.raises(ValueError, match=r"min_distance < max_distance, got 3\.0 and 2\.0"):
        SearchSettings(min_distance=3.0, max_distance=2.0)


def test_views_need_a_point_for_each_pixel():
    cloud = PointCloud(np.zeros((3, 3)), np.zeros(3, dtype=bool))
    estimate = PoseEstimate(Pose(np.zeros(3), np.eye(3)), np.zeros((6, 6)))
    with pytest.raises(ValueError, match="3072 pixels, got 3"):
        ViewBatch.from_views([View(cloud, estimate)], CAMERA)
    with pytest.raises(ValueError, match="at least one view"):
        ViewBatch.from_views([], CAMERA)
