"""Every entry of an observation in the field, index by index, against the belief."""

import math
from dataclasses import replace

import numpy as np
import pytest
from plain.rollouts import MODES, random_actions

from coopmap_env.envs.field import FieldEnv, FieldSettings
from coopmap_env.envs.field.observations import N_POSE_AND_RATING_FEATURES, camera_vector
from coopmap_env.evaluation import make_policy
from coopmap_env.geometry import Pose

pytest.importorskip("pybullet")

SETTINGS = FieldSettings(crop_cells=(12, 8))


def base(x, y, heading):
    c, s = math.cos(heading), math.sin(heading)
    return Pose(np.array([x, y, 0.0]), np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]))


def test_a_camera_ahead_of_a_turned_base_by_hand():
    # the base faces +y; the camera is 3 m ahead, 1.5 m to the left and 1.2 m up, its axis along
    # the base's left (-x) and is upright
    R = np.array([[-1.0, 0, 0], [0, -1, 0], [0, 0, 1]])
    camera = Pose(np.array([1.0 - 1.5, 2.0 + 3.0, 1.2]), R)
    vector = camera_vector(camera, base(1.0, 2.0, math.pi / 2), 6.0)
    np.testing.assert_allclose(vector, [0.5, 0.25, 0.2, 0, 1, 0, 0, 0, 1], atol=1e-7)


def test_far_positions_are_clipped():
    far = Pose(np.array([20.0, 0.0, 0.0]), np.eye(3))
    assert camera_vector(far, base(0, 0, 0), 6.0)[0] == 1.0


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize(("n_robots", "views"), [(1, "exact"), (3, "coarse")])
def test_every_observation_lies_in_its_space_and_agrees_with_the_belief(mode, n_robots, views):
    settings = replace(SETTINGS, candidate_views=views)
    env = FieldEnv(
        n_robots=n_robots, action_mode=mode, n_candidates=5, max_scans=3, settings=settings
    )
    observations, _ = env.reset(seed=1)
    rng = np.random.default_rng(0)
    diagonal = math.hypot(12.8, 12.8, 4.0)
    while True:
        belief = env.belief()
        for robot, agent in enumerate(belief.agents):
            observation = observations[agent]
            assert env.observation_space(agent).contains(observation)
            chain, q = belief.vehicles[robot].chain, belief.joints[robot]
            share = 2 * (q - chain.lower) / (chain.upper - chain.lower) - 1
            np.testing.assert_allclose(observation["joints"], np.clip(share, -1, 1), atol=1e-6)
            own, home = belief.estimates[robot].pose, belief.vehicles[robot].T_world_base
            np.testing.assert_array_equal(observation["camera"], camera_vector(own, home, 6.0))
            others = [o for o in range(n_robots) if o != robot]
            assert ("teammates" in observation) == bool(others)
            for row, other in enumerate(others):
                expected = camera_vector(belief.estimates[other].pose, home, diagonal)
                np.testing.assert_array_equal(observation["teammates"][row], expected)
            if mode == "candidates":
                rating_belief = replace(belief, coarse=views == "coarse")
                check_candidates(rating_belief, robot, observation)
        if not env.agents:
            break
        observations, *_ = env.step(random_actions(env, rng))
    env.close()


def check_candidates(belief, robot, observation):
    """The candidate table of one robot."""
    candidates, table = belief.candidates[robot], observation["candidates"]
    n = belief.joint_spaces[robot].n
    assert table.shape == (5, n + N_POSE_AND_RATING_FEATURES)
    np.testing.assert_array_equal(observation["action_mask"], np.arange(5) < len(candidates))
    assert not table[len(candidates) :].any()
    rated, scale = (
        belief.rate(robot, candidates),
        math.log(belief.rating_function.settings.n_gray_bins),
    )
    vehicle = belief.vehicles[robot]
    for k, q in enumerate(candidates):
        row = table[k]
        np.testing.assert_array_equal(row[:n], belief.joint_spaces[robot].normalize(q))
        camera = camera_vector(vehicle.camera_pose(q), vehicle.T_world_base, 6.0)
        np.testing.assert_allclose(row[n : n + 6], camera[:6], atol=1e-6)
        expected = [
            rated.new_information[k] / scale,
            rated.motion_cost[k] / scale,
            rated.occupancy[k],
            rated.rating[k] / scale,
            belief.unknown_fraction(robot, candidates[k : k + 1])[0],
        ]
        np.testing.assert_allclose(row[n + 6 :], expected, atol=1e-6)
        d = np.linalg.norm(q - belief.joints[robot])
        assert row[n + 7] == pytest.approx(belief.rating_function.settings.K * d / scale, abs=1e-6)


