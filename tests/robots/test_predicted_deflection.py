"""The camera pose with the predicted lean of the body, and its covariance."""

from dataclasses import replace

import numpy as np
import pytest
from plain.crane import ROLL_CENTRE_HEIGHT, SLIDER_MASS, crane

from coopmap_env.geometry import Pose, displacement_between, rotation_from_rotvec
from coopmap_env.robots import GRAVITY, Equilibrium, Suspension, Vehicle

pytest.importorskip("trimesh")


def leaning(mount, base):
    return Vehicle.from_mount(mount, base, predicts_deflection=True)


def joints_of(vehicle, n, seed=0):
    rng = np.random.default_rng(seed)
    lower, upper = np.maximum(vehicle.chain.lower, -2.0), np.minimum(vehicle.chain.upper, 2.0)
    return rng.uniform(lower, upper, (n, vehicle.chain.n_joints))


def numeric_jacobian(pose_at, n, step=1e-5):
    """Columns (6, n) of the displacement of a pose with each of n numbers."""
    columns = []
    for i in range(n):
        d = step * np.eye(n)[i]
        columns.append(displacement_between(pose_at(-d), pose_at(d)) / (2 * step))
    return np.array(columns).T


def test_by_hand_a_mass_ahead_lowers_the_camera_on_it(tmp_path):
    """10 kg 0.5 m ahead on 12000 N m/rad: 4.0875 mrad, and at 0.5 m 2.044 mm down."""
    vehicle = leaning(crane(tmp_path, "1 0 0"), Pose(np.zeros(3), np.eye(3)))
    angle = SLIDER_MASS * GRAVITY * 0.5 / 12_000
    wanted = [0.5 * np.cos(angle), 0.0, ROLL_CENTRE_HEIGHT - 0.5 * np.sin(angle)]
    # second order: the mass goes down and comes back by 1e-5 of the angle
    np.testing.assert_allclose(vehicle.camera_pose([0.5]).translation, wanted, atol=1e-7)
    assert vehicle.camera_deflection([0.5]) == pytest.approx(0.5 * angle, rel=1e-4)
    assert vehicle.camera_deflection([0.0]) == pytest.approx(0.0, abs=1e-15)


def test_a_vehicle_that_does_not_predict_assumes_its_body_at_rest(mast, somewhere):
    rigid = leaning(replace(mast, suspension=None), somewhere)
    plain = Vehicle.from_mount(mast, somewhere)
    q = joints_of(plain, 1)[0]
    np.testing.assert_array_equal(
        rigid.camera_pose(q).translation, plain.camera_pose(q).translation
    )
    assert rigid.equilibrium is None
    assert plain.camera_deflection(q) == 0.0
    with pytest.raises(ValueError, match="does not predict its deflection"):
        plain.compliance_jacobian(q)


def test_many_poses_at_once_are_those_one_by_one(any_mount, somewhere):
    vehicle = leaning(any_mount, somewhere)
    joints = joints_of(vehicle, 5)
    R, t = vehicle.camera_poses(joints)
    for k, q in enumerate(joints):
        one = vehicle.camera_pose(q)
        np.testing.assert_array_equal(R[k], one.rotation)
        np.testing.assert_array_equal(t[k], one.translation)


def test_a_vehicle_on_a_slope_leans_by_the_gravity_in_its_own_frame(mast):
    tilted = Pose(np.zeros(3), rotation_from_rotvec(np.array([0.1, -0.05, 0.3])))
    q = np.array([1.2, 0.5, 0.4, 0.0, 0.0])
    moved = leaning(mast, Pose(np.ones(3), np.eye(3))).with_base_pose(tilted)
    at_once = leaning(mast, tilted)
    np.testing.assert_allclose(
        moved.camera_pose(q).translation, at_once.camera_pose(q).translation, atol=1e-14
    )
    gravity = tilted.rotation.T @ [0.0, 0.0, -GRAVITY]
    rest = Equilibrium.from_mount(mast, gravity).rest_configurations(q[None])
    R, t = mast.chain(with_suspension=True).camera_poses(rest[0])
    wanted = tilted @ Pose(t, R)
    np.testing.assert_allclose(at_once.camera_pose(q).translation, wanted.translation, atol=1e-14)


