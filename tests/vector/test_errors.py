"""Errors name the world, and leave the others as they were."""

import contextlib

import numpy as np
import pytest
from gymnasium import spaces
from plain.small_worlds import masked_world, small_world
from plain.toy_team import ConstantReward, HookedEnv

from coopmap_env.envs import InvalidActionError
from coopmap_env.vector import WorkerVectorEnv


def open_env(factory, n_envs=2, **arguments):
    return contextlib.closing(WorkerVectorEnv(factory, n_envs, **arguments))


BAD_CANDIDATES = [
    ([0, 0, 0, 300], r"world 1, robot_1: a candidate action must lie in 0 \.\.\. 299, got 300"),
    ([0, -1, 0, 0], "world 0, robot_1: .* got -1"),
    ([0.0, 0.0, 0.0, 0.0], "candidate actions are integers, got float64 numbers"),
    ([0, 0, 0], r"numbers of shape \(4,\), got those of shape \(3,\)"),
    (["0", "1", "2", "3"], r"numbers of shape \(4,\), got "),
    (None, r"numbers of shape \(4,\), got None"),
]


def test_a_bad_candidate_names_world_robot_and_value_and_moves_nothing():
    good = np.zeros(4, dtype=np.int64)
    with open_env(masked_world) as env, open_env(masked_world) as untouched:
        env.reset(seed=0)
        untouched.reset(seed=0)
        for actions, message in BAD_CANDIDATES:
            with pytest.raises(InvalidActionError, match=message):
                env.step(actions)
        ours, theirs = env.step(good), untouched.step(good)
        np.testing.assert_equal(ours, theirs)


@pytest.mark.parametrize("value", [1.5, np.nan, -np.inf])
@pytest.mark.parametrize("rows", ["agents", "teams"])
def test_a_bad_pose_names_world_robot_and_values(rows, value):
    with open_env(small_world, rows=rows) as env:
        env.reset(seed=0)
        actions = np.zeros((2, 2, 3))
        actions[1, 0, 2] = value
        with pytest.raises(
            InvalidActionError,
            match=rf"world 1, robot_0: each number of an action must lie in \[-1, 1\], .*{value}",
        ):
            env.step(actions.reshape(env.action_space.shape))


def test_actions_of_worlds_that_are_being_reset_are_ignored():
    with open_env(small_world, rows="teams") as env:
        env.reset(seed=0)
        for _ in range(4):
            env.step(np.zeros((2, 6)))
        _, rewards, _, truncated, infos = env.step(np.full((2, 6), np.nan))
        assert not rewards.any()
        assert not truncated.any()
        np.testing.assert_array_equal(infos["n_scans"], 0)


@pytest.mark.parametrize("workers", [0, 2])
def test_an_error_of_an_environment_names_the_world_and_a_reset_goes_on(workers):
    def fails():
        raise OSError("broken")

    with open_env(HookedEnv, num_workers=workers) as env:
        env.reset(seed=0)
        env.apply(setattr, "on_step", fails, worlds=[1])
        with pytest.raises(OSError, match="broken") as raised:
            env.step(np.zeros((4, 1)))
        assert "in world 1" in "".join(raised.value.__notes__)
        with pytest.raises(RuntimeError, match=r"world 0 has no episode: call reset\(\) first"):
            env.step(np.zeros((4, 1)))
        env.apply(setattr, "on_step", int, worlds=[1])
        env.reset(seed=0)
        assert (env.step(np.zeros((4, 1)))[1] == 1).all()


def test_a_step_needs_a_reset_of_every_world():
    with open_env(small_world, autoreset_mode="Disabled") as env:
        with pytest.raises(RuntimeError, match=r"world 0 has no episode: call reset\(\) first"):
            env.step(np.zeros((4, 3)))
        env.reset(seed=0, options={"reset_mask": np.array([True, True, False, False])})
        with pytest.raises(RuntimeError, match="world 1 has no episode"):
            env.step(np.zeros((4, 3)))


