"""What an action does in the field: motion, refusal, contact, cost, and what the map learns."""

from dataclasses import replace

import numpy as np
import pytest
from plain.rollouts import random_actions
from scipy.spatial.transform import Rotation

from coopmap_env.envs import InvalidActionError, RejectedReason
from coopmap_env.envs.field import FieldEnv, FieldSettings
from coopmap_env.information import ViewContext
from coopmap_env.mapping import VoxelGrid
from coopmap_env.simulation.scenes.field import FieldWorld, Worksite, box_corners, solid_from_boxes

pytest.importorskip("pybullet")

FAST = FieldSettings(crop_cells=(8, 4))
TURNS = ("turntable", "wrist_pan", "wrist_tilt")


@pytest.fixture
def make():
    made = []

    def make(**arguments):
        env = FieldEnv(**{"settings": FAST, "max_scans": 4} | arguments)
        made.append(env)
        return env

    yield make
    for env in made:
        env.close()


class Crated(Worksite):
    """The worksite with a crate beside the first vehicle's mast that nobody knows of."""

    def world(self, rng, n_robots, footprint=1.2):
        world = super().world(rng, n_robots, footprint)
        base = world.base_poses[0]
        center = base.transform([0.0, 0.9, 1.55])
        crate = solid_from_boxes("crate in the way", [box_corners([0.5, 0.5, 0.9], center)])
        return FieldWorld(
            world.name, (*world.solids, crate), world.target, world.grid, world.base_poses
        )


def staying(env):
    """Actions that lead every mount to where it is."""
    belief = env.belief()
    return {
        agent: belief.joint_spaces[robot].normalize(belief.joints[robot])
        for robot, agent in enumerate(env.agents)
    }


def test_an_action_moves_every_joint_to_that_fraction_of_its_limits(make):
    mount = exact_mount()
    env = make(n_robots=1, mount=mount)
    env.reset(seed=0)
    belief = env.belief()
    q = np.array(mount.home)
    q[0] += 0.5
    chain = belief.vehicles[0].chain
    action = 2 * (q - chain.lower) / (chain.upper - chain.lower) - 1
    _, _, _, _, infos = env.step({"robot_0": action.astype(np.float32)})
    assert infos["robot_0"]["rejected_reason"] == RejectedReason.NONE
    np.testing.assert_allclose(env.belief().joints[0], q, atol=1e-6)


def exact_mount():
    from coopmap_env.robots import make_mount

    return replace(make_mount("mast"), encoder_noise=0.0, calibration_error=0.0)


def test_encoders_read_the_target_and_the_truth_differs_by_noise_and_suspension(make):
    env = make(n_robots=2)
    env.reset(seed=1)
    rng = np.random.default_rng(0)
    targets = [env.belief().random_poses(robot, 1, rng)[0] for robot in range(2)]
    actions = {
        agent: env.belief().action_for(robot, targets[robot])
        for robot, agent in enumerate(env.agents)
    }
    *_, infos = env.step(actions)
    for robot, agent in enumerate(env.agents):
        assert infos[agent]["rejected_reason"] == RejectedReason.NONE
        np.testing.assert_allclose(env.belief().joints[robot], targets[robot], atol=1e-9)
        assert 1e-4 < infos[agent]["camera_error"] < 0.1


def test_a_pose_in_unknown_space_is_rejected_with_link_and_reason_and_the_mount_stays(make):
    env = make(n_robots=1, settings=replace(FAST, initial_free_radius=0.45))
    env.reset(seed=0)
    before = env.belief().joints[0].copy()
    reach = np.array([0.0, 1.4, 0.2, 0.0, 0.0])  # the arm stretched out ahead
    belief = env.belief()
    action = belief.joint_spaces[0].normalize(reach)
    assert "would touch unknown space" in belief.infeasibility_reason(
        0, belief.joint_spaces[0].denormalize(action)
    )
    *_, infos = env.step({"robot_0": action})
    assert infos["robot_0"]["rejected_reason"] == RejectedReason.TOUCHES_MAP
    words = env.explain("robot_0")["rejected_reason"]
    assert words.startswith("link ")
    assert "unknown space" in words
    assert infos["robot_0"]["distance"] == 0.0
    np.testing.assert_array_equal(env.belief().joints[0], before)


