import dataclasses

import numpy as np
import pytest
from plain.kinematics import random_joints, rotation_about_axis

from coopmap_env.geometry import Pose, apply_displacement, displacement_between
from coopmap_env.robots import Vehicle, filter_robot_points, make_mount
from coopmap_env.sensing import PointCloud, RangeNoise


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
    vehicle = Vehicle.from_mount(any_mount, somewhere)
    center, radius = vehicle.workspace_sphere
    q = random_joints(vehicle.chain, np.random.default_rng(1), 2000)
    centers, radii = vehicle.spheres(q)
    far = np.linalg.norm(centers - center, axis=2) + radii
    assert 0.6 * radius < far[:, vehicle.body.sphere_body_index > 0].max() <= radius


def test_by_hand_the_covariance_of_a_mast_that_errs_in_its_turntable_alone(somewhere):
    mount = dataclasses.replace(
        make_mount("mast"), suspension=None, encoder_noise=(0.03, 0, 0, 0, 0),
        calibration_error=(0.04, 0, 0, 0, 0),
    )  # fmt: skip
    vehicle = Vehicle.from_mount(mount, somewhere)
    estimate = vehicle.camera_estimate(vehicle.home)
    r = vehicle.camera_pose(vehicle.home).translation - somewhere.translation
    sideways = np.array([-r[1], r[0], 0])
    column = np.concatenate([sideways, [0, 0, 1]])
    np.testing.assert_allclose(estimate.covariance, 0.05**2 * np.outer(column, column), atol=1e-15)


def test_the_covariance_eq_that_of_many_drawn_errors(any_mount, somewhere):
    """First order: standard deviations of a degree or less; 4000 draws give them to 5 %."""
    vehicle = Vehicle.from_mount(any_mount, somewhere)
    rng = np.random.default_rng(2)
    q = np.clip(vehicle.home + 0.1, vehicle.chain.lower, vehicle.chain.upper)
    estimate = vehicle.camera_estimate(q)
    loose, mount, n = any_mount.chain(with_suspension=True), any_mount, 4000
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
    here = Vehicle.from_mount(mast, Pose(np.zeros(3), np.eye(3))).camera_estimate(q)
    R = rotation_about_axis([0, 0, 1], 1.1)
    there = Vehicle.from_mount(mast, Pose(np.array([1.0, 2.0, 0.1]), R)).camera_estimate(q)
    T = np.kron(np.eye(2), R)
    np.testing.assert_allclose(there.covariance, T @ here.covariance @ T.T, atol=1e-12)
    assert np.linalg.eigvalsh(there.covariance).min() > -1e-15


def test_errors_of_the_mast_are_of_the_size_of_its_suspension(vehicle):
    std = np.sqrt(np.diag(vehicle.camera_estimate(vehicle.home).covariance))
    assert (std[:3] > 0.001).all()
    assert (std[:3] < 0.03).all()
    assert (std[3:] > 0.001).all()
    assert (std[3:] < 0.015).all()


BASE_COVARIANCE = np.diag([0.03, 0.02, 0.01, 0.004, 0.005, 0.01]) ** 2


def differences(pose_of, n, step=1e-6):
    """Central differences (6, n) of a pose as a displacement; their own error is about 1e-10."""
    columns = []
    for d in step * np.eye(n):
        columns.append(displacement_between(pose_of(-d), pose_of(d)) / (2 * step))
    return np.array(columns).T


def test_the_joint_jacobian_is_that_of_differences(any_mount, somewhere):
    vehicle = Vehicle.from_mount(any_mount, somewhere)
    for q in random_joints(vehicle.chain, np.random.default_rng(3), 5):
        J = vehicle.joint_jacobian(q)
        assert J.shape == (6, vehicle.chain.n_joints)
        wanted = differences(lambda d, q=q: vehicle.camera_pose(q + d), len(q))
        np.testing.assert_allclose(J, wanted, atol=1e-8)


