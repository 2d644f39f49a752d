"""The team's cameras, bases and encoder offsets as one Gaussian."""

import dataclasses

import numpy as np
import pytest
from plain.joint_gaussian import condition_gaussian

from coopmap_env.geometry import Pose, apply_displacement, displacement_between, rotation_about_z
from coopmap_env.localization.correction._pose_state import MIN_VARIANCE, PoseState
from coopmap_env.robots import PoseEstimate, Vehicle, make_mount

pytest.importorskip("trimesh")
HOME = np.array(make_mount("mast").home)
OUT = HOME + np.array([0.5, 0.3, -0.2, 0.4, 0.1])
AWAY = HOME + np.array([-0.4, 0.1, 0.2, -0.3, 0.2])
ROUNDING = 1e-18
"""Of covariances of 1e-5 square metres and radians."""
PERFECT = 1e14 * np.eye(6)
"""A measurement to 0.1 micrometres and microradians."""
BASE_COVARIANCE = np.diag([0.03, 0.02, 0.01, 0.004, 0.005, 0.01]) ** 2


def standing(x, y, yaw):
    return Pose(np.array([x, y, 0.0]), rotation_about_z(yaw))


def vehicle(x=1.0, y=-0.5, yaw=0.7, **changes):
    mount = make_mount("mast")
    return Vehicle.from_mount(dataclasses.replace(mount, **changes) if changes else mount,
                      standing(x, y, yaw))  # fmt: skip


def team(**changes):
    return PoseState((vehicle(**changes), vehicle(-2.0, 1.0, -1.2, **changes)))


def same(estimate, wanted, atol=1e-12):
    np.testing.assert_allclose(estimate.pose.translation, wanted.pose.translation, atol=atol)
    np.testing.assert_allclose(estimate.pose.rotation, wanted.pose.rotation, atol=atol)
    np.testing.assert_allclose(estimate.covariance, wanted.covariance, atol=atol)


def padded(estimate):
    """With what keeps covariances definite."""
    return PoseEstimate(estimate.pose, estimate.covariance + MIN_VARIANCE * np.eye(6))


# prediction


@pytest.mark.parametrize("robot", [0, 1])
def test_the_first_prediction_is_that_of_the_vehicle(robot):
    poses = team()
    for reading in (HOME, OUT, AWAY):
        wanted = padded(poses.vehicles[robot].camera_estimate(reading))
        same(poses.predict(robot, reading), wanted)
    number = poses.add(robot, OUT)
    assert number == 0
    assert len(poses) == 1
    same(poses.estimate(0), padded(poses.vehicles[robot].camera_estimate(OUT)))


@pytest.mark.parametrize("robot", [0, 1])
def test_the_first_prediction_is_that_of_a_vehicle_whose_base_is_not_known_exactly(robot):
    poses = team()
    found = standing(0.3, 0.4, 2.0)
    R = np.kron(np.eye(2), rotation_about_z(0.5))
    covariance = R @ BASE_COVARIANCE @ R.T
    poses.set_base(robot, PoseEstimate(found, covariance))
    there = poses.vehicles[robot].with_base_pose(found, covariance)
    for reading in (HOME, OUT):
        same(poses.predict(robot, reading), padded(there.camera_estimate(reading)))
    same(poses.base(robot), PoseEstimate(found, covariance))
    other = 1 - robot  # knows its base exactly, as before
    same(poses.predict(other, OUT), padded(poses.vehicles[other].camera_estimate(OUT)))
    assert not poses.base(other).covariance.any()


def test_two_cameras_of_a_robot_share_their_offsets_and_those_of_two_robots_nothing():
    poses = team()
    one, two, other = poses.add(0, OUT), poses.add(0, AWAY), poses.add(1, OUT)
    P, v = poses.covariance, poses.vehicles[0]
    S = np.diag(np.square(v.mount.calibration_error))
    shared = v.joint_jacobian(OUT) @ S @ v.joint_jacobian(AWAY).T
    np.testing.assert_allclose(
        P[poses.camera_slice(one), poses.camera_slice(two)], shared, atol=1e-15
    )
    assert not P[poses.camera_slice(one), poses.camera_slice(other)].any()
    np.testing.assert_allclose(P, P.T, atol=ROUNDING)
    assert np.linalg.eigvalsh(P[11:, 11:]).min() > -ROUNDING