def test_coarse_views_of_candidates_rank_them_as_exact_views_do():
    env = FieldEnv(action_mode="candidates", n_candidates=32, max_scans=6)
    observations, _ = env.reset(seed=0)
    rng, scale = np.random.default_rng(0), math.log(env.settings.rating.n_gray_bins)
    errors, unknown_errors, ranks = [], [], []
    while env.agents:
        observations, *_ = env.step(random_actions(env, rng))
        belief = env.belief()
        for robot, agent in enumerate(belief.agents):
            candidates, n = belief.candidates[robot], belief.joint_spaces[robot].n
            exact, unknown = belief.rate_with_unknown_fraction(robot, candidates)
            table = observations[agent]["candidates"][: len(candidates)]
            errors.append(table[:, n + 6] - exact.new_information / scale)
            unknown_errors.append(table[:, n + 10] - unknown)
            order = np.argsort(-table[:, n + 9], kind="stable").tolist()
            ranks.append(order.index(int(exact.rating.argmax())))
    # six episodes of 16 scans: 0.014 and 0.009; the best one is the first in 94 %, and always among
    # the first three
    assert np.sqrt(np.mean(np.concatenate(errors) ** 2)) < 0.02
    assert np.sqrt(np.mean(np.concatenate(unknown_errors) ** 2)) < 0.02
    assert np.mean(np.array(ranks) < 3) > 0.9
    env.close()


def test_the_state_holds_the_crop_around_the_target_all_joints_and_all_cameras():
    env = FieldEnv(n_robots=2, max_scans=2, settings=SETTINGS)
    env.reset(seed=0)
    env.step(random_actions(env, np.random.default_rng(0)))
    belief = env.belief()
    # 0.05 m ahead and to the left of the target's origin, 1.05 m above the bottom of the map
    belief.map.mark_occupied([belief.map.grid.flat_index([64, 64, 10])])
    state = env.state()
    assert env.state_space.contains(state)
    side, height = SETTINGS.crop_cells
    crop = state[: 2 * height * side * side].reshape(2 * height, side, side)
    assert 0.0 <= crop.min() <= crop.max() <= 1.0
    joints, cameras = np.split(state[crop.size :], [10])
    for robot in range(2):
        own = belief.joint_spaces[robot].normalize(belief.joints[robot])
        np.testing.assert_array_equal(joints[5 * robot : 5 * robot + 5], own)
        camera = belief.estimates[robot].pose
        diagonal = math.hypot(12.8, 12.8, 4.0)
        expected = camera.translation / diagonal
        np.testing.assert_allclose(cameras[9 * robot : 9 * robot + 3], expected, atol=1e-6)
    assert crop[5, 6, 6] == 1.0
    assert crop[height + 5, 6, 6] >= np.float32(31 / 255)  # an eighth of the cell at least
    env.close()


def test_the_map_is_drawn_around_the_base_it_belongs_to():
    env = FieldEnv(n_robots=2, max_scans=1, settings=SETTINGS)
    observations, _ = env.reset(seed=0)
    _, height = SETTINGS.crop_cells
    for agent in env.possible_agents:
        sampled = observations[agent]["map"][height:]
        # the parking room, 1 m around the axis, is all that is known: the middle of the crop
        assert sampled[3, 6, 6] == 255
        assert sampled[3, 0, 0] == 0
        assert observations[agent]["map"][0, 0, 0] == 128
    env.close()


def played(policy_spec, **settings):
    env = FieldEnv(action_mode="candidates", max_scans=3, settings=replace(SETTINGS, **settings))
    policy = make_policy(policy_spec)
    observations, _ = env.reset(seed=1)
    policy.reset(np.random.default_rng(0))
    rewards = []
    while env.agents:
        observations, reward, *_ = env.step(policy.act(env.belief(), observations))
        rewards += reward.values()
    return rewards, env.belief().map.log_odds_fixed.tobytes()


@pytest.mark.parametrize("spec", ["rating_function", "coverage", "information_gain", "frontier"])
def test_planners_do_not_depend_on_how_the_observed_candidates_are_rated(spec):
    # so records of planners hold for coarse and exact observed views alike
    assert played(spec, candidate_views="coarse") == played(spec, candidate_views="exact")