def test_the_base_jacobian_is_that_of_differences(vehicle):
    q = vehicle.home + 0.2
    J = vehicle.base_jacobian(vehicle.camera_pose(q))
    wanted = differences(
        lambda d: vehicle.with_base_pose(apply_displacement(vehicle.T_world_base, d)).camera_pose(
            q
        ),
        6,
    )
    np.testing.assert_allclose(J, wanted, atol=1e-8)


def test_by_hand_a_base_that_turns_takes_a_camera_two_metres_ahead_sideways(mast):
    base = Pose(np.array([1.0, 2.0, 0.0]), np.eye(3))
    camera = Pose(np.array([3.0, 2.0, 1.5]), np.eye(3))
    J = Vehicle.from_mount(mast, base).base_jacobian(camera)
    np.testing.assert_array_equal(J[:, :3], np.eye(6)[:, :3])
    np.testing.assert_array_equal(J[:, 3], [0, -1.5, 0, 1, 0, 0])  # roll: what is up goes right
    np.testing.assert_array_equal(J[:, 4], [1.5, 0, -2, 0, 1, 0])  # pitch: forward and down
    np.testing.assert_array_equal(J[:, 5], [0, 2, 0, 0, 0, 1])  # yaw: to the left


def test_somewhere_else_it_is_the_same_vehicle(vehicle):
    there = Pose(np.array([-1.0, 0.5, 0.0]), rotation_about_axis([0, 0, 1], -2.0))
    moved = vehicle.with_base_pose(there, BASE_COVARIANCE)
    assert moved.T_world_base is there
    assert moved.base_covariance is BASE_COVARIANCE
    assert (moved.mount, moved.chain, moved.body) == (vehicle.mount, vehicle.chain, vehicle.body)
    assert vehicle.base_covariance is None
    assert moved.with_base_pose(there).base_covariance is None
    wanted = there @ vehicle.T_world_base.inverse() @ vehicle.camera_pose(vehicle.home)
    pose = moved.camera_pose(vehicle.home)
    np.testing.assert_allclose(pose.translation, wanted.translation, atol=1e-12)
    np.testing.assert_allclose(pose.rotation, wanted.rotation, atol=1e-12)
    reach = moved.workspace_sphere[0]  # nothing is kept of where it stood
    np.testing.assert_allclose(
        there.inverse().transform(reach),
        vehicle.T_world_base.inverse().transform(vehicle.workspace_sphere[0]), atol=1e-12,
    )  # fmt: skip
    with pytest.raises(ValueError, match="a 3-D base pose"):
        vehicle.with_base_pose(Pose.planar(0, 0, 0))


def test_by_hand_own_errors_are_those_that_are_new_at_each_cloud_of(mast, somewhere):
    """A turntable alone: 0.03 rad of noise differ in each scan, 0.04 rad of offset do not."""
    mount = dataclasses.replace(
        mast, suspension=None, encoder_noise=(0.03, 0, 0, 0, 0),
        calibration_error=(0.04, 0, 0, 0, 0),
    )  # fmt: skip
    vehicle = Vehicle.from_mount(mount, somewhere)
    r = vehicle.camera_pose(vehicle.home).translation - somewhere.translation
    column = np.array([-r[1], r[0], 0, 0, 0, 1])
    np.testing.assert_allclose(vehicle.joint_jacobian(vehicle.home)[:, 0], column, atol=1e-12)
    own = vehicle.per_scan_covariance(vehicle.home)
    np.testing.assert_allclose(own, 0.03**2 * np.outer(column, column), atol=1e-15)


def test_a_suspension_errs_anew_at_each_cloud_of(mast, somewhere):
    stiff = Vehicle.from_mount(dataclasses.replace(mast, suspension=None), somewhere)
    vehicle = Vehicle.from_mount(mast, somewhere)
    J = differences(
        lambda d: somewhere @ Pose(*mast.chain(True).camera_poses([*d, *mast.home])[::-1]), 3
    )
    added = (J * np.square(mast.suspension.std)) @ J.T
    wanted = stiff.per_scan_covariance(mast.home) + added
    # of variances of 1e-5, by differences that are off by 1e-8
    np.testing.assert_allclose(vehicle.per_scan_covariance(mast.home), wanted, atol=1e-12)


