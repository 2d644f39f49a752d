"""Choice of the team's frame with a symmetric target."""

import dataclasses

import numpy as np
import pytest
from plain.triangle_camera import box, look_at_pose, render_scan

from coopmap_env.geometry import Pose, rotation_about_z
from coopmap_env.localization import LocalizationFailure
from coopmap_env.localization.registration.register import Registration
from coopmap_env.localization.registration.symmetry import (
    GROUND_HEIGHT,
    MAX_LOG_ODDS,
    MIN_VOXELS,
    TARGET_PADDING,
    in_equivalent_frame,
    mean_log_odds,
    resolve_symmetry,
)
from coopmap_env.localization.registration.views import View
from coopmap_env.localization.target import TargetModel
from coopmap_env.mapping import BeamModel, OccupancyMap, VoxelGrid
from coopmap_env.robots import PoseEstimate
from coopmap_env.sensing import DepthCamera, RangeNoise, transform_cloud

CAMERA, NOISE = DepthCamera(width=48, height=36), RangeNoise()
GRID = VoxelGrid((100, 100, 30), 0.1, (-5.0, -5.0, -0.35))
TARGET = box((1.6, 0.6, 1.0), (0, 0, 0.5))
"""Maps onto itself by half a turn."""
TALL, WIDE = box((0.4, 0.4, 1.4), (1.2, 1.6, 0.7)), box((0.8, 0.6, 0.5), (-1.3, -1.5, 0.25), 0.4)
"""Two things that stand about opposite to each other, but look different."""
FLOOR = box((20, 20, 1), (0, 0, -0.5))
HALF = Pose(np.zeros(3), rotation_about_z(np.pi))
TRUE = Pose(np.array([0.3, -3.0, 0.0]), rotation_about_z(1.4))
"""T_target_base of the robot that is to be located."""
EYES = [(3.0, 0.5, 1.6), (0.5, 3.3, 1.5), (-3.0, 0.4, 1.7), (0.3, -3.2, 1.5), (2.2, -2.2, 1.6)]
COVARIANCE = np.diag([0.01, 0.02, 0.003, 0.002, 0.004, 0.005]) ** 2


@pytest.fixture(scope="module")
def model():
    return TargetModel(TARGET)


def team_map(*things):
    """The map of a robot that has scanned from all around."""
    map_ = OccupancyMap(GRID, BeamModel(0.02, 0.998, "partial"))
    triangles, rng = np.concatenate([TARGET, FLOOR, *things]), np.random.default_rng(0)
    for eye in EYES:
        for at in ((0, 0, 0.5), (1.2, 1.6, 0.5), (-1.3, -1.5, 0.3)):
            pose = look_at_pose(eye, at)
            map_.integrate(
                transform_cloud(render_scan(triangles, pose, CAMERA, NOISE, rng), pose, NOISE)
            )
    return map_


def views_of(*things, towards=((0, 0, 0.5), (1.2, 1.6, 0.5), (-1.3, -1.5, 0.3)), seed=1):
    """What the other robot sees, by the poses that its encoders measure."""
    triangles, rng = np.concatenate([TARGET, FLOOR, *things]), np.random.default_rng(seed)
    views = []
    for at in towards:
        pose = look_at_pose(TRUE.transform([0.2, 0.1, 1.6]), at)
        cloud = render_scan(triangles, pose, CAMERA, NOISE, rng)
        views.append(View(cloud, PoseEstimate(TRUE.inverse() @ pose, 1e-5 * np.eye(6))))
    return views


def found(first=TRUE):
    """As by the target alone: one of its two frames; the other one fits alike."""
    return Registration(
        LocalizationFailure.NONE, "", first, COVARIANCE, None, (first, HALF @ first)
    )


@pytest.fixture(scope="module")
def mapped():
    return team_map(TALL, WIDE)


