"""Actions that are none: refused by name, and the environment is as it was before."""

import numpy as np
import pytest
from plain.fuzz import cases
from plain.odd_values import Hostile, odd_values
from plain.rollouts import MODES, env_trajectory_hash, sample_action, trajectory_hash

from coopmap_env.envs import InvalidActionError
from coopmap_env.envs.field import FieldEnv, FieldSettings
from coopmap_env.envs.planar import PlanarEnv, PlanarSettings, PlanarTeamEnv
from coopmap_env.sensing import DepthCamera
from coopmap_env.simulation.scenes.planar import Obstacles

SCENE = Obstacles(shape=(40, 40))
PLANAR = {"scene": SCENE, "settings": PlanarSettings(crop_cells=8), "n_candidates": 6}
FIELD = {
    "settings": FieldSettings(crop_cells=(8, 4), camera=DepthCamera(width=16, height=12)),
    "n_candidates": 4,
}
INDICES = (np.int8, np.ndarray)
"""Types of those odd values that are a candidate's index."""


def no_actions(mode):
    """Values that are an action of neither three joints nor a pose, or no index."""
    values = odd_values()
    if mode == "pose":
        return values
    return [v for v in values if not isinstance(v, int) and not is_index(v)]


def is_index(value):
    return isinstance(value, INDICES) and np.ndim(value) == 0 and value.dtype.kind == "i"


def expect_refusal(env, actions, message="action"):
    with pytest.raises(InvalidActionError, match=message) as raised:
        env.step(actions)
    assert len(str(raised.value)) < 2_000


@pytest.mark.parametrize("mode", MODES)
def test_what_is_no_action_is_refused_by_the_name_of_its_robot_and_changes_nothing(mode):
    arguments = {**PLANAR, "action_mode": mode, "max_scans": 3}

    def before_step(env):
        good = {agent: env.action_space(agent).low * 0 if mode == "pose" else 0
                for agent in env.agents}  # fmt: skip
        for value in no_actions(mode):
            expect_refusal(env, {**good, "robot_1": value}, "robot_1")

    expected = env_trajectory_hash(arguments, 5)
    assert trajectory_hash(PlanarEnv(**arguments), 5, before_step) == expected


def test_what_is_no_set_of_actions_is_refused_and_changes_nothing():
    class Broken(dict):
        def __getitem__(self, key):
            raise KeyError(key)

    good = np.zeros(3, np.float32)
    sets = [
        *odd_values(),
        {"robot_0": good},
        {"robot_0": good, "robot_1": good, "robot_2": good},
        {"robot_0": good, b"robot_1": good},
        {"robot_0": good, Hostile(): good},
        {0: good, 1: good},
        Broken(robot_0=good, robot_1=good),
        [good, good],
        {"robot_0": {"robot_1": good}},
        {"x" * 1_000_000: good},
        dict.fromkeys(map(str, range(10_000)), good),
    ]

    def before_step(env):
        for actions in sets:
            expect_refusal(env, actions)

    expected = env_trajectory_hash(PLANAR, 5)
    assert trajectory_hash(PlanarEnv(**PLANAR), 5, before_step) == expected


def test_field_joints_that_are_none_are_refused_and_change_nothing():
    pytest.importorskip("pybullet")
    arguments = {**FIELD, "max_scans": 2}

    def before_step(env):
        good = {agent: np.zeros(env.action_space(agent).shape) for agent in env.agents}
        for value in odd_values():
            expect_refusal(env, {**good, "robot_1": value}, "robot_1")

    expected = env_trajectory_hash(arguments, 3, FieldEnv)
    env = FieldEnv(**arguments)
    try:
        assert trajectory_hash(env, 3, before_step) == expected
    finally:
        env.close()


@pytest.mark.parametrize("mode", MODES)
def test_the_team_refuses_what_is_no_action(mode):
    env = PlanarTeamEnv(**PLANAR, action_mode=mode)
    env.reset(seed=0)
    before = env.parallel.state().tobytes()
    shape = env.action_space.shape
    for value in [*odd_values(), [True] * shape[0], ["0"] * shape[0], [10**400] * shape[0]]:
        expect_refusal(env, value)
    assert env.parallel.state().tobytes() == before


def random_pose(size, rng):
    """Numbers in and around [-1, 1], of several types, sometimes with a wrong value or shape."""
    pose = rng.uniform(-1.0, 1.0, size).astype(rng.choice([np.float16, np.float32, np.float64]))
    kind = rng.integers(8)
    if kind == 0:
        pose = np.round(pose).astype(rng.choice([np.int8, np.int64]))
    elif kind == 1:
        pose[rng.integers(size)] = rng.choice([np.nan, np.inf, 1.01, -3.0, 1e4])
    elif kind == 2:
        pose = pose[: rng.integers(size + 1)]
    elif kind == 3:
        pose = pose.tolist()
    elif kind == 4:
        pose = np.sign(pose)  # the corners of the space
    return pose


def play_random(env, n_steps, rng):
    """Steps with random actions; every observation lies in its space. Counts what is refused."""
    refused = 0
    for _ in range(n_steps):
        if not env.agents:
            observations, _ = env.reset(seed=int(rng.integers(100)))
        actions = {}
        for agent in env.agents:
            space = env.action_space(agent)
            is_index = hasattr(space, "n")
            wrong = rng.integers(-2, space.n + 2) if is_index else random_pose(space.shape[0], rng)
            actions[agent] = sample_action(space, rng) if rng.random() < 0.3 else wrong
        state = env.state().tobytes()
        try:
            observations, rewards, *_ = env.step(actions)
        except InvalidActionError:
            refused += 1
            assert env.state().tobytes() == state
            continue
        for agent, observation in observations.items():
            assert env.observation_space(agent).contains(observation)
            assert np.isfinite(rewards[agent])
        assert env.state_space.contains(env.state())
    return refused


@pytest.mark.parametrize("mode", MODES)
@cases(short=1_000, long=36_000)
def test_every_observation_of_a_planar_episode_lies_in_its_space(n_cases, mode):
    env = PlanarEnv(**PLANAR, action_mode=mode, max_scans=8)
    assert 0 < play_random(env, n_cases, np.random.default_rng(1)) < n_cases


@pytest.mark.parametrize("mode", MODES)
@cases(short=40, long=6_000)
def test_every_observation_of_a_field_episode_lies_in_its_space(n_cases, mode):
    pytest.importorskip("pybullet")
    env = FieldEnv(**FIELD, action_mode=mode, max_scans=8)
    try:
        assert 0 < play_random(env, n_cases, np.random.default_rng(1)) < n_cases
    finally:
        env.close()
