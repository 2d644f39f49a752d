import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from coopmap_env.geometry import (
    Pose,
    apply_displacement,
    displacement_between,
    nearest_rotation,
    random_rotation,
    rotation_about_axis,
    rotation_about_z,
    rotation_from_quaternion,
    rotation_from_rotvec,
    rotation_from_rpy,
    rotvec_from_rotation,
    skew,
)


def vectors():
    rng = np.random.default_rng(0)
    lengths = [0.0, 1e-12, 1e-9, 1e-6, 0.3, 2.0, 3.1, np.pi - 1e-7, np.pi]
    return [length * v / np.linalg.norm(v) for length in lengths for v in rng.normal(size=(5, 3))]


def test_quarter_turn_about_z():
    R = rotation_from_rotvec([0, 0, np.pi / 2])
    np.testing.assert_allclose(R, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-15)


def test_skew_is_the_cross_product():
    np.testing.assert_array_equal(skew([1, 2, 3]) @ [4, 5, 6], np.cross([1, 2, 3], [4, 5, 6]))
    assert skew(np.ones((4, 5, 3))).shape == (4, 5, 3, 3)


@pytest.mark.parametrize("w", vectors())
def test_rotation_vectors_agree_with_scipy_and_come_back(w):
    R = rotation_from_rotvec(w)
    np.testing.assert_allclose(R, Rotation.from_rotvec(w).as_matrix(), atol=1e-14)
    back = rotvec_from_rotation(R)
    assert np.linalg.norm(back) <= np.pi + 1e-12
    np.testing.assert_allclose(rotation_from_rotvec(back), R, atol=1e-9)
    if np.linalg.norm(w) < 3.1:  # at pi, two rotation vectors are one rotation
        np.testing.assert_allclose(back, w, atol=1e-12)


def test_nearest_rotation_keeps_a_rotation_and_undoes_scale():
    R = rotation_from_rotvec([0.3, -1.0, 0.5])
    np.testing.assert_allclose(nearest_rotation(R), R, atol=1e-14)
    np.testing.assert_allclose(nearest_rotation(2.5 * R), R, atol=1e-14)


def test_nearest_rotation_is_nearer_than_any_other_and_never_a_reflection():
    rng = np.random.default_rng(1)
    for _ in range(20):
        M = rng.normal(size=(3, 3))
        R = nearest_rotation(M)
        assert np.linalg.det(R) == pytest.approx(1.0)
        others = Rotation.random(200, rng).as_matrix()
        near = np.array([rotation_from_rotvec(0.01 * v) for v in rng.normal(size=(50, 3))]) @ R
        for other in (*others, *near):
            assert np.linalg.norm(M - R) <= np.linalg.norm(M - other) + 1e-12


def test_displacement_leads_from_one_pose_to_the_other():
    one = Pose(np.array([1.0, 2.0, 3.0]), rotation_from_rotvec([0.2, 0.1, -0.4]))
    d = np.array([0.1, -0.2, 0.3, 0.02, -0.01, 0.05])
    other = apply_displacement(one, d)
    np.testing.assert_allclose(other.translation, [1.1, 1.8, 3.3])
    np.testing.assert_allclose(displacement_between(one, other), d, atol=1e-14)


@pytest.mark.parametrize("angle", [-3.0, -0.4, 0.0, 1e-9, 1.5, 9.0])
def test_rotation_about_z_is_that_about_the_z_axis(angle):
    np.testing.assert_allclose(
        rotation_about_z(angle), rotation_about_axis([0, 0, 1], angle), atol=1e-15
    )
    np.testing.assert_allclose(rotation_about_z(np.pi / 2) @ [1, 0, 0], [0, 1, 0], atol=1e-15)


def test_rotations_are_those_of_scipy():
    np.testing.assert_allclose(
        rotation_from_rpy(0.1, -0.7, 2.0), Rotation.from_euler("xyz", [0.1, -0.7, 2.0]).as_matrix()
    )
    axis = np.array([0.6, 0.0, 0.8])
    np.testing.assert_allclose(
        rotation_about_axis(axis, 0.9), Rotation.from_rotvec(0.9 * axis).as_matrix()
    )
    quaternion = [0.3, -1.0, 2.0, 0.7]  # of another length than 1
    np.testing.assert_allclose(
        rotation_from_quaternion(quaternion), Rotation.from_quat(quaternion).as_matrix(), atol=1e-15
    )


@pytest.mark.parametrize("quaternion", [np.zeros(4), [np.nan, 0, 0, 1], [np.inf, 0, 0, 1]])
def test_a_quaternion_without_a_length_is_no_rotation(quaternion):
    with pytest.raises(ValueError, match="a quaternion of finite length above 0"):
        rotation_from_quaternion(quaternion)


def test_random_rotations_favour_no_direction():
    rng = np.random.default_rng(0)
    drawn = np.array([random_rotation(rng) for _ in range(4000)])
    np.testing.assert_allclose(drawn[0] @ drawn[0].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(drawn[0]) == pytest.approx(1.0)
    # each entry has mean 0 and variance 1/3: four standard errors are 0.037
    np.testing.assert_allclose(drawn.mean(axis=0), 0.0, atol=0.037)


def test_planar_poses_have_no_displacement_in_space():
    flat, spatial = Pose.planar(0.0, 0.0, 0.3), Pose(np.zeros(3), np.eye(3))
    for pair in ((flat, flat), (flat, spatial), (spatial, flat)):
        with pytest.raises(ValueError, match="a pose of three axes"):
            displacement_between(*pair)


@pytest.mark.parametrize("shape", [(2, 2), (0, 0), (3, 1), (5, 3, 3), (3,)])
def test_a_rotation_of_another_shape_has_no_rotation_vector(shape):
    with pytest.raises(ValueError, match=r"must be \(3, 3\)"):
        rotvec_from_rotation(np.zeros(shape))
