"""Registration of the worksite's panel, and its rejection where it is not in view."""

import dataclasses

import numpy as np
import pytest
from plain.triangle_camera import box, look_at_pose, render_scan

from coopmap_env.geometry import Pose, apply_displacement, displacement_between, rotation_about_z
from coopmap_env.localization.registration.acceptance import AcceptanceSettings
from coopmap_env.localization.registration.alignment import (
    AlignmentSettings,
    align,
    nearest_upright,
)
from coopmap_env.localization.registration.icp import SmallGicp
from coopmap_env.localization.registration.register import (
    RegistrationSettings,
    View,
    register,
)
from coopmap_env.localization.registration.views import ViewBatch
from coopmap_env.localization.target import TargetModel
from coopmap_env.robots import PoseEstimate
from coopmap_env.sensing import DepthCamera, PointCloud, RangeNoise
from coopmap_env.simulation.scenes.field import target_solids

CAMERA, NOISE = DepthCamera(), RangeNoise()
GROUND = box((40, 40, 1), (0, 0, -0.5))
CLUTTER = np.concatenate(
    [
        box((0.7, 0.5, 0.6), (1.9, 1.4, 0.3), 0.5),
        box((0.4, 0.8, 0.4), (-2.0, 0.9, 0.2), 1.2),
        box((0.6, 0.6, 0.8), (-1.3, -2.2, 0.4), 0.2),
    ]
)
STD = np.array([0.008, 0.008, 0.004, 0.006, 0.006, 0.006])
"""Metres and radians by which encoders mistake the camera's pose."""


@pytest.fixture(scope="module")
def panel():
    return TargetModel(target_solids()[0].triangles)


def standing(x, y, yaw):
    return Pose(np.array([x, y, 0.0]), rotation_about_z(np.radians(yaw)))


def views_at(triangles, T_target_base, targets, seed=0, std=STD):
    """Views from a mast at points (k, 3) of the target's frame; the camera's poses err."""
    rng = np.random.default_rng(seed)
    views = []
    for at in targets:
        eye = np.array([0.3, 0.1, 1.6]) + 0.3 * rng.uniform(-1, 1, 3)
        estimated = look_at_pose(eye, T_target_base.inverse().transform(at))
        true = apply_displacement(estimated, std * rng.standard_normal(6))
        cloud = render_scan(triangles, T_target_base @ true, CAMERA, NOISE, rng)
        views.append(View(cloud, PoseEstimate(estimated, np.diag(np.square(std)))))
    return views


def worksite(target):
    return np.concatenate([target, GROUND, CLUTTER])


@pytest.mark.parametrize(
    ("x", "y", "yaw"), [(3.2, 0.4, 170), (-3.5, 1.0, 60), (0.5, 3.0, -90), (-1.0, -4.0, 10)]
)
def test_a_robot_that_sees_the_panel_is_located_within_5_cm_and_a_degree(panel, x, y, yaw):
    T = standing(x, y, yaw)
    views = views_at(worksite(panel.triangles), T, [(0, 0.3, 1.0), (0, -0.4, 0.9)])
    result = register(panel, views, CAMERA, NOISE)
    assert result.located, result.reason
    error = displacement_between(result.T_target_base, T)
    assert np.linalg.norm(error[:3]) < 0.05
    assert np.linalg.norm(error[3:]) < np.radians(1.0)
    assert len(result.equivalent_poses) == 1
    assert result.equivalent_poses[0] is result.T_target_base
    assert result.fitness.confirmed_fraction > 0.9
    assert result.fitness.contradicted_fraction < 0.02
    assert np.linalg.eigvalsh(result.covariance).min() > 0


def test_the_same_scans_give_the_same_pose_bit_for_bit(panel):
    views = views_at(worksite(panel.triangles), standing(3.2, 0.4, 170), [(0, 0.3, 1.0)])
    one, two = (register(panel, views, CAMERA, NOISE) for _ in range(2))
    assert one.located
    np.testing.assert_array_equal(one.T_target_base.translation, two.T_target_base.translation)
    np.testing.assert_array_equal(one.covariance, two.covariance)


def test_robots_on_opposite_sides_agree_on_where_each_other_is(panel):
    """A point between them, transformed by both to the target's frame, is the same within 6 cm."""
    places = standing(3.3, 0.5, 190), standing(-3.1, -0.8, 20)
    points = []
    for robot, T in enumerate(places):
        views = views_at(worksite(panel.triangles), T, [(0, 0.2, 1.0), (0, -0.5, 0.8)], robot)
        result = register(panel, views, CAMERA, NOISE)
        assert result.located, result.reason
        points.append(result.T_target_base.transform(T.inverse().transform([0.5, 1.0, 0.4])))
    np.testing.assert_allclose(points[0], points[1], atol=0.06)