def test_predictions_are_those_of_many_drawn_errors():
    """Of base, offsets, encoders and body; 4000 draws determine standard deviations to 5 %."""
    poses = team()
    poses.set_base(0, PoseEstimate(standing(0.3, 0.4, 2.0), BASE_COVARIANCE / 4))
    poses.add(0, OUT)
    poses.add(0, AWAY)
    v, mount, rng = poses.vehicles[0], make_mount("mast"), np.random.default_rng(0)
    sprung, draws = mount.chain(with_suspension=True), np.empty((4000, 12))
    for k in range(4000):
        base = apply_displacement(
            v.T_world_base, rng.multivariate_normal(np.zeros(6), BASE_COVARIANCE / 4)
        )
        offsets = rng.normal(0.0, mount.calibration_error)
        for i, reading in enumerate((OUT, AWAY)):
            joints = reading - offsets - rng.normal(0.0, mount.encoder_noise)
            R, t = sprung.camera_poses([*rng.normal(0.0, mount.suspension.std), *joints])
            true = base @ Pose(t, R)
            draws[k, 6 * i : 6 * i + 6] = displacement_between(poses.cameras[i], true)
    drawn, at = np.cov(draws.T), poses.state_indices([0, 1])
    scale = np.sqrt(np.diag(drawn))
    estimated = poses.covariance[np.ix_(at, at)]
    np.testing.assert_allclose(np.sqrt(np.diag(estimated)), scale, rtol=0.06)
    both = np.outer(scale, scale)
    np.testing.assert_allclose(estimated / both, drawn / both, atol=0.08)


# updates


def test_a_perfect_measurement_pins_a_camera_and_moves_another_by_what_they_have_in_common():
    """Without noise of their own, both cameras have all of their errors from the offsets."""
    poses = team(encoder_noise=0.0, suspension=None)
    one, two, other = poses.add(0, OUT), poses.add(0, AWAY), poses.add(1, OUT)
    before = list(poses.cameras)
    offsets = np.array([2e-3, -1e-3, 1.5e-3, -2e-3, 1e-3])
    v = poses.vehicles[0]
    moved = displacement_between(before[one], v.camera_pose(OUT - offsets))
    poses.update(poses.state_indices([one]), PERFECT, PERFECT @ moved)
    # the padding of 1e-9 against errors of 7e-6 m^2: a part in a thousand; and the second order
    got = displacement_between(poses.cameras[one], apply_displacement(before[one], moved))
    assert np.abs(got).max() < 1e-6
    got = displacement_between(poses.cameras[two], v.camera_pose(AWAY - offsets))
    assert np.linalg.norm(displacement_between(before[two], v.camera_pose(AWAY - offsets))) > 1.5e-3
    assert np.abs(got).max() < 1e-4
    assert np.array_equal(poses.cameras[other].translation, before[other].translation)
    assert np.sqrt(np.diag(poses.estimate(one).covariance)).max() < 1e-6


def test_by_hand_a_turntable_that_is_off_turns_both_cameras():
    """Its offset is the only error: a camera turned by 2 mrad determines it, and the other one."""
    poses = team(encoder_noise=0.0, suspension=None, calibration_error=(0.003, 0, 0, 0, 0))
    one, two = poses.add(0, HOME), poses.add(0, AWAY)
    before, base = list(poses.cameras), poses.vehicles[0].T_world_base.translation
    A = np.zeros((6, 6))
    A[5, 5] = 1e14
    poses.update(poses.state_indices([one]), A, A @ [0, 0, 0, 0, 0, 2e-3])
    # the padding 1e-9 against 9e-6
    assert poses.robot_state[6] == pytest.approx(-2e-3, rel=3e-4)
    turned = displacement_between(before[two], poses.cameras[two])
    arm = before[two].translation - base
    np.testing.assert_allclose(turned[3:], [0, 0, 2e-3], atol=1e-6)
    np.testing.assert_allclose(turned[:3], 2e-3 * np.array([-arm[1], arm[0], 0]), atol=2e-6)


