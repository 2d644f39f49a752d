"""The field simulator: what encoders say and what is so, what cameras see, what stops a mount."""

import hashlib
import math
from dataclasses import replace

import numpy as np
import pytest
from plain.bullet_renderer import BulletRenderer
from plain.field_worlds import base_pose, cluttered_world, crate, flat_world

from coopmap_env.robots import make_mount
from coopmap_env.sensing import DepthCamera, RangeNoise
from coopmap_env.simulation import FieldSimulator
from coopmap_env.simulation.physics._joint_map import JointMap
from coopmap_env.simulation.scenes.field import make_field_scene

pytest.importorskip("pybullet")
pytest.importorskip("embreex")
EXACT = RangeNoise(intrinsic=0.0)
CAMERA = DepthCamera()
OUT = np.array([0.0, 0.8, 0.9, 0.0, 0.0])
BOTH = ("kinematic", "stepped")


@pytest.fixture(scope="module")
def mast():
    return make_mount("mast")


@pytest.fixture(scope="module")
def true_mast(mast):
    """Encoders without any error."""
    return replace(mast, encoder_noise=0.0, calibration_error=0.0)


def simulate(world, mount, physics="kinematic", noise=EXACT, seed=0, camera=CAMERA):
    mounts = [mount] * world.n_robots
    rng = np.random.default_rng(seed)
    return FieldSimulator(world, mounts, camera, noise, physics, rng)


def random_targets(mount, n_robots, k, seed):
    chain = mount.chain()
    shape = (k, n_robots, chain.n_joints)
    return np.random.default_rng(seed).uniform(chain.lower, chain.upper, shape)


@pytest.mark.parametrize("physics", BOTH)
def test_readings_are_the_targets_and_the_truth_differs(mast, physics):
    """By the offset and the noise of the encoders, 0.15 and 0.1 degrees: 0.18 together."""
    simulator = simulate(flat_world(bases=[base_pose(0, 0), base_pose(0, 4)]), mast, physics)
    rng = np.random.default_rng(1)
    errors = []
    chain = mast.chain()
    off_stops = np.clip(random_targets(mast, 2, 20, 2), chain.lower + 0.05, chain.upper - 0.05)
    for targets in off_stops:
        moved = simulator.move(list(targets), rng)
        for robot, (reading, touched) in enumerate(moved):
            assert touched == ""
            assert reading == pytest.approx(targets[robot], abs=1e-4)
            errors.append(simulator.true_joints(robot) - reading)
    spread = np.degrees(np.sqrt(np.mean(np.square(errors))))
    assert 0.1 < spread < 0.3
    lasting = np.mean(np.reshape(errors, (20, 2, 5)), axis=0)
    assert np.degrees(np.abs(lasting)).max() > 0.1  # twenty noises alone would average to 0.02
    changing = np.reshape(errors, (20, 2, 5)) - lasting
    assert np.degrees(changing.std()) == pytest.approx(0.1, rel=0.2)


def test_without_encoder_errors_the_joints_are_the_targets(true_mast):
    simulator = simulate(flat_world(), true_mast)
    assert simulator.true_joints(0).tolist() == list(true_mast.home)
    [(reading, _)] = simulator.move([OUT], np.random.default_rng(0))
    assert reading.tolist() == OUT.tolist() == simulator.true_joints(0).tolist()


def test_a_vehicle_begins_where_its_encoders_read_home(mast):
    simulator = simulate(flat_world(), mast)
    errors = simulator.true_joints(0) - mast.home
    assert 0.0 < np.degrees(np.abs(errors)).max() < 1.0
    another = simulate(flat_world(), mast, seed=1)
    assert (another.true_joints(0) != simulator.true_joints(0)).all()


def test_a_joint_goes_no_further_than_its_limit(mast):
    chain = mast.chain()
    simulator = simulate(flat_world(), mast)
    for physics in range(5):
        simulator.move([chain.upper * [1, 0.5, 0.5, 1, 1]], np.random.default_rng(physics))
        assert (simulator.true_joints(0) <= chain.upper).all()
    assert (simulator.true_joints(0) == chain.upper).any()