def test_the_covariance_is_that_of_the_errors(panel):
    """x, y and yaw of 40 registrations: a mean of chi^2 with 3 degrees of freedom, 3 +- 1.2.

    The errors of the cameras' poses are drawn for each scan, so no part of them is common.
    """
    T = standing(3.0, -1.0, 150)
    settings = AlignmentSettings(common_error_fraction=0.0)
    squares = []
    for seed in range(40):
        views = views_at(worksite(panel.triangles), T, [(0, 0.3, 1.0), (0, -0.4, 0.9)], seed)
        found = align(panel, ViewBatch.from_views(views, CAMERA), T, NOISE, settings)
        i = [0, 1, 5]
        error = displacement_between(found.T_target_base, T)[i]
        squares.append(error @ np.linalg.solve(found.covariance[np.ix_(i, i)], error))
    assert 1.8 < np.mean(squares) < 4.2


def test_level_ground_is_no_more_assumed_if_level_is_false(panel):
    """All six are then found from the points: on a slope of 3 degrees too."""
    slope = apply_displacement(standing(3.0, -1.0, 150), [0, 0, 0.1, 0.04, -0.03, 0])
    views = views_at(
        worksite(panel.triangles), slope, [(0, 0.3, 1.0), (0, -0.4, 0.9)], std=STD / 10
    )
    batch = ViewBatch.from_views(views, CAMERA)
    start = nearest_upright(slope)
    np.testing.assert_array_equal(start.rotation[2], [0, 0, 1])
    free = align(panel, batch, start, NOISE, AlignmentSettings(level_ground=False))
    error = displacement_between(free.T_target_base, slope)
    assert np.abs(error[:3]).max() < 0.02
    assert np.abs(error[3:]).max() < 0.01
    leveled = align(panel, batch, start, NOISE, AlignmentSettings())
    assert abs(displacement_between(leveled.T_target_base, slope)[3]) > 0.02


def test_with_no_target_in_view_a_robot_is_not_located(panel):
    for triangles in (GROUND, np.concatenate([GROUND, CLUTTER])):
        views = views_at(triangles, standing(3.2, 0.4, 170), [(1.9, 1.4, 0.4), (-1, -2, 0.4)])
        result = register(panel, views, CAMERA, NOISE)
        assert not result.located
        assert result.reason
        assert result.T_target_base is None
        assert result.equivalent_poses == ()


def test_with_a_corner_in_view_a_robot_is_not_located(panel):
    """A screen leaves 0.4 m of the panel's side, which is the same wherever it slides to."""
    T = standing(3.2, 0.4, 170)
    screen = box((0.05, 3.0, 3.0), (1.7, -0.9, 1.5))
    views = views_at(np.concatenate([worksite(panel.triangles), screen]), T, [(0, 0.3, 1.0)])
    result = register(panel, views, CAMERA, NOISE)
    assert not result.located or (
        np.linalg.norm(displacement_between(result.T_target_base, T)[:3]) < 0.1
    )


@pytest.mark.parametrize("scale", [0.7, 0.85, 1.2, 1.5])
def test_a_panel_of_another_size_is_not_the_target(panel, scale):
    """Its front, its back and its side are scanned, each from its own base pose."""
    for place in (standing(3.4, 0.4, 170), standing(-3.6, 1.0, -20), standing(0.3, 3.6, -90)):
        views = views_at(
            worksite(panel.triangles * scale),
            place,
            [(0, 0.3, 1.0 * scale), (0, -0.4, 0.8 * scale)],
        )
        result = register(panel, views, CAMERA, NOISE)
        assert not result.located


def test_a_panel_without_its_junction_box_and_strut_seen_from_behind_is_no_target(panel):
    """Pixels that see through the missing parts reject the decoy."""
    plain = np.concatenate([panel.triangles[:-36]])
    views = views_at(worksite(plain), standing(-3.2, 0.6, 0), [(0, 0.4, 0.9), (0, -0.4, 0.9)])
    settings = RegistrationSettings(
        acceptance=AcceptanceSettings(max_contradicted_fraction=0.0, min_confirmed_fraction=0.0)
    )
    assert not register(panel, views, CAMERA, NOISE, settings).located


