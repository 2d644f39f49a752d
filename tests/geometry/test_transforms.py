"""Rigid transforms, wrapped angles and planar frames."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from coopmap_env.geometry import Pose, to_camera_frame, to_world_frame, wrap_angle

# a handful of products and sums of numbers of order 10
ROUNDING = 1e-12


def random_pose(rng, dimension):
    if dimension == 2:
        return Pose.planar(*rng.uniform(-9, 9, 2), rng.uniform(-7, 7))
    return Pose(rng.uniform(-9, 9, 3), Rotation.random(random_state=rng).as_matrix())


def test_a_quarter_turn_rotates_the_camera_axis_to_the_left():
    pose = Pose.planar(2.0, 3.0, math.pi / 2)
    assert pose.transform([[1.0, 0.0], [0.0, 1.0]]) == pytest.approx(
        np.array([[2.0, 4.0], [1.0, 3.0]])
    )


def test_composition_rotates_first_and_then_translates():
    # a step of 1 ahead of a camera at (2, 3) that looks along y, then a half turn
    pose = Pose.planar(2, 3, math.pi / 2) @ Pose.planar(1, 0, math.pi)
    assert pose.translation == pytest.approx([2, 4])
    assert pose.rotation == pytest.approx(np.array([[0, 1], [-1, 0]]), abs=ROUNDING)


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_pose_times_its_inverse_is_the_identity(dimension):
    rng = np.random.default_rng(0)
    for _ in range(50):
        pose = random_pose(rng, dimension)
        for product in (pose @ pose.inverse(), pose.inverse() @ pose):
            assert product.translation == pytest.approx(np.zeros(dimension), abs=ROUNDING)
            assert product.rotation == pytest.approx(np.eye(dimension), abs=ROUNDING)


@pytest.mark.parametrize("dimension", [2, 3])
def test_composing_is_transforming_twice_and_associative(dimension):
    rng = np.random.default_rng(1)
    for _ in range(50):
        a, b, c = (random_pose(rng, dimension) for _ in range(3))
        points = rng.normal(size=(4, dimension))
        assert (a @ b).transform(points) == pytest.approx(a.transform(b.transform(points)))
        left, right = (a @ b) @ c, a @ (b @ c)
        assert left.translation == pytest.approx(right.translation, abs=1e-11)
        assert left.rotation == pytest.approx(right.rotation, abs=ROUNDING)


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_rigid_transform_keeps_distances(dimension):
    rng = np.random.default_rng(2)
    pose = random_pose(rng, dimension)
    a, b = rng.normal(size=(2, 20, dimension))
    moved = np.linalg.norm(pose.transform(a) - pose.transform(b), axis=-1)
    assert moved == pytest.approx(np.linalg.norm(a - b, axis=-1))


@pytest.mark.parametrize(
    ("translation", "rotation", "message"),
    [
        (np.zeros(3), np.eye(2), "do not fit"),
        (np.zeros((2, 2)), np.eye(2), "do not fit"),
        (np.array([0.0, np.nan]), np.eye(2), "not finite"),
        (np.zeros(2), np.full((2, 2), np.inf), "not finite"),
        (np.zeros(2), np.diag([1.0, -1.0]), "not a proper rotation"),
        (np.zeros(2), 2 * np.eye(2), "not a proper rotation"),
        (np.zeros(3), -np.eye(3), "not a proper rotation"),
    ],
)
def test_a_pose_that_is_not_rigid_is_rejected(translation, rotation, message):
    with pytest.raises(ValueError, match=message):
        Pose(translation, rotation)


@pytest.mark.parametrize(
    ("angle", "wrapped"),
    [(0.0, 0.0), (math.pi, -math.pi), (-math.pi, -math.pi), (3.5 * math.pi, -math.pi / 2)],
)
def test_an_angle_is_wrapped_to_one_turn(angle, wrapped):
    assert wrap_angle(angle) == pytest.approx(wrapped)


def test_a_wrapped_angle_lies_in_the_half_open_interval_and_has_the_same_direction():
    turns = np.pi * np.arange(-9, 10)
    angles = np.concatenate(
        [
            np.random.default_rng(3).uniform(-50, 50, 1000),
            turns,
            np.nextafter(turns, np.inf),
            np.nextafter(turns, -np.inf),
        ]
    )
    wrapped = wrap_angle(angles)
    assert (wrapped >= -np.pi).all()
    assert (wrapped < np.pi).all()
    # the rounding of an angle of 50 rad is 7e-15
    assert np.exp(1j * wrapped) == pytest.approx(np.exp(1j * angles), abs=1e-13)


def test_a_point_ahead_of_a_rotated_camera_is_on_its_x_axis():
    camera = [2.0, 1.0, math.pi / 2]
    seen = to_camera_frame([[2.0, 4.0, math.pi], [1.0, 1.0, math.pi / 2]], camera)
    assert seen == pytest.approx(np.array([[3, 0, math.pi / 2], [0, 1, 0]]), abs=ROUNDING)


def test_camera_and_world_frame_are_inverse_of_each_other():
    rng = np.random.default_rng(4)
    poses = np.column_stack([rng.uniform(-9, 9, (100, 2)), rng.uniform(-3.1, 3.1, 100)])
    for reference in rng.uniform(-9, 9, (20, 3)):
        back = to_world_frame(to_camera_frame(poses, reference), reference)
        assert back == pytest.approx(poses, abs=1e-11)
        forth = to_camera_frame(to_world_frame(poses, reference), reference)
        assert forth == pytest.approx(poses, abs=1e-11)


def test_the_camera_frame_is_that_of_the_inverse_pose():
    rng = np.random.default_rng(5)
    for x, y, heading in rng.uniform(-5, 5, (20, 3)):
        poses = rng.uniform(-3, 3, (4, 5, 3))
        plain = Pose.planar(x, y, heading).inverse().transform(poses[..., :2])
        assert to_camera_frame(poses, [x, y, heading])[..., :2] == pytest.approx(plain)


def test_frame_conversions_accept_a_single_pose_and_do_not_change_it():
    pose, camera = np.array([2.0, 4.0, 0.0]), np.array([2.0, 1.0, 0.0])
    assert to_camera_frame(pose, camera) == pytest.approx([0, 3, 0])
    assert to_world_frame(pose, camera) == pytest.approx([4, 5, 0])
    assert pose.tolist() == [2, 4, 0]
    assert camera.tolist() == [2, 1, 0]