@pytest.mark.parametrize("physics", BOTH)
def test_none_lets_a_mount_stay(true_mast, physics):
    simulator = simulate(flat_world(bases=[base_pose(0, 0), base_pose(0, 4)]), true_mast, physics)
    before = simulator.true_joints(1).copy()
    moved = simulator.move([OUT, None], np.random.default_rng(0))
    assert simulator.true_joints(0) == pytest.approx(OUT, abs=1e-4)
    assert moved[1].measured_configuration == pytest.approx(before, abs=1e-4)


def test_the_camera_leans_with_its_body(true_mast):
    """Swung out to the left the body rolls; kinematics that know of it agree with the camera."""
    where = base_pose(1.0, -2.0, 0.7)
    simulator = simulate(flat_world(bases=[where]), true_mast)
    q = OUT + np.array([1.5, 0, 0, 0, 0])
    simulator.move([q], np.random.default_rng(0))
    s = simulator.deflections(0)
    assert math.radians(0.2) < -s[1] < math.radians(3)
    R, t = true_mast.chain(with_suspension=True).camera_poses(np.concatenate([s, q]))
    pose = simulator.true_camera_pose(0)
    assert pose.translation == pytest.approx(where.transform(t))
    assert pose.rotation == pytest.approx(where.rotation @ R)
    believed = where.transform(true_mast.chain().camera_poses(q)[1])
    assert 1e-3 < np.linalg.norm(believed - pose.translation) < 0.05


def test_a_vehicle_without_a_suspension_stands_fast(true_mast):
    rigid = replace(true_mast, suspension=None)
    for physics in BOTH:
        simulator = simulate(flat_world(), rigid, physics)
        simulator.move([OUT], np.random.default_rng(0))
        assert simulator.deflections(0).size == 0
        _, t = rigid.chain().camera_poses(OUT)
        assert simulator.true_camera_pose(0).translation == pytest.approx(t, abs=1e-4)


@pytest.mark.parametrize("physics", BOTH)
def test_a_crate_on_the_path_is_reported_and_the_encoders_read_where_the_mount_stopped(
    mast, physics
):
    simulator = simulate(flat_world(crate("crate", 1.0, 0.0, 1.65, 0.4)), mast, physics)
    rng = np.random.default_rng(0)
    simulator.move([np.array([0.0, -1.0, 1.9, 0.0, 0.0])], rng)
    [(reading, touched)] = simulator.move([OUT], rng)
    assert touched == "crate"
    assert reading[1] < 0.7
    assert np.degrees(np.abs(reading - simulator.true_joints(0))).max() < 1.0


def test_two_arms_that_reach_for_each_other_are_reported(mast):
    world = flat_world(bases=[base_pose(-0.9, 0), base_pose(0.9, 0, math.pi)])
    moved = simulate(world, mast, "stepped").move([OUT, OUT], np.random.default_rng(0))
    assert [touched for _, touched in moved] == ["robot_1", "robot_0"]


def test_a_wall_is_measured_where_it_is(true_mast):
    """Level at home? The camera's own pose tells; a wall 3 m ahead ends every beam on x = 3."""
    simulator = simulate(flat_world(crate("wall", 3.5, 0.0, 2.0, (1.0, 12.0, 9.0))), true_mast)
    level = np.array([0.0, 0.0, math.pi / 4, 0.0, 0.0])  # pan axis upright
    simulator.move([level], np.random.default_rng(0))
    cloud = simulator.scan(0, np.random.default_rng(0))
    points = simulator.true_camera_pose(0).transform(cloud.points)
    on_wall = cloud.hit & (points[:, 2] > 0.01)
    assert on_wall.mean() > 0.8
    assert points[on_wall, 0] == pytest.approx(np.full(on_wall.sum(), 3.0), abs=1e-3)


