"""A team as an environment of RLlib; Ray does not run here."""

import itertools
from types import SimpleNamespace

import numpy as np
import pytest
from plain.toy_team import ConstantReward, StatefulEnv
from ray.rllib.env.env_context import EnvContext

from coopmap_agents.rllib import RLlibTeamEnv
from coopmap_agents.rllib.env import shared_spaces


def team(factory=ConstantReward, seed=0, worker=1, with_state=False):
    team_spaces = shared_spaces(factory, with_state)
    values = {"env_factory": factory, "team_spaces": team_spaces, "seed": seed}
    return RLlibTeamEnv(EnvContext(values, worker_index=worker))


def played(env):
    """Result of the last step of an episode of 5."""
    env.reset()
    for _ in range(5):
        step = env.step({0: np.zeros(1), 1: np.zeros(1)})
    return step


def episode_number(env, seed):
    observations, _ = env.reset(seed=seed)
    return float(observations[0]["pose"][2])


def test_robots_are_named_by_their_numbers():
    env = team()
    observations, infos = env.reset(seed=0)
    assert env.possible_agents == env.agents == [0, 1]
    assert [float(own["pose"][0]) for own in observations.values()] == [0.0, 1.0]
    for i, own in observations.items():
        assert env.get_observation_space(i).contains(own)
    assert infos == {}


def test_each_robot_takes_its_own_action_in_any_order():
    env = team()
    env.reset(seed=0)
    env.step({1: np.full(1, 0.1), 0: np.full(1, 0.0)})
    assert env._env.calls == [{"robot_0": 0.0, "robot_1": 0.1}]


@pytest.mark.parametrize("truncates", [True, False])
def test_the_end_is_reported_for_the_whole_team(truncates):
    _, rewards, terminated, truncated, _ = played(team(lambda: ConstantReward(truncates=truncates)))
    assert rewards == {0: 1.0, 1: 1.0}
    assert (terminated, truncated) == ({"__all__": not truncates}, {"__all__": truncates})


def test_nothing_ends_before_the_end():
    env = team()
    env.reset(seed=0)
    _, _, terminated, truncated, _ = env.step({0: np.zeros(1), 1: np.zeros(1)})
    assert (terminated, truncated) == ({"__all__": False}, {"__all__": False})


class BothEnds(ConstantReward):
    def step(self, actions):
        observations, rewards, _, truncated, infos = super().step(actions)
        return observations, rewards, truncated, truncated, infos


def test_termination_is_not_truncation():
    _, _, terminated, truncated, _ = played(team(BothEnds))
    assert (terminated, truncated) == ({"__all__": True}, {"__all__": False})


class OneEnds(ConstantReward):
    def step(self, actions):
        observations, rewards, terminated, truncated, infos = super().step(actions)
        return observations, rewards, {**terminated, "robot_1": True}, truncated, infos


def test_robots_that_end_at_different_steps_are_refused():
    with pytest.raises(RuntimeError, match="must end their episode together, got terminated"):
        played(team(OneEnds))


def test_consecutive_seeds_of_rllib_give_different_worlds():
    # RLlib seeds environment i of worker w with seed + w + i
    numbers = {
        episode_number(team(seed=seed, worker=worker), seed + worker + i)
        for seed in range(3)
        for worker in range(3)
        for i in range(3)
    }
    assert len(numbers) == 27


def test_equal_seeds_give_equal_sequences_of_worlds():
    one, two = ([episode_number(env, seed) for seed in (4, None, None)] for env in (team(), team()))
    assert one == two
    assert len(set(one)) == 3


def test_the_state_is_observed_where_the_critic_uses_it():
    env = team(StatefulEnv, with_state=True)
    observations, _ = env.reset(seed=0)
    assert env.get_observation_space(0).contains(observations[0])
    observations, *_ = env.step({0: np.zeros(1), 1: np.zeros(1)})
    for own in observations.values():
        assert own["state"][0] == np.float32(1 / 5)
    assert "state" not in team(StatefulEnv).reset(seed=0)[0][0]


def test_returns_and_times_are_recorded(monkeypatch):
    clock = SimpleNamespace(perf_counter=itertools.count().__next__)
    monkeypatch.setattr("coopmap_agents.rllib.env.time", clock)
    env = team()
    played(env)
    env.reset()
    env.step({0: np.zeros(1), 1: np.zeros(1)})
    assert env.returns == [5.0, 5.0]  # the second episode has not ended
    assert env.seconds == 8.0  # 2 resets and 6 steps; the clock ticks between start and end


def test_closing_closes_the_environment():
    env = team()
    env.close()
    assert env._env.calls == ["close"]
