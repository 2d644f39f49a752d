"""Rows of a vector environment in RLlib; Ray does not run here."""

import itertools
from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest
from plain.small_worlds import masked_world
from plain.toy_team import ConstantReward, StatefulEnv

from coopmap_agents.rllib import RLlibRows
from coopmap_agents.rllib.env import shared_spaces


def rows(factory=ConstantReward, seed=0, with_state=False, num_envs=4):
    team_spaces = shared_spaces(factory, with_state)
    return RLlibRows(
        {"env_factory": factory, "team_spaces": team_spaces, "seed": seed, "num_envs": num_envs}
    )


def episode_numbers(env, seed):
    observations, _ = env.reset(seed=seed)
    return observations["pose"][::2, 2].tolist()


def test_it_is_a_vector_environment_of_robots_that_resets_in_the_next_step():
    env = rows(masked_world)
    assert isinstance(env, gymnasium.vector.VectorEnv)
    assert env.metadata["autoreset_mode"] is gymnasium.vector.AutoresetMode.NEXT_STEP
    observations, infos = env.reset(seed=0)
    assert infos == {}
    assert env.num_envs == 4
    assert env.unwrapped is env
    for row in range(4):
        own = {key: values[row] for key, values in observations.items()}
        assert env.single_observation_space.contains(own)
    env.close()


def test_what_rllib_keeps_does_not_change():
    env = rows()
    first, _ = env.reset(seed=0)
    kept = first["pose"].copy()
    for _ in range(7):
        env.step(np.zeros((4, 1)))
    np.testing.assert_array_equal(first["pose"], kept)


@pytest.mark.parametrize("truncates", [True, False])
def test_the_end_is_reported_for_each_row_and_the_next_step_resets(truncates):
    env = rows(lambda: ConstantReward(truncates=truncates))
    env.reset(seed=0)
    for step in range(5):
        _, rewards, terminated, truncated, _ = env.step(np.zeros((4, 1)))
        assert (rewards == 1).all()
        assert (terminated == (step == 4 and not truncates)).all()
        assert (truncated == (step == 4 and truncates)).all()
    observations, rewards, *_ = env.step(np.zeros((4, 1)))
    assert (rewards == 0).all()
    assert (observations["pose"][:, 1] == 0).all()


def test_consecutive_seeds_of_rllib_give_different_worlds():
    numbers = {  # RLlib seeds worker w with seed + w
        number
        for seed in range(3)
        for worker in range(3)
        for number in episode_numbers(rows(seed=seed), seed + worker)
    }
    assert len(numbers) == 3 * 3 * 2


def test_equal_seeds_give_equal_sequences_of_worlds():
    one, two = (
        [number for seed in (4, None, None) for number in episode_numbers(env, seed)]
        for env in (rows(), rows())
    )
    assert one == two
    assert len(set(one)) == 6


def test_the_state_is_observed_where_the_critic_uses_it():
    env = rows(StatefulEnv, with_state=True)
    assert "state" in env.single_observation_space.spaces
    env.reset(seed=0)
    observations, *_ = env.step(np.zeros((4, 1)))
    assert (observations["state"][:, 0] == np.float32(1 / 5)).all()
    assert "state" not in rows(StatefulEnv).reset(seed=0)[0]


def test_returns_and_times_are_recorded(monkeypatch):
    clock = SimpleNamespace(perf_counter=itertools.count().__next__)
    monkeypatch.setattr("coopmap_agents.rllib.env.time", clock)
    env = rows()
    env.reset()
    for _ in range(7):
        env.step(np.zeros((4, 1)))
    assert env.returns == [5.0] * 4  # the second episode has not ended
    assert env.seconds == 8.0  # a reset and 7 steps; the clock ticks between start and end