def test_candidates_and_random_poses_are_feasible_and_are_decoded_bit_for_bit(make):
    env = make(n_robots=2, action_mode="candidates", n_candidates=6)
    observations, _ = env.reset(seed=3)
    while env.agents:
        belief = env.belief()
        for robot, agent in enumerate(env.agents):
            candidates = belief.candidates[robot]
            assert observations[agent]["action_mask"].sum() == len(candidates) == 6
            assert belief.reachability.collision_free(robot, candidates).all()
            for k, q in enumerate(candidates):
                assert belief.infeasibility_reason(robot, q) == ""
                assert belief.action_for(robot, q) == k
        observations, *_, infos = env.step(dict.fromkeys(env.agents, 2))
        assert not any(info["rejected_reason"] for info in infos.values())


def test_what_the_map_did_not_know_stops_the_mount_is_reported_and_charged(make):
    blind = replace(FAST, initial_free_radius=2.0)  # the space all around is mapped as free
    env = make(n_robots=1, mount=exact_mount(), scene=Crated(), settings=blind)
    env.reset(seed=0)
    belief = env.belief()
    swing = np.array([1.57, 1.2, 0.4, 0.0, 0.0])  # the arm swung out to the left
    swing = belief.joint_spaces[0].denormalize(belief.joint_spaces[0].normalize(swing))
    assert belief.infeasibility_reason(0, swing) == ""
    _, rewards, _, _, infos = env.step({"robot_0": belief.action_for(0, swing)})
    info = infos["robot_0"]
    assert info["collided"]
    assert env.explain("robot_0")["collided"] == "crate in the way"
    assert np.abs(env.belief().joints[0] - swing).max() > 0.1
    free = info["new_information"] - FAST.rating.K * info["distance"]
    p = env.belief().rating_function.occupancy(belief.map, env.belief().positions)
    assert rewards["robot_0"] < free  # charged on top of the motion
    assert p.shape == (1,)
    while env.agents:  # nothing breaks
        env.step(staying(env))


def test_the_rating_reward_is_eq_9_of_where_the_cameras_went_on_the_map_before(make):
    env = make(n_robots=3)
    env.reset(seed=2)
    rng = np.random.default_rng(0)
    while env.agents:
        belief, agents = env.belief(), list(env.agents)
        before = belief.map.copy()
        joints, bodies = belief.joints, [belief.occluder_spheres(robot) for robot in range(3)]
        _, rewards, _, _, infos = env.step(random_actions(env, rng))
        reserved_mask = np.zeros(before.grid.n_cells, dtype=np.uint8)
        for robot, agent in enumerate(agents):
            q = env.belief().joints[robot]
            R, t = belief.vehicles[robot].camera_poses(q[None])
            d = np.sqrt(((q - joints[robot]) ** 2).sum())
            context = ViewContext(reserved_mask, bodies[robot])
            rated = belief.rating_function.rate(before, (R, t), [d], context)
            assert infos[agent]["distance"] == pytest.approx(d)
            expected = rated.rating[0]
            if infos[agent]["collided"]:
                expected -= FAST.collision_cost * np.log(FAST.rating.n_gray_bins)
            assert rewards[agent] == pytest.approx(expected, abs=1e-9)
            reserved_mask[belief.rating_function.visible_cells(before, (R[0], t[0]), context)] = 1


class NothingButTheTarget(Worksite):
    """A small target in the air; no ground, so that all else in a map is a robot."""

    def world(self, rng, n_robots, footprint=1.2):
        world = super().world(rng, n_robots, footprint)
        cube = solid_from_boxes("cube", [box_corners([0.4, 0.4, 0.4], [0, 0, 1.0])], is_target=True)
        return FieldWorld(world.name, (cube,), "cube", world.grid, world.base_poses)


@pytest.mark.parametrize(("mount", "n_robots"), [("mast", 2), ("mast", 5), ("tiago", 3)])
def test_robots_scan_each_other_and_never_enter_the_map(make, mount, n_robots):
    if mount == "tiago":
        pytest.importorskip("cmeel")
    env = make(mount=mount, n_robots=n_robots, max_scans=6, scene=NothingButTheTarget())
    seen = 0
    for seed in range(3):
        env.reset(seed=seed)
        rng = np.random.default_rng(seed)
        while env.agents:
            belief = env.belief()
            actions = {
                agent: belief.action_for(robot, most_at_teammates(belief, robot, rng))
                for robot, agent in enumerate(env.agents)
            }
            env.step(actions)
            for scan in env.last_scans:  # beams that a robot cut off end before the depth of field
                lengths = np.linalg.norm(scan.points - scan.origin, axis=1)
                seen += int((~scan.hit & (lengths < 5.9) & (lengths > 0)).sum())
        map_ = env.belief().map
        (cells,) = np.nonzero((map_.log_odds_fixed > 0) & (map_.sampled_mask == 1))
        centers = map_.grid.center(np.stack(np.unravel_index(cells, map_.grid.shape), axis=-1))
        assert (np.abs(centers - [0, 0, 1.0]).max(axis=1, initial=0.0) < 0.5).all()
    assert seen > 100