def test_measured_cameras_determine_the_offsets():
    """Each reduces their variance, and the next prediction is better for it."""
    poses = team()
    at = slice(6, 11)  # of the first robot, behind its base
    calibration = np.square(make_mount("mast").calibration_error)
    traces = [np.trace(poses.covariance[at, at])]
    assert traces[0] == pytest.approx(calibration.sum(), rel=1e-12)
    predicted = np.trace(poses.predict(0, HOME).covariance)
    for reading in (OUT, AWAY):
        number = poses.add(0, reading)
        poses.update(poses.state_indices([number]), PERFECT, np.zeros(6))
        traces.append(np.trace(poses.covariance[at, at]))
    assert traces[1] < 0.95 * traces[0]
    assert traces[2] < 0.95 * traces[1]
    assert np.trace(poses.predict(0, HOME).covariance) < predicted
    np.testing.assert_allclose(np.diag(poses.covariance)[17:22], calibration, rtol=1e-12)


@pytest.fixture
def seen_twice():
    """Three cameras of two robots, and a measurement of two of their displacements."""
    poses = team()
    poses.set_base(1, PoseEstimate(standing(-1.8, 1.1, -1.0), BASE_COVARIANCE))
    for robot, reading in ((0, OUT), (1, AWAY), (0, AWAY)):
        poses.add(robot, reading)
    rng = np.random.default_rng(1)
    H, R = rng.normal(size=(7, 12)), np.diag(rng.uniform(0.001, 0.01, 7) ** 2)
    z = 0.01 * rng.normal(size=7)
    W = np.linalg.inv(R)
    return poses, H, R, z, H.T @ W @ H, H.T @ W @ z


def test_conditioning_is_the_textbooks(seen_twice):
    poses, H, R, z, A, b = seen_twice
    state_indices = poses.state_indices([2, 1])
    assert state_indices.tolist() == [
        *range(34, 40),
        *range(28, 34),
    ]  # after twice 11 of the robots
    whole = np.zeros((7, len(poses.covariance)))
    whole[:, state_indices] = H
    start = np.zeros(len(poses.covariance))
    x, P = condition_gaussian(start, poses.covariance, whole, z, R)
    before, common = list(poses.cameras), poses.robot_state.copy()
    np.testing.assert_allclose(
        poses.posterior_displacement(state_indices, A, b), x[state_indices], atol=1e-12
    )
    assert poses.cameras == before  # nothing is moved by asking
    poses.update(state_indices, A, b)
    # sums of a condition of 1e5, of values of 1e-2 and 1e-4
    np.testing.assert_allclose(poses.robot_state - common, x[:22], atol=1e-11)
    np.testing.assert_allclose(poses.covariance, P, atol=1e-13)
    for k in range(3):
        moved = displacement_between(before[k], poses.cameras[k])
        np.testing.assert_allclose(moved, x[22 + 6 * k : 28 + 6 * k], atol=1e-11)


def test_two_measurements_are_as_good_as_both_at_once(seen_twice):
    """In either order: of Gaussians this is exact, up to turns that are composed."""
    poses, _, _, _, A, _ = seen_twice
    state_indices, again = poses.state_indices([0, 1]), poses.state_indices([1, 2])
    states = []
    for order in (0, 1):
        one = PoseState(tuple(poses.vehicles))
        one.robot_state, one.covariance, one.cameras = (
            poses.robot_state.copy(), poses.covariance.copy(), list(poses.cameras),
        )  # fmt: skip
        for at in (state_indices, again)[:: 1 - 2 * order]:
            if at is state_indices:
                one.update(at, A, np.zeros(12))
            else:
                one.update(at, 0.1 * A, np.zeros(12))
        states.append(one)
    np.testing.assert_allclose(states[0].covariance, states[1].covariance, atol=1e-13)