def test_teammates_are_seen_and_the_own_housing_is_not(true_mast):
    """Two masts face each other, 2.5 m apart, and the scene is empty."""
    world = flat_world(bases=[base_pose(0, 0), base_pose(2.5, 0, math.pi)])
    simulator = simulate(world, true_mast)
    level = np.array([0.0, 0.0, math.pi / 4, 0.0, 0.4])
    simulator.move([level, level], np.random.default_rng(0))
    cloud = simulator.scan(0, np.random.default_rng(0))
    pose = simulator.true_camera_pose(0)
    points = pose.transform(cloud.points[cloud.hit])
    above_ground = points[points[:, 2] > 0.05]
    assert len(above_ground) > 30
    assert np.abs(above_ground[:, 0] - 2.0).max() < 1.2  # the other vehicle, nothing near
    alone = simulate(flat_world(), true_mast)
    alone.move([level], np.random.default_rng(0))
    cloud = alone.scan(0, np.random.default_rng(0))
    points = alone.true_camera_pose(0).transform(cloud.points[cloud.hit])
    assert np.abs(points[:, 2]).max() < 1e-3


def test_views_from_other_joints_are_what_is_measured_there(true_mast):
    """Where the mast moves to in fact, without noise; the teammate's arm can only be nearer."""
    bases = [base_pose(0, 0), base_pose(3.0, 0.5, math.pi)]
    simulator = simulate(cluttered_world(1, bases), true_mast)
    joints = random_targets(true_mast, 2, 12, 3)[:, 0]
    views, rng, n_equal = list(simulator.views_from(0, joints)), np.random.default_rng(0), 0
    np.testing.assert_array_equal(simulator.true_joints(0), true_mast.home)  # nothing has moved
    for q, (pose, distances) in zip(joints, views, strict=True):
        simulator.move([q, None], rng)
        cloud, camera = simulator.scan(0, rng), simulator.true_camera_pose(0)
        np.testing.assert_allclose(pose.translation, camera.translation, atol=1e-12)
        nearer = distances[cloud.hit] - np.linalg.norm(cloud.points[cloud.hit], axis=1)
        assert (nearer > -1e-9).all()
        n_equal += (nearer < 1e-9).all()
    assert n_equal >= 8


def test_a_camera_within_its_housing_sees_out_of_it(true_mast):
    """With its eye moved back into the head, the head itself is left out."""
    eye = replace(true_mast.T_link_camera, translation=np.array([-0.08, 0.0, 0.0]))
    inside = replace(true_mast, T_link_camera=eye)
    cloud = simulate(flat_world(), inside).scan(0, np.random.default_rng(0))
    assert np.linalg.norm(cloud.points[cloud.hit], axis=1).min() > 0.3
    assert (np.linalg.norm(cloud.points, axis=1) > 0.3).all()


@pytest.mark.parametrize("seed", [0, 1])
def test_pybullets_renderer_sees_the_same_images(true_mast, seed):
    """Embree and TinyRenderer on random poses of two robots in a worksite.

    Next to no pixel differs, but for one whose middle a silhouette passes through; half a pixel
    of difference in what a pixel is would be 9 % of them.
    """
    rng = np.random.default_rng(seed)
    world = make_field_scene("worksite").world(rng, 2)
    simulator = simulate(world, true_mast)
    mounts = [true_mast, true_mast]
    renderer = BulletRenderer(world.solids, mounts, world.base_poses)
    joint_map = JointMap.from_mount(true_mast)
    apart, errors = [], []
    for targets in random_targets(true_mast, 2, 6, seed):
        simulator.move(list(targets), rng)
        for robot in range(2):
            q = np.concatenate([simulator.deflections(robot), simulator.true_joints(robot)])
            renderer.set_joints(
                robot, joint_map.joints, joint_map.joint_matrix @ q + joint_map.joint_offsets
            )
        for robot in range(2):
            cloud = simulator.scan(robot, rng)
            there = np.linalg.norm(cloud.points, axis=1).reshape(48, 64)
            image = renderer.depth_image(CAMERA, simulator.true_camera_pose(robot))
            seen = image / CAMERA.directions[:, 0].reshape(48, 64)
            hit = cloud.hit.reshape(48, 64)
            seen = np.where((seen <= CAMERA.far), seen, np.inf)
            both = hit & np.isfinite(seen)
            difference = np.abs(np.where(both, seen - there, 0.0))
            too_near = there == 0.0
            wrong = ((hit != np.isfinite(seen)) | (difference > 0.02 + 0.01 * there)) & ~too_near
            apart.append(wrong.mean())
            errors.append(np.median(difference[both]) if both.any() else 0.0)
    simulator.close()
    renderer.close()
    assert np.mean(apart) < 0.002
    assert np.max(errors) < 1e-3


