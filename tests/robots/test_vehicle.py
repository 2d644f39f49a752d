import dataclasses

import numpy as np
import pytest
from plain.kinematics import random_joints, turn

from coopmap_env.geometry.transforms import Pose
from coopmap_env.robots import Vehicle, make_mount, without_bodies
from coopmap_env.sensing import RangeNoise
from coopmap_env.sensing.point_cloud import PointCloud


def test_poses_are_those_of_the_chain_moved_to_the_vehicle(vehicle):
    q = random_joints(vehicle.chain, np.random.default_rng(0), 3)
    R, t = vehicle.camera_poses(q)
    for k in range(3):
        Rc, tc = vehicle.chain.camera_poses(q[k])
        wanted = vehicle.T_world_base @ Pose(tc, Rc)
        np.testing.assert_allclose(t[k], wanted.translation, atol=1e-12)
        np.testing.assert_allclose(R[k], wanted.rotation, atol=1e-12)
        np.testing.assert_allclose(vehicle.camera_pose(q[k]).translation, t[k], atol=1e-12)
    R, t = vehicle.link_poses(q)
    camera = vehicle.chain.camera_link  # the mast's camera link is the camera frame
    np.testing.assert_allclose(t[:, camera], vehicle.camera_poses(q)[1], atol=1e-12)
    centers, radii = vehicle.spheres(q)
    np.testing.assert_allclose(
        centers[1], vehicle.T_world_base.transform(vehicle.body.centers(q[1])), atol=1e-12
    )
    assert radii is vehicle.body.radii


def test_no_moving_sphere_leaves_the_reach(any_mount, somewhere):
    vehicle = Vehicle.of(any_mount, somewhere)
    center, radius = vehicle.reach
    q = random_joints(vehicle.chain, np.random.default_rng(1), 2000)
    centers, radii = vehicle.spheres(q)
    far = np.linalg.norm(centers - center, axis=2) + radii
    assert 0.6 * radius < far[:, ~vehicle.body.is_static].max() <= radius


def test_by_hand_the_covariance_of_a_mast_that_errs_in_its_turntable_alone(somewhere):
    mount = dataclasses.replace(
        make_mount("mast"), suspension=None, encoder_noise=(0.03, 0, 0, 0, 0),
        calibration_error=(0.04, 0, 0, 0, 0),
    )  # fmt: skip
    vehicle = Vehicle.of(mount, somewhere)
    estimate = vehicle.camera_estimate(vehicle.home)
    r = vehicle.camera_pose(vehicle.home).translation - somewhere.translation
    sideways = np.array([-r[1], r[0], 0])
    column = np.concatenate([sideways, [0, 0, 1]])
    np.testing.assert_allclose(estimate.covariance, 0.05**2 * np.outer(column, column), atol=1e-15)


def test_the_covariance_eq_that_of_many_drawn_errors(any_mount, somewhere):
    """First order: standard deviations of a degree or less; 4000 draws tell them to 5 %."""
    vehicle = Vehicle.of(any_mount, somewhere)
    rng = np.random.default_rng(2)
    q = np.clip(vehicle.home + 0.1, vehicle.chain.lower, vehicle.chain.upper)
    estimate = vehicle.camera_estimate(q)
    loose, mount, n = any_mount.chain(on_suspension=True), any_mount, 4000
    errors = rng.normal(0.0, mount.encoder_noise, (n, len(q)))
    errors += rng.normal(0.0, mount.calibration_error, (n, len(q)))
    body = rng.normal(0.0, mount.suspension.std, (n, 3))
    R, t = loose.camera_poses(np.concatenate([body, q + errors], axis=1))
    R, t = somewhere.rotation @ R, somewhere.transform(t)
    dR = R @ estimate.pose.rotation.T
    turned = 0.5 * np.stack(
        [dR[:, 2, 1] - dR[:, 1, 2], dR[:, 0, 2] - dR[:, 2, 0], dR[:, 1, 0] - dR[:, 0, 1]], axis=1
    )
    drawn = np.cov(np.concatenate([t - estimate.pose.translation, turned], axis=1).T)
    scale = np.sqrt(np.diag(drawn))
    np.testing.assert_allclose(
        estimate.covariance / np.outer(scale, scale), drawn / np.outer(scale, scale), atol=0.08
    )
    np.testing.assert_allclose(np.sqrt(np.diag(estimate.covariance)), scale, rtol=0.05)


def test_the_estimate_turns_with_the_vehicle(mast):
    q = mast.home
    here = Vehicle.of(mast, Pose(np.zeros(3), np.eye(3))).camera_estimate(q)
    R = turn([0, 0, 1], 1.1)
    there = Vehicle.of(mast, Pose(np.array([1.0, 2.0, 0.1]), R)).camera_estimate(q)
    T = np.kron(np.eye(2), R)
    np.testing.assert_allclose(there.covariance, T @ here.covariance @ T.T, atol=1e-12)
    assert np.linalg.eigvalsh(there.covariance).min() > -1e-15


def test_errors_of_the_mast_are_of_the_size_of_its_suspension(vehicle):
    std = np.sqrt(np.diag(vehicle.camera_estimate(vehicle.home).covariance))
    assert (std[:3] > 0.001).all()
    assert (std[:3] < 0.03).all()
    assert (std[3:] > 0.001).all()
    assert (std[3:] < 0.015).all()


