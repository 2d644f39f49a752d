"""The compliance of a vehicle's springs as a part of the state, and poses that follow from it."""

import numpy as np
import pytest

from coopmap_env.geometry import Pose, displacement_between, rotation_about_z
from coopmap_env.localization.correction._pose_history import PastScan, PoseHistory
from coopmap_env.localization.correction._pose_state import (
    COMPLIANCE_BOUNDS,
    MIN_VARIANCE,
    PoseState,
)
from coopmap_env.robots import Vehicle, make_mount

pytest.importorskip("trimesh")
HOME = np.array(make_mount("mast").home)
ASIDE = np.array([1.2, 0.5, 0.4, 0.0, 0.0])
AHEAD = np.array([0.0, 0.6, 0.3, 0.2, 0.1])
PERFECT = 1e12 * np.eye(6)
"""A measurement to a micrometre and a microradian."""


def vehicle():
    base = Pose(np.array([1.0, -0.5, 0.0]), rotation_about_z(0.7))
    return Vehicle.from_mount("mast", base, predicts_deflection=True)


@pytest.fixture
def poses():
    return PoseState((vehicle(), vehicle()))


def measure(poses, camera, true, A=PERFECT):
    moved = displacement_between(poses.cameras[camera], true)
    poses.update(poses.state_indices([camera]), A, A @ moved)


def test_the_first_prediction_is_that_of_the_vehicle(poses):
    for reading in (HOME, ASIDE, AHEAD):
        wanted = vehicle().camera_estimate(reading)
        found = poses.predict(1, reading)
        np.testing.assert_array_equal(found.pose.translation, wanted.pose.translation)
        covariance = wanted.covariance + MIN_VARIANCE * np.eye(6)
        np.testing.assert_allclose(found.covariance, covariance, atol=1e-18)


def test_the_state_has_base_offsets_and_two_springs_of_each_robot(poses):
    assert len(poses.robot_state) == 2 * (6 + 5 + 2)
    variances = np.diag(poses.covariance)
    assert variances[11:13] == pytest.approx(0.2**2 / 3)
    assert variances[24:26] == pytest.approx(0.2**2 / 3)
    assert len(PoseState((Vehicle.from_mount("mast", vehicle().T_world_base),)).robot_state) == 11


def test_two_measured_cameras_tell_how_soft_the_springs_are(poses):
    """A fifth softer in roll, a tenth stiffer in pitch; encoders err by less than they may."""
    compliance = np.array([1.2, 0.9])
    soft = vehicle().with_compliance(compliance)
    for reading in (ASIDE, AHEAD, -ASIDE * [1, -1, -1, 1, 1]):
        camera = poses.add(0, reading)
        measure(poses, camera, soft.camera_pose(reading))
    found, std = poses.robot_state[11:13], np.sqrt(np.diag(poses.covariance)[11:13])
    assert np.abs(found - (compliance - 1)).max() < 0.03
    assert (np.abs(found - (compliance - 1)) < 3 * std).all()
    assert std.max() < 0.05 < 0.115  # a third of what was known before
    # the next prediction has them, and those of the other robot are not touched
    there = np.array([0.8, 0.7, 0.1, 0.3, 0.0])
    before = displacement_between(vehicle().camera_pose(there), soft.camera_pose(there))
    after = displacement_between(poses.predict(0, there).pose, soft.camera_pose(there))
    assert np.linalg.norm(after[:3]) < np.linalg.norm(before[:3]) / 2
    assert not poses.robot_state[24:26].any()


def test_no_measurement_makes_a_spring_negative_or_a_hundred_times_softer(poses):
    """A linear update of compliances by -1.5 and 90; the next prediction is a pose."""
    springs, A = np.array([11, 12]), 1e12 * np.eye(2)
    poses.update(springs, A, A @ [-1.5, 90.0])
    assert (1.0 + poses.robot_state[springs]).tolist() == pytest.approx(COMPLIANCE_BOUNDS)
    wanted = vehicle().with_compliance(np.array(COMPLIANCE_BOUNDS)).camera_pose(ASIDE)
    found = poses.predict(0, ASIDE).pose
    np.testing.assert_allclose(found.translation, wanted.translation, atol=1e-12)


# histories


def past(poses, robot, reading, is_final=False):
    return PastScan(robot, reading, poses.predict(robot, reading), is_final)


def test_poses_of_a_history_follow_what_is_measured_later(poses):
    history = PoseHistory(poses)
    poses.add(0, ASIDE)
    history.add(past(poses, 0, ASIDE), is_keyframe=True)
    history.add(past(poses, 0, AHEAD), is_keyframe=False)
    history.add(past(poses, 0, HOME, is_final=True), is_keyframe=False)
    first = history.estimates()
    camera = poses.add(0, AHEAD)
    history.add(past(poses, 0, AHEAD), is_keyframe=True)
    measure(poses, camera, vehicle().with_compliance(np.array([1.2, 0.9])).camera_pose(AHEAD))
    keyframe, predicted, final, new = history.estimates()
    assert len(history) == 4
    np.testing.assert_array_equal(keyframe.covariance, poses.estimate(0).covariance)
    assert np.trace(keyframe.covariance) < np.trace(first[0].covariance)
    np.testing.assert_array_equal(predicted.covariance, poses.predict(0, AHEAD).covariance)
    assert np.abs(displacement_between(predicted.pose, first[1].pose)).max() > 1e-4
    assert final is first[2]
    np.testing.assert_array_equal(new.covariance, poses.estimate(1).covariance)


def test_a_camera_that_leaves_the_state_keeps_its_pose(poses):
    history = PoseHistory(poses)
    for reading in (ASIDE, AHEAD):
        poses.add(0, reading)
        history.add(past(poses, 0, reading), is_keyframe=True)
    history.finish_oldest_keyframe()
    last = history.estimates()[0]
    poses.remove_camera(0)
    measure(poses, 0, vehicle().camera_pose(AHEAD + 0.002))
    kept, moved = history.estimates()
    assert kept is last
    np.testing.assert_array_equal(moved.covariance, poses.estimate(0).covariance)


def test_a_prediction_again_is_the_posterior_of_a_camera_that_was_never_measured(poses):
    """To leave a camera out and predict it later is the same as to keep it in the state."""
    kept = poses.add(0, AHEAD)
    measured = poses.add(0, ASIDE)
    true = vehicle().with_compliance(np.array([1.1, 1.05])).camera_pose(ASIDE + 0.002)
    measure(poses, measured, true)
    wanted, found = poses.estimate(kept), poses.predict(0, AHEAD)
    # to first order: the state moved by some mm and mrad
    off = displacement_between(wanted.pose, found.pose)
    assert np.abs(off).max() < 1e-4
    np.testing.assert_allclose(found.covariance, wanted.covariance, rtol=0.02, atol=2e-8)