def test_a_table_that_is_symmetric_by_half_a_turn_has_two_equivalent_poses():
    legs = [box((0.08, 0.08, 0.7), (x, y, 0.35)) for x in (-0.7, 0.7) for y in (-0.4, 0.4)]
    top = box((1.6, 1.0, 0.06), (0, 0, 0.73))
    upright = box((1.0, 0.3, 0.5), (0, 0, 1.01))
    table = TargetModel(np.concatenate([*legs, top, upright]))
    T = standing(2.8, 1.2, -150)
    views = views_at(
        np.concatenate([table.triangles, GROUND]), T, [(0.2, 0, 0.8), (-0.3, 0.2, 0.8)]
    )
    result = register(table, views, CAMERA, NOISE)
    assert result.located, result.reason
    assert len(result.equivalent_poses) == 2
    assert result.equivalent_poses[0] is result.T_target_base
    errors = [np.linalg.norm(displacement_between(e, T)[:3]) for e in result.equivalent_poses]
    assert min(errors) < 0.05
    assert max(errors) > 5.0


def test_the_yaw_of_a_post_is_not_determined():
    angles = np.linspace(0, 2 * np.pi, 33)
    ring = 0.5 * np.column_stack([np.cos(angles), np.sin(angles), 0 * angles])
    low, high = ring, ring + np.array([0, 0, 1.5])
    walls = [
        t for k in range(32)
        for t in ([low[k], low[k + 1], high[k + 1]], [low[k], high[k + 1], high[k]])
    ]  # fmt: skip
    post = TargetModel(np.array(walls))
    T = standing(3.0, 0.0, 180)
    views = views_at(np.concatenate([post.triangles, GROUND]), T, [(0, 0, 0.8)])
    assert not register(post, views, CAMERA, NOISE).located


def test_views_that_contradict_each_other_are_not_joined(panel):
    """The second scan was made 0.5 m aside, which its robot does not know."""
    T = standing(3.2, 0.4, 170)
    world = worksite(panel.triangles)
    moved = apply_displacement(T, [0.0, 0.5, 0, 0, 0, 0])
    views = views_at(world, T, [(0, 0.3, 1.0)]) + views_at(world, moved, [(0, 0.3, 1.0)], 1)
    assert not register(panel, views, CAMERA, NOISE).located


def test_rays_without_a_range_locate_nobody(panel):
    n = CAMERA.n_pixels
    cloud = PointCloud(np.zeros((n, 3)), np.zeros(n, dtype=bool))
    view = View(cloud, PoseEstimate(look_at_pose((0, 0, 1.5), (1, 0, 1)), np.zeros((6, 6))))
    assert register(panel, [view], CAMERA, NOISE).reason == "nothing in view could be the target"


def test_another_refiner_takes_the_librarys_place(panel):
    calls = []

    def stay(points, surface, T_target_base, max_distance):
        calls.append((points.shape[1], surface.shape[1], max_distance))
        return T_target_base

    views = views_at(worksite(panel.triangles), standing(3.2, 0.4, 170), [(0, 0.3, 1.0)])
    assert register(panel, views, CAMERA, NOISE, refiner=stay).located
    assert set(calls) == {(3, 3, 0.12)}


def test_small_gicp_brings_a_box_back_and_leaves_alone_what_it_cannot_pair():
    surface, _ = TargetModel(box((1, 0.8, 0.6), (0, 0, 0.3))).sample_surface(3000)
    T = standing(2.0, 1.0, 30)
    points = T.inverse().transform(surface[::7])
    refine = SmallGicp()
    start = apply_displacement(T, [0.03, -0.02, 0.01, 0, 0, 0.02])
    found = refine(points, surface, start, 0.1)
    assert np.abs(displacement_between(found, T)).max() < 2e-3
    far = standing(9.0, 9.0, 0)
    assert refine(points, surface, far, 0.1) is far
    assert refine(points[:3], surface, start, 0.1) is start


@pytest.mark.parametrize(
    ("settings", "name", "value"),
    [
        (AlignmentSettings, "common_error_fraction", 1.5),
        (AlignmentSettings, "depth_margin", -0.1),
        (AcceptanceSettings, "min_confirmed_fraction", 1.2),
        (AcceptanceSettings, "max_chi2", float("inf")),
        (RegistrationSettings, "n_hypotheses", 0),
        (RegistrationSettings, "icp_max_distance", 0.0),
    ],
)
def test_settings_out_of_range_are_rejected_with_their_value(settings, name, value):
    with pytest.raises(ValueError, match=f"{name}.*{value}"):
        dataclasses.replace(settings(), **{name: value})