def most_at_teammates(belief, robot, rng):
    """Of some feasible poses the one whose optical axis is closest to a teammate."""
    poses = belief.random_poses(robot, 40, rng)
    R, t = belief.vehicles[robot].camera_poses(poses)
    others = np.delete(belief.positions, robot, axis=0)
    to_others = others[None] - t[:, None]
    to_others /= np.linalg.norm(to_others, axis=-1, keepdims=True)
    return poses[np.argmax((to_others * R[:, None, :, 0]).sum(-1).max(-1))]


@pytest.mark.parametrize("m", [1, 7, 40])
def test_random_poses_are_the_first_feasible_ones_of_those_drawn(make, m):
    env = make(n_robots=2, mount=["mast", "husky_panda"])
    env.reset(seed=2)
    env.step(random_actions(env, np.random.default_rng(0)))
    belief = env.belief()
    for robot in range(2):
        rng, same = np.random.default_rng(m), np.random.default_rng(m)
        poses = belief.random_poses(robot, m, rng)
        drawn = np.empty((0, belief.joint_spaces[robot].n))
        while len(drawn) < m:
            some = belief.joint_spaces[robot].sample(max(m, 16), same)
            drawn = np.concatenate([drawn, some[belief.reachability.collision_free(robot, some)]])
        np.testing.assert_array_equal(poses, drawn[:m])
        assert rng.bit_generator.state == same.bit_generator.state


def test_only_exact_poses_have_no_error(make):
    for estimate in ("exact", "kinematic"):
        env = make(max_scans=8, motion_correction=estimate)
        env.reset(seed=4)
        rng = np.random.default_rng(0)
        while env.agents:
            *_, infos = env.step(random_actions(env, rng))
            errors = [info["camera_error"] for info in infos.values()]
            assert all(e == 0.0 for e in errors) == (estimate == "exact")


@pytest.mark.parametrize("mount", ["mast", "husky_panda", "tiago"])
def test_the_estimated_covariance_of_the_camera_is_that_of_its_errors(make, mount):
    """The mean squared error in units of the estimated covariance, over calibrations and poses.

    Normal errors of 48 independent episodes would lie within 20 % of one in the mean of the six
    axes; those of the suspension are not normal, and poses near the limits lean more than others.
    """
    if mount == "tiago":
        pytest.importorskip("cmeel")
    env = make(mount=mount, n_robots=2, max_scans=1)
    rng, ratios = np.random.default_rng(0), []
    for seed in range(24):
        env.reset(seed=seed)
        env.step(random_actions(env, rng))
        for robot, (pose, covariance) in enumerate(env.belief().estimates):
            true = env._simulator.true_camera_pose(robot)
            error = np.concatenate([
                true.translation - pose.translation,
                Rotation.from_matrix(true.rotation @ pose.rotation.T).as_rotvec(),
            ])  # fmt: skip
            ratios.append(error**2 / np.diag(covariance))
    assert 0.6 < np.mean(ratios) < 1.5


def test_the_covariance_of_the_pose_enters_that_of_every_observed_point(make):
    sure, unsure = (
        make(n_robots=1, motion_correction=estimate) for estimate in ("exact", "kinematic")
    )
    traces = []
    for env in (sure, unsure):
        env.reset(seed=0)
        env.step(staying(env))
        (scan,) = env.last_scans
        traces.append(np.trace(scan.covariances[scan.hit], axis1=1, axis2=2))
    assert traces[0].mean() < traces[1].mean()


def test_ompl_plans_a_path_where_the_straight_motion_is_blocked(make):
    pytest.importorskip("ompl")
    tight = replace(FAST, initial_free_radius=0.45)
    plain = make(n_robots=1, max_scans=1, settings=tight)
    around = make(n_robots=1, max_scans=1, settings=replace(tight, motion_planner="ompl"))
    found = 0
    for seed in range(2):
        plain.reset(seed=seed)
        around.reset(seed=seed)
        belief, other = plain.belief(), around.belief()
        poses = belief.joint_spaces[0].sample(200, np.random.default_rng(seed))
        blocked = poses[
            ~belief.reachability.collision_free(0, poses)
            & belief.reachability.collision_checker(0).are_poses_free(poses)
        ]
        for q in blocked[:10]:
            if other.infeasibility_reason(0, q) == "":
                found += 1
                *_, infos = around.step({"robot_0": other.action_for(0, q)})
                assert infos["robot_0"]["rejected_reason"] == RejectedReason.NONE
                np.testing.assert_allclose(around.belief().joints[0], q, atol=0.02)
                break
    assert found