def fingerprint(seed, physics):
    mast = make_mount("mast")
    bases = [base_pose(-0.9, 0.0), base_pose(0.9, 0.0, math.pi)]
    world = cluttered_world(seed, bases, n=90, nearest=0.6)
    simulator = simulate(world, mast, physics, RangeNoise(), seed)
    rng = np.random.default_rng(seed)
    digest = hashlib.sha256()
    for targets in random_targets(mast, 2, 6, seed):
        for reading, touched in simulator.move(list(targets), rng):
            digest.update(reading.tobytes() + touched.encode())
        for robot in range(2):
            cloud = simulator.scan(robot, rng)
            digest.update(cloud.points.tobytes() + cloud.hit.tobytes())
    simulator.close()
    return digest.hexdigest()


@pytest.mark.parametrize("physics", BOTH)
def test_the_same_seed_gives_the_same_bits_after_other_episodes(physics):
    first = fingerprint(5, physics)
    assert fingerprint(6, physics) != first
    assert fingerprint(5, physics) == first


@pytest.mark.parametrize("n_robots", [2, 3, 5])
@pytest.mark.parametrize("physics", BOTH)
def test_two_three_and_five_robots_work_in_a_worksite(mast, physics, n_robots):
    rng = np.random.default_rng(n_robots)
    world = make_field_scene("worksite").world(rng, n_robots)
    simulator = simulate(world, mast, physics, RangeNoise())
    for targets in random_targets(mast, n_robots, 2, 0):
        moved = simulator.move(list(targets), rng)
        assert len(moved) == n_robots
        for robot in range(n_robots):
            assert simulator.scan(robot, rng).points.shape == (CAMERA.n_pixels, 3)
    simulator.close()


def test_mounts_may_differ(mast, true_mast):
    try:
        tiago = make_mount("tiago")
    except ImportError as error:
        pytest.skip(str(error))
    world = flat_world(bases=[base_pose(0, 0), base_pose(0, 3)])
    simulator = FieldSimulator(
        world, [mast, tiago], CAMERA, EXACT, "stepped", np.random.default_rng(0)
    )
    rng = np.random.default_rng(0)
    moved = simulator.move([OUT, np.array([0.2, 0.4, -0.3])], rng)
    assert [len(reading) for reading, _ in moved] == [5, 3]
    assert [touched for _, touched in moved] == ["", ""]


def test_motions_and_scans_draw_the_same_amount_of_randomness_whatever_happens(mast):
    """So that one robot's contact does not shift the noise of the next."""
    states = []
    for world in (flat_world(), flat_world(crate("crate", 1.0, 0.0, 1.65, 0.4))):
        for target in (OUT, None):
            rng = np.random.default_rng(0)
            simulator = simulate(world, mast)
            simulator.move([target], rng)
            simulator.scan(0, rng)
            states.append(rng.bit_generator.state)
    assert all(state == states[0] for state in states)


@pytest.mark.parametrize(
    ("targets", "message"),
    [
        ([], "0 targets for 1 mounts"),
        ([OUT + 5.0], "outside of its limits"),
        ([OUT * math.nan], "not finite"),
        ([OUT[:3]], "expected"),
    ],
)
def test_a_wrong_target_is_an_error_and_nothing_moves(true_mast, targets, message):
    simulator = simulate(flat_world(), true_mast)
    with pytest.raises(ValueError, match=message):
        simulator.move(targets, np.random.default_rng(0))
    assert simulator.true_joints(0).tolist() == list(true_mast.home)


def test_wrong_arguments_are_named(mast):
    with pytest.raises(ValueError, match="'kinematic', 'stepped', got 'magic'"):
        simulate(flat_world(), mast, "magic")
    world = flat_world(bases=[base_pose(0, 0), base_pose(0, 3)])
    with pytest.raises(ValueError, match="1 mounts for 2 base poses"):
        FieldSimulator(world, [mast], CAMERA, EXACT, "kinematic", np.random.default_rng(0))


def test_a_closed_simulator_says_so(mast):
    simulator = simulate(flat_world(), mast)
    simulator.close()
    simulator.close()
    with pytest.raises(RuntimeError, match="closed"):
        simulator.move([OUT], np.random.default_rng(0))