def test_worlds_that_have_ended_are_not_stepped_where_nothing_resets_them():
    with open_env(small_world, autoreset_mode="Disabled") as env:
        env.reset(seed=0)
        for _ in range(4):
            _, _, terminated, truncated, _ = env.step(np.zeros((4, 3)))
        with pytest.raises(RuntimeError, match=r"worlds \[0, 1\] have ended: reset them by"):
            env.step(np.zeros((4, 3)))
        env.reset(options={"reset_mask": terminated | truncated})
        env.step(np.zeros((4, 3)))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"seed": -1}, "seed of world 0 must be an integer of at least 0, got -1"),
        ({"seed": [3, "x"]}, "seed of world 1 must be an integer of at least 0, got 'x'"),
        ({"seed": [3]}, "2 worlds need as many seeds, got 1"),
        ({"seed": 1.5}, "got 1.5"),
        ({"options": 3}, "options must be a dict or None, got 3"),
        ({"options": {"reset_mask": [1, 0, 1, 0]}}, r"bool array of shape \(4,\)"),
        (
            {"options": {"reset_mask": [True, False, True, True]}},
            r"reset together, got \[True, False\] for those of world 0",
        ),
    ],
)
def test_arguments_of_reset_are_checked_before_any_world_changes(arguments, message):
    with open_env(small_world) as env, open_env(small_world) as untouched:
        env.reset(seed=0)
        untouched.reset(seed=0)
        with pytest.raises(ValueError, match=message):
            env.reset(**arguments)
        np.testing.assert_equal(env.step(np.zeros((4, 3))), untouched.step(np.zeros((4, 3))))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"n_envs": 0}, "n_envs must be an integer of at least 1, got 0"),
        ({"n_envs": 2.0}, "n_envs must be an integer of at least 1, got 2.0"),
        ({"num_workers": -1}, "num_workers must be an integer of at least 0, got -1"),
        ({"num_workers": 3}, r"num_workers must be 0 to n_envs \(2\), got 3"),
        ({"rows": "robots"}, "rows must be one of 'agents', 'teams', got 'robots'"),
        ({"autoreset_mode": "never"}, "autoreset_mode must be one of 'NextStep', .* got 'never'"),
    ],
)
def test_arguments_are_checked(arguments, message):
    with pytest.raises(ValueError, match=message):
        WorkerVectorEnv(small_world, **{"n_envs": 2, **arguments})


def test_a_factory_that_returns_one_environment_twice_is_refused():
    env = ConstantReward()
    with pytest.raises(ValueError, match="new environment"):
        WorkerVectorEnv(lambda: env, 2)


class Mixed(ConstantReward):
    def action_space(self, agent):
        return spaces.Discrete(2 + int(agent[-1]))


def test_robots_with_different_spaces_are_no_rows_but_teams():
    with pytest.raises(ValueError, match=r"robot_1 has .*Discrete\(3\).*rows=.teams."):
        WorkerVectorEnv(Mixed, 1)
    with open_env(Mixed, 2, rows="teams") as env:
        assert env.single_action_space == spaces.MultiDiscrete([2, 3])
        env.reset(seed=0)
        env.step(np.array([[1, 2], [0, 1]]))
        with pytest.raises(InvalidActionError, match=r"world 1, robot_0: .* 0 \.\.\. 1, got 2"):
            env.step(np.array([[1, 2], [2, 1]]))


class Plain(ConstantReward):
    def observation_space(self, agent):
        return super().observation_space(agent)["pose"]


def test_observations_must_be_dicts():
    with pytest.raises(ValueError, match="Dict space, got Box"):
        WorkerVectorEnv(Plain, 1)


class OneLeaves(ConstantReward):
    def step(self, actions):
        observations, rewards, terminations, truncations, infos = super().step(actions)
        return observations, rewards, terminations | {"robot_1": True}, truncations, infos


def test_robots_that_end_at_different_steps_are_an_error():
    with open_env(OneLeaves, 1) as env:
        env.reset()
        with pytest.raises(RuntimeError, match="'robot_0': False, 'robot_1': True"):
            env.step(np.zeros((2, 1)))


def test_a_closed_environment_says_so():
    env = WorkerVectorEnv(ConstantReward, 1)
    env.close()
    env.close()
    for call in (env.reset, lambda: env.step(np.zeros((2, 1))), lambda: env.get_attr("agents")):
        with pytest.raises(RuntimeError, match="closed"):
            call()