def test_softer_springs_are_those_of_a_softer_mount(mast, somewhere):
    soft = replace(
        mast,
        suspension=replace(
            mast.suspension, roll_stiffness=9_000 / 1.25, pitch_stiffness=12_000 / 0.8
        ),
    )
    q = np.array([1.2, 0.5, 0.4, 0.0, 0.0])
    vehicle = leaning(mast, somewhere).with_compliance(np.array([1.25, 0.8]))
    wanted = leaning(soft, somewhere).camera_pose(q)
    np.testing.assert_allclose(vehicle.camera_pose(q).translation, wanted.translation, atol=1e-13)
    again = vehicle.with_compliance(np.ones(2))  # it is absolute, not one change after another
    wanted = leaning(mast, somewhere).camera_pose(q)
    np.testing.assert_allclose(again.camera_pose(q).translation, wanted.translation, atol=1e-13)
    rigid = Vehicle.from_mount(mast, somewhere)
    assert rigid.with_compliance(np.array([1.25, 0.8])) is rigid


def test_the_jacobian_of_the_compliance_is_that_of_differences(any_mount, somewhere):
    vehicle = leaning(any_mount, somewhere)
    for at in (np.ones(2), np.array([1.2, 0.85])):
        there = vehicle.with_compliance(at)
        for q in joints_of(vehicle, 3):
            wanted = numeric_jacobian(
                lambda d, q=q, at=at: vehicle.with_compliance(at + d).camera_pose(q), 2, 1e-4
            )
            np.testing.assert_allclose(there.compliance_jacobian(q), wanted, atol=1e-8)


def test_the_jacobian_of_the_joints_has_the_load_that_they_move(any_mount, somewhere):
    vehicle = leaning(any_mount, somewhere)
    for q in joints_of(vehicle, 3):
        wanted = numeric_jacobian(lambda d, q=q: vehicle.camera_pose(q + d), len(q), 1e-4)
        np.testing.assert_allclose(vehicle.joint_jacobian(q), wanted, atol=1e-7)
        rigid = Vehicle.from_mount(any_mount, somewhere).joint_jacobian(q)
        assert np.abs(rigid - wanted).max() > 1e-4


def test_the_covariance_is_that_of_many_drawn_vehicles(any_mount, somewhere):
    """4000 draws of encoders, offsets, stiffness and the rest; deviations to 5 %."""
    vehicle, rng = leaning(any_mount, somewhere), np.random.default_rng(1)
    suspension, q = any_mount.suspension, joints_of(vehicle, 1, seed=3)[0]
    sprung, pose = any_mount.chain(with_suspension=True), vehicle.camera_pose(q)
    draws = np.empty((4000, 6))
    for k in range(len(draws)):
        errors = rng.normal(0.0, any_mount.encoder_noise) + rng.normal(
            0.0, any_mount.calibration_error
        )
        tolerance = suspension.stiffness_tolerance
        softened = vehicle.equilibrium.with_compliance(
            1.0 / rng.uniform(1 - tolerance, 1 + tolerance, 2)
        )
        full = softened.rest_configurations((q - errors)[None])[0]
        full[:3] += rng.normal(0.0, suspension.predicted_std)
        R, t = sprung.camera_poses(full)
        draws[k] = displacement_between(pose, somewhere @ Pose(t, R))
    drawn = draws.T @ draws / len(draws)
    estimated = vehicle.camera_estimate(q).covariance
    scale = np.sqrt(np.diag(drawn))
    np.testing.assert_allclose(np.sqrt(np.diag(estimated)), scale, rtol=0.06)
    both = np.outer(scale, scale)
    np.testing.assert_allclose(estimated / both, drawn / both, atol=0.08)


def test_a_predicted_pose_is_known_better_than_one_that_is_not(mast, somewhere):
    q = np.array([1.2, 0.5, 0.4, 0.0, 0.0])
    sure = leaning(mast, somewhere).camera_estimate(q).covariance
    unsure = Vehicle.from_mount(mast, somewhere).camera_estimate(q).covariance
    assert np.trace(sure[:3, :3]) < 0.6 * np.trace(unsure[:3, :3])


def test_a_uniform_error_of_a_fifth_has_a_deviation_of_0_115():
    assert Suspension().compliance_std == pytest.approx(0.11547, abs=1e-5)