def test_a_vehicle_stands_in_space():
    with pytest.raises(ValueError, match="a pose in space"):
        Vehicle.of("mast", Pose.planar(0, 0, 0))


EXACT = RangeNoise(intrinsic=0.0)


def look(points, hit):
    return PointCloud(np.array(points, dtype=np.float64), np.array(hit))


def test_by_hand_a_hit_on_a_robot_becomes_a_beam_that_is_clear_up_to_it(somewhere):
    """A sphere of 0.5 m, 2 m ahead: its front is hit, a wall beside and behind it stays."""
    center = somewhere.transform([[2.0, 0, 0]])
    cloud = look([[1.6, 0, 0], [3, 0, 0], [2, 1, 0], [1.7, 0, 0]], [True, True, True, False])
    out = without_bodies(cloud, somewhere, center, [0.5], EXACT)
    np.testing.assert_allclose(out.points, [[1.5, 0, 0], [3, 0, 0], [2, 1, 0], [1.7, 0, 0]])
    np.testing.assert_array_equal(out.hit, [False, True, True, False])
    np.testing.assert_array_equal(cloud.hit, [True, True, True, False])  # the look is not changed


def test_by_hand_three_standard_deviations_are_granted():
    here = Pose(np.zeros(3), np.eye(3))
    noise = RangeNoise(intrinsic=0.01, exponent=1.0)  # 3 sigma at 1.45 m are 0.0435
    cloud = look([[1.46, 0, 0], [1.45, 0, 0]], [True, True])
    out = without_bodies(cloud, here, [[2.0, 0, 0]], [0.5], noise)
    np.testing.assert_array_equal(out.hit, [False, True])
    assert 1.45 < out.points[0, 0] < 1.46


def test_a_camera_inside_a_sphere_learns_nothing_from_what_it_sees_of_that_robot():
    here = Pose(np.zeros(3), np.eye(3))
    out = without_bodies(look([[0.3, 0, 0]], [True]), here, [[0.2, 0, 0]], [0.4], EXACT)
    np.testing.assert_array_equal(out.points, [[0, 0, 0]])
    assert not out.hit[0]


def test_a_sphere_around_the_camera_does_not_hide_another_robot():
    here = Pose(np.zeros(3), np.eye(3))
    cloud = look([[1.6, 0, 0], [3.0, 0, 0]], [True, True])
    out = without_bodies(cloud, here, [[2.0, 0, 0], [0, 0, 0]], [0.5, 0.2], EXACT)
    np.testing.assert_allclose(out.points, [[1.5, 0, 0], [3, 0, 0]])


def test_by_hand_the_uncertainty_of_the_pose_is_granted_too():
    here = Pose(np.zeros(3), np.eye(3))
    # 1 cm along each axis, and 0.01 rad about each: 3 sqrt(3 0.01^2 (1 + 1.41^2)) = 0.0898 m
    cloud = look([[1.411, 0, 0], [1.42, 0, 0]], [True, True])
    out = without_bodies(cloud, here, [[2.0, 0, 0]], [0.5], EXACT, 1e-4 * np.eye(6))
    np.testing.assert_array_equal(out.hit, [False, False])
    cloud = look([[1.409, 0, 0]], [True])
    out = without_bodies(cloud, here, [[2.0, 0, 0]], [0.5], EXACT, 1e-4 * np.eye(6))
    assert out.hit[0]


def plain_without(points, hit, centers, radii, spread):
    """Every beam and every sphere, in the camera frame."""
    out, still = points.copy(), hit.copy()
    for k in np.flatnonzero(hit):
        distance = np.linalg.norm(points[k])
        along = centers @ points[k] / distance
        wide = radii + 3 * spread * distance**2
        half2 = wide**2 - (centers**2).sum(axis=1) + along**2
        crossed = half2 > 0
        half = np.sqrt(half2[crossed])
        first, last = along[crossed] - half, along[crossed] + half
        holds = (first < distance) & (distance < last)
        if holds.any():
            entry = max(first[holds | (first > 0)].min(), 0.0)
            out[k], still[k] = points[k] * min(entry / distance, 1.0), False
    return out, still


def test_spheres_out_of_sight_are_left_out_without_a_difference():
    rng = np.random.default_rng(3)
    here, removed = Pose(np.zeros(3), np.eye(3)), 0
    for aside in (0.2, 0.7, 3.0):  # narrow, wide, all around
        for _ in range(20):
            points = rng.normal(size=(60, 3)) * [1, aside, aside] + [3, 0, 0]
            hit = rng.random(60) < 0.7
            centers, radii = rng.normal(size=(40, 3)) * 3, rng.uniform(0.1, 0.6, 40)
            noise = RangeNoise(intrinsic=0.01)
            out = without_bodies(look(points, hit), here, centers, radii, noise)
            wanted = plain_without(points, hit, centers, radii, noise.intrinsic * noise.depth)
            np.testing.assert_allclose(out.points, wanted[0], atol=1e-9)
            np.testing.assert_array_equal(out.hit, wanted[1])
            removed += np.count_nonzero(hit & ~out.hit)
    assert removed > 100


def test_spheres_of_other_shapes_are_refused():
    here = Pose(np.zeros(3), np.eye(3))
    with pytest.raises(ValueError, match=r"centres \(s, 3\) and radii \(s,\)"):
        without_bodies(look([[1, 0, 0]], [True]), here, np.zeros((2, 3)), [0.1], EXACT)