def test_the_estimate_is_of_own_and_of_lasting_errors(any_mount, somewhere):
    vehicle = Vehicle.from_mount(any_mount, somewhere)
    q = np.clip(vehicle.home + 0.1, vehicle.chain.lower, vehicle.chain.upper)
    J = vehicle.joint_jacobian(q)
    lasting = J @ np.diag(np.square(any_mount.calibration_error)) @ J.T
    wanted = vehicle.per_scan_covariance(q) + lasting
    np.testing.assert_allclose(vehicle.camera_estimate(q).covariance, wanted, atol=1e-16)
    unsure = vehicle.with_base_pose(somewhere, BASE_COVARIANCE)
    B = vehicle.base_jacobian(vehicle.camera_pose(q))
    wanted = wanted + B @ BASE_COVARIANCE @ B.T
    np.testing.assert_allclose(unsure.camera_estimate(q).covariance, wanted, atol=1e-16)
    exact = vehicle.with_base_pose(somewhere, np.zeros((6, 6)))
    np.testing.assert_array_equal(
        exact.camera_estimate(q).covariance, vehicle.camera_estimate(q).covariance
    )


def test_the_share_of_the_base_eq_that_of_many_drawn_bases(mast, somewhere):
    """First order, of a base known to a degree or less; 4000 draws give deviations to 5 %."""
    vehicle = Vehicle.from_mount(mast, somewhere).with_base_pose(somewhere, BASE_COVARIANCE)
    rng, q = np.random.default_rng(4), mast.home
    pose = vehicle.camera_pose(q)
    drawn = np.cov(
        [
            displacement_between(
                pose, apply_displacement(somewhere, d) @ somewhere.inverse() @ pose
            )
            for d in rng.multivariate_normal(np.zeros(6), BASE_COVARIANCE, 4000)
        ],
        rowvar=False,
    )
    exact = Vehicle.from_mount(mast, somewhere).camera_estimate(q).covariance
    added = vehicle.camera_estimate(q).covariance - exact
    scale = np.sqrt(np.diag(drawn))
    np.testing.assert_allclose(np.sqrt(np.diag(added)), scale, rtol=0.05)
    both = np.outer(scale, scale)
    np.testing.assert_allclose(added / both, drawn / both, atol=0.08)


def test_a_vehicle_stands_in_space():
    with pytest.raises(ValueError, match="a 3-D base pose"):
        Vehicle.from_mount("mast", Pose.planar(0, 0, 0))


@pytest.mark.parametrize("covariance", [np.eye(3), np.ones(6), np.ones((6, 5))])
def test_the_covariance_of_a_base_is_6_by_6(vehicle, covariance):
    with pytest.raises(ValueError, match=r"base_covariance must be \(6, 6\)"):
        vehicle.with_base_pose(vehicle.T_world_base, covariance)


def test_a_deflection_needs_a_suspension(mast, somewhere):
    predicting = Vehicle.from_mount(mast, somewhere, predicts_deflection=True)
    with pytest.raises(ValueError, match="'mast' has no suspension"):
        dataclasses.replace(predicting, mount=dataclasses.replace(mast, suspension=None))


def test_cameras_stand_in_space(vehicle):
    with pytest.raises(ValueError, match="a pose of three axes"):
        vehicle.base_jacobian(Pose.planar(0, 0, 0))
    with pytest.raises(ValueError, match="a pose of three axes"):
        filter_robot_points(
            cloud_of([[1, 0, 0]], [True]), Pose.planar(0, 0, 0), np.zeros((1, 3)), [0.1], EXACT
        )


EXACT = RangeNoise(intrinsic=0.0)