def test_a_measurement_that_says_nothing_changes_nothing(seen_twice):
    poses, *_ = seen_twice
    before, cameras = poses.covariance.copy(), list(poses.cameras)
    poses.update(poses.state_indices([0]), np.zeros((6, 6)), np.zeros(6))
    np.testing.assert_allclose(poses.covariance, before, atol=ROUNDING)
    for camera, was in zip(poses.cameras, cameras, strict=True):
        np.testing.assert_array_equal(camera.translation, was.translation)


def test_to_remove_a_camera_is_to_leave_it_out_of_the_gaussian(seen_twice):
    poses, _, _, _, A, b = seen_twice
    poses.update(poses.state_indices([0, 1]), A, b)
    kept = np.r_[0:28, 34:40]
    wanted, last = poses.covariance[np.ix_(kept, kept)], poses.cameras[2]
    poses.remove_camera(1)
    assert len(poses) == 2
    np.testing.assert_array_equal(poses.covariance, wanted)
    assert poses.cameras[1] is last
    number = poses.add(1, OUT)
    assert number == 2
    assert poses.camera_slice(number) == slice(34, 40)


# bases


def test_the_base_follows_from_a_measured_camera_and_the_kinematics():
    """A mount that hardly errs; the base is found 2 mm and 2 mrad off."""
    poses = PoseState((vehicle(encoder_noise=0.0, suspension=None, calibration_error=1e-7),))
    true = poses.vehicles[0].T_world_base
    off = np.array([0.002, -0.001, 0.0015, 0.001, -0.002, 0.0015])
    poses.set_base(0, PoseEstimate(apply_displacement(true, off), BASE_COVARIANCE))
    number = poses.add(0, OUT)
    camera = poses.vehicles[0].with_base_pose(true).camera_pose(OUT)
    moved = displacement_between(poses.cameras[number], camera)
    poses.update(poses.state_indices([number]), PERFECT, PERFECT @ moved)
    found = poses.base(0)
    assert np.linalg.norm(displacement_between(found.pose, poses.vehicles[0].T_world_base)) > 3e-3
    # of 2 mm and 2 mrad the second order is 4e-6, and the padding changes 2e-3 by 1e-9 / 1.6e-5
    assert np.abs(displacement_between(found.pose, true)).max() < 2e-5
    # the camera's pose to the root of the padding, 3e-5, and 2 m of arm
    assert np.sqrt(np.diag(found.covariance)).max() < 1e-4
    # and the next camera is where the true base puts it
    there = poses.vehicles[0].with_base_pose(true).camera_pose(AWAY)
    assert np.abs(displacement_between(poses.predict(0, AWAY).pose, there)).max() < 4e-5


def test_a_base_that_is_known_exactly_stays():
    poses = team()
    number = poses.add(0, OUT)
    poses.update(poses.state_indices([number]), PERFECT, PERFECT @ np.full(6, 0.003))
    base = poses.base(0)
    np.testing.assert_array_equal(base.pose.translation, [1.0, -0.5, 0.0])
    assert not base.covariance.any()


def test_a_base_that_is_found_knows_nothing_of_what_was_taken_for_it_before():
    poses = team()
    poses.set_base(0, PoseEstimate(standing(0, 0, 0), BASE_COVARIANCE))
    poses.set_base(0, PoseEstimate(standing(1, 2, 0.3), BASE_COVARIANCE / 100))
    same(poses.base(0), PoseEstimate(standing(1, 2, 0.3), BASE_COVARIANCE / 100))
    np.testing.assert_array_equal(poses.covariance, poses.covariance.T)