@pytest.mark.parametrize("first", [TRUE, HALF @ TRUE], ids=["right", "wrong"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_scene_around_the_target_determines_the_frame(mapped, model, first, seed):
    agreed = resolve_symmetry(mapped, found(first), views_of(TALL, WIDE, seed=seed), model)
    assert agreed.located
    assert agreed.reason == ""
    np.testing.assert_allclose(agreed.T_target_base.translation, TRUE.translation, atol=1e-12)
    np.testing.assert_allclose(agreed.T_target_base.rotation, TRUE.rotation, atol=1e-12)


def test_with_nothing_but_the_target_seen_it_is_not_located(mapped, model):
    views = views_of(towards=[(0, 0, 0.5)])
    agreed = resolve_symmetry(mapped, found(), views, model)
    assert not agreed.located
    assert agreed.T_target_base is None
    assert agreed.covariance is None
    assert agreed.failure is LocalizationFailure.SYMMETRIC
    assert "target has 2 equivalent poses" in agreed.reason
    assert "(0 voxels, 0.00 nats)" in agreed.reason
    assert len(agreed.equivalent_poses) == 2


def test_with_nothing_but_the_target_mapped_it_is_not_located(model):
    """What the robot sees besides is free or unknown to the team in one frame as in the other."""
    agreed = resolve_symmetry(team_map(), found(), views_of(TALL, WIDE), model)
    assert not agreed.located
    assert "does not distinguish them" in agreed.reason


def test_a_thing_of_a_few_voxels_does_not_decide(model):
    """A thin post fits in one frame and not in the other, but a few wrong voxels could do that."""
    post = box((0.1, 0.1, 0.6), (1.2, 1.6, 0.3))
    agreed = resolve_symmetry(team_map(post), found(), views_of(post), model)
    assert not agreed.located
    voxels, nats = agreed.reason.split("(")[1].rstrip(")").split(", ")
    assert 0 < int(voxels.split()[0]) < MIN_VOXELS
    assert float(nats.split()[0]) > 0.5


def test_a_scene_that_is_symmetric_itself_does_not_decide(model):
    other = HALF.transform(TALL)
    agreed = resolve_symmetry(team_map(TALL, other), found(), views_of(TALL, other), model)
    assert not agreed.located
    voxels, nats = agreed.reason.split("(")[1].rstrip(")").split(", ")
    assert int(voxels.split()[0]) >= MIN_VOXELS
    assert float(nats.split()[0]) < 0.5


def test_by_hand_the_covariance_turns_with_the_frame():
    """By half a turn nothing changes, by a quarter x becomes y."""
    same = in_equivalent_frame(found(), HALF @ TRUE)
    np.testing.assert_allclose(same.covariance, COVARIANCE, atol=1e-18)
    quarter = Pose(np.array([0.5, 0, 0]), rotation_about_z(np.pi / 2)) @ TRUE
    turned = in_equivalent_frame(found(), quarter)
    assert turned.located
    assert turned.T_target_base is quarter
    wanted = np.diag(COVARIANCE)[[1, 0, 2, 4, 3, 5]]
    np.testing.assert_allclose(turned.covariance, np.diag(wanted), atol=1e-18)


def test_the_covariance_is_that_of_turned_displacements():
    rng = np.random.default_rng(4)
    C = np.cov(rng.normal(size=(6, 20)))
    drawn = rng.multivariate_normal(np.zeros(6), C, 1000)
    C = np.cov(drawn.T)
    R = rotation_about_z(0.7)
    turned = in_equivalent_frame(
        dataclasses.replace(found(), covariance=C), Pose(np.zeros(3), R) @ TRUE
    ).covariance
    moved = np.hstack([drawn[:, :3] @ R.T, drawn[:, 3:] @ R.T])
    np.testing.assert_allclose(turned, np.cov(moved.T), atol=1e-12)  # of a thousand sums


def test_a_robot_that_is_not_located_has_no_frame():
    with pytest.raises(ValueError, match="robot is not located: too far"):
        in_equivalent_frame(Registration(LocalizationFailure.OUTSIDE_MAP, "too far"), TRUE)


def test_by_hand_the_support_of_points_is_the_mean_of_their_voxels_nats(model):
    """Of known voxels, each once; the target's surroundings and the ground are left out."""
    map_ = team_map(TALL)
    sure, free = np.array([1.2, 1.41, 0.75]), np.array([0.5, 3.0, 1.45])
    levels = []
    for point in (sure, free):
        cell = map_.grid.flat_index(map_.grid.index(point[None]))[0]
        assert map_.sampled_mask[cell]
        levels.append(float(np.clip(map_.log_odds.ravel()[cell], -MAX_LOG_ODDS, MAX_LOG_ODDS)))
    assert levels[0] == MAX_LOG_ODDS  # seen from several sides
    assert levels[1] < 0
    value, count = mean_log_odds(map_, np.array([sure, sure + 0.01, free]), model)
    assert count == 2
    assert value == pytest.approx(np.mean(levels), abs=1e-12)
    left_out = np.array(
        [
            [0.8 + TARGET_PADDING - 0.01, 0, 0.5],  # by the target
            [2.0, 2.0, GROUND_HEIGHT - 0.01],  # on the ground
            [1.2, 1.6, 0.5],  # inside of a thing: never seen
            [30.0, 0, 1],  # out of the map
        ]
    )
    assert mean_log_odds(map_, left_out, model) == (0.0, 0)
    assert mean_log_odds(map_, np.vstack([left_out, sure]), model) == (MAX_LOG_ODDS, 1)