def cloud_of(points, hit):
    return PointCloud(np.array(points, dtype=np.float64), np.array(hit))


def test_by_hand_a_hit_on_a_robot_becomes_a_beam_that_is_clear_up_to_it(somewhere):
    """A sphere of 0.5 m, 2 m ahead: its front is hit, a wall beside and behind it stays."""
    center = somewhere.transform([[2.0, 0, 0]])
    cloud = cloud_of([[1.6, 0, 0], [3, 0, 0], [2, 1, 0], [1.7, 0, 0]], [True, True, True, False])
    out = filter_robot_points(cloud, somewhere, center, [0.5], EXACT)
    np.testing.assert_allclose(out.points, [[1.5, 0, 0], [3, 0, 0], [2, 1, 0], [1.7, 0, 0]])
    np.testing.assert_array_equal(out.hit, [False, True, True, False])
    np.testing.assert_array_equal(
        cloud.hit, [True, True, True, False]
    )  # the argument is not changed


def test_by_hand_three_standard_deviations_are_granted():
    here = Pose(np.zeros(3), np.eye(3))
    noise = RangeNoise(intrinsic=0.01, exponent=1.0)  # 3 sigma at 1.45 m are 0.0435
    cloud = cloud_of([[1.46, 0, 0], [1.45, 0, 0]], [True, True])
    out = filter_robot_points(cloud, here, [[2.0, 0, 0]], [0.5], noise)
    np.testing.assert_array_equal(out.hit, [False, True])
    assert 1.45 < out.points[0, 0] < 1.46


def test_a_camera_inside_a_sphere_learns_nothing_from_what_it_sees_of_that_robot():
    here = Pose(np.zeros(3), np.eye(3))
    out = filter_robot_points(cloud_of([[0.3, 0, 0]], [True]), here, [[0.2, 0, 0]], [0.4], EXACT)
    np.testing.assert_array_equal(out.points, [[0, 0, 0]])
    assert not out.hit[0]


def test_a_sphere_around_the_camera_does_not_hide_another_robot():
    here = Pose(np.zeros(3), np.eye(3))
    cloud = cloud_of([[1.6, 0, 0], [3.0, 0, 0]], [True, True])
    out = filter_robot_points(cloud, here, [[2.0, 0, 0], [0, 0, 0]], [0.5, 0.2], EXACT)
    np.testing.assert_allclose(out.points, [[1.5, 0, 0], [3, 0, 0]])


def test_by_hand_the_uncertainty_of_the_pose_is_granted_too():
    here = Pose(np.zeros(3), np.eye(3))
    # 1 cm along each axis, and 0.01 rad about each: 3 sqrt(3 0.01^2 (1 + 1.41^2)) = 0.0898 m
    cloud = cloud_of([[1.411, 0, 0], [1.42, 0, 0]], [True, True])
    out = filter_robot_points(cloud, here, [[2.0, 0, 0]], [0.5], EXACT, 1e-4 * np.eye(6))
    np.testing.assert_array_equal(out.hit, [False, False])
    cloud = cloud_of([[1.409, 0, 0]], [True])
    out = filter_robot_points(cloud, here, [[2.0, 0, 0]], [0.5], EXACT, 1e-4 * np.eye(6))
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
            out = filter_robot_points(cloud_of(points, hit), here, centers, radii, noise)
            wanted = plain_without(points, hit, centers, radii, noise.intrinsic * noise.depth)
            np.testing.assert_allclose(out.points, wanted[0], atol=1e-9)
            np.testing.assert_array_equal(out.hit, wanted[1])
            removed += np.count_nonzero(hit & ~out.hit)
    assert removed > 100


def test_spheres_of_other_shapes_are_refused():
    here = Pose(np.zeros(3), np.eye(3))
    with pytest.raises(ValueError, match=r"centers \(s, 3\) and radii \(s,\)"):
        filter_robot_points(cloud_of([[1, 0, 0]], [True]), here, np.zeros((2, 3)), [0.1], EXACT)