@pytest.mark.parametrize(
    ("action", "message"),
    [
        ([0.0] * 4, r"robot_1: .* 5 numbers \[turntable, shoulder"),
        ([0.0, np.nan, 0.0, 0.0, 0.0], r"robot_1: .* \[-1, 1\], got \[0.0, nan"),
        ([0.0, 0.0, 0.0, 0.0, 1.1], r"robot_1: .* \[-1, 1\]"),
        ("up", r"robot_1: .* got 'up'"),
    ],
)
def test_a_wrong_action_names_robot_and_value_and_leaves_the_environment_usable(
    make, action, message
):
    env = make()
    env.reset(seed=0)
    before = env.belief().map.log_odds_fixed.copy()
    with pytest.raises(InvalidActionError, match=message):
        env.step({"robot_0": np.zeros(5), "robot_1": action})
    np.testing.assert_array_equal(env.belief().map.log_odds_fixed, before)
    env.step(staying(env))


class OtherGrid(Worksite):
    """A scene that makes a world of another grid than it says."""

    def world(self, rng, n_robots, footprint=1.2):
        world = super().world(rng, n_robots, footprint)
        grid = VoxelGrid((64, 64, 20), 0.2, (-6.4, -6.4, -0.35))
        return FieldWorld(world.name, world.solids, world.target, grid, world.base_poses)


class OneTooFew(Worksite):
    """A scene that forgets one of the robots, but not in its first world."""

    worlds = 0

    def world(self, rng, n_robots, footprint=1.2):
        type(self).worlds += 1
        return super().world(rng, n_robots - (type(self).worlds > 1), footprint)


def test_a_world_of_another_grid_is_rejected(make):
    with pytest.raises(ValueError, match=r"made a world of VoxelGrid\(shape=\(64, 64, 20\)"):
        make(scene=OtherGrid()).reset(seed=0)


def test_an_episode_goes_on_after_a_reset_that_failed(make):
    env = make(scene=OneTooFew())
    env.reset(seed=0)
    with pytest.raises(ValueError, match="made room for 1 robots, not 2"):
        env.reset(seed=1)
    with pytest.raises(ValueError, match="seed"):
        env.reset(seed=-1)
    env.step(staying(env))


def test_a_closed_environment_raises_and_can_be_reset(make):
    env = make()
    env.reset(seed=0)
    actions = staying(env)
    env.close()
    env.close()
    for use in (lambda: env.step(actions), lambda: env.truth):
        with pytest.raises(RuntimeError, match="the environment is closed: call reset"):
            use()
    env.reset(seed=0)
    env.step(actions)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"mount": "crane"}, "unknown mount 'crane'"),
        ({"mount": ["mast"]}, "one for each of 2 robots, got 1"),
        ({"mount": None}, "unknown mount None"),
        ({"scene": "moon"}, "'moon'"),
        ({"settings": 3}, "settings must be FieldSettings or None, got 3"),
        ({"split": "exam"}, "exam"),
    ],
)
def test_wrong_arguments_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        FieldEnv(**arguments)


def test_wrong_settings_are_named():
    for changes, message in (
        ({"physics": "real"}, "FieldSettings.physics must be one of 'kinematic', 'stepped'"),
        ({"collision_cost": -1.0}, "collision_cost must be a finite number >= 0, got -1.0"),
        ({"crop_cells": (40,)}, r"crop_cells must be \(an integer >= 4, an integer >= 4\), got"),
        ({"crop_pooling": 0}, "crop_pooling must be an integer >= 1, got 0"),
        (
            {"initial_free_radius": np.inf},
            "initial_free_radius must be a finite number > 0, got inf",
        ),
        ({"initial_free_radius": "a"}, "initial_free_radius must be a finite number > 0, got 'a'"),
        ({"collision_cost": None}, "collision_cost must be a finite number >= 0, got None"),
        ({"crop_cells": 5}, r"crop_cells must be \(.*\), got 5"),
        ({"noise": 3}, "FieldSettings.noise must be RangeNoise, got 3"),
        ({"motion": None}, "FieldSettings.motion must be CollisionSettings, got None"),
        ({"beam": "x"}, "FieldSettings.beam must be BeamModel, got 'x'"),
    ):
        with pytest.raises(ValueError, match=message):
            FieldSettings(**changes)
