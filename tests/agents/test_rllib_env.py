"""A team as RLlib sees it; Ray does not run here."""

import numpy as np
import pytest
from coopmap_agents.rllib import RLlibTeamEnv
from coopmap_agents.rollouts import TeamBlock
from ray.rllib.env.env_context import EnvContext
from toy_team import ConstantReward, StatefulEnv


def team(factory=ConstantReward, seed=0, worker=1, with_state=False):
    team_spaces = TeamBlock(factory, 1, with_state).team_spaces()
    values = {"env_factory": factory, "team_spaces": team_spaces, "seed": seed}
    return RLlibTeamEnv(EnvContext(values, worker_index=worker))


def played(env):
    """What the last step of an episode of 5 gives."""
    env.reset()
    for _ in range(5):
        step = env.step({0: np.zeros(1), 1: np.zeros(1)})
    return step


def episode_number(env, seed):
    observations, _ = env.reset(seed=seed)
    return float(observations[0]["pose"][2])


def test_robots_go_by_their_numbers():
    env = team()
    observations, infos = env.reset(seed=0)
    assert env.possible_agents == env.agents == [0, 1]
    assert [float(own["pose"][0]) for own in observations.values()] == [0.0, 1.0]
    for i, own in observations.items():
        assert env.get_observation_space(i).contains(own)
    assert infos == {}


def test_each_robot_does_its_own_action_whatever_their_order():
    env = team()
    env.reset(seed=0)
    env.step({1: np.full(1, 0.1), 0: np.full(1, 0.0)})
    assert env._env.calls == [{"robot_0": 0.0, "robot_1": 0.1}]


@pytest.mark.parametrize("truncates", [True, False])
def test_an_end_is_told_of_the_whole_team_alone(truncates):
    _, rewards, terminated, truncated, _ = played(team(lambda: ConstantReward(truncates=truncates)))
    assert rewards == {0: 1.0, 1: 1.0}
    assert (terminated, truncated) == ({"__all__": not truncates}, {"__all__": truncates})


def test_before_the_end_nothing_has_ended():
    env = team()
    env.reset(seed=0)
    _, _, terminated, truncated, _ = env.step({0: np.zeros(1), 1: np.zeros(1)})
    assert (terminated, truncated) == ({"__all__": False}, {"__all__": False})


class BothEnds(ConstantReward):
    def step(self, actions):
        observations, rewards, _, truncated, infos = super().step(actions)
        return observations, rewards, truncated, truncated, infos


def test_what_has_ended_by_itself_was_not_cut_short():
    _, _, terminated, truncated, _ = played(team(BothEnds))
    assert (terminated, truncated) == ({"__all__": True}, {"__all__": False})


class OneEnds(ConstantReward):
    def step(self, actions):
        observations, rewards, terminated, truncated, infos = super().step(actions)
        return observations, rewards, {**terminated, "robot_1": True}, truncated, infos


def test_robots_that_end_apart_are_refused():
    with pytest.raises(RuntimeError, match="must end their episode together, got terminated"):
        played(team(OneEnds))


def test_seeds_that_rllib_counts_up_give_no_world_twice():
    # RLlib seeds environment i of worker w with seed + w + i
    numbers = {
        episode_number(team(seed=seed, worker=worker), seed + worker + i)
        for seed in range(3)
        for worker in range(3)
        for i in range(3)
    }
    assert len(numbers) == 27


def test_the_same_seed_gives_the_same_worlds_one_after_the_other():
    one, two = ([episode_number(env, seed) for seed in (4, None, None)] for env in (team(), team()))
    assert one == two
    assert len(set(one)) == 3


def test_the_state_of_the_team_is_seen_where_the_critic_asks_for_it():
    env = team(StatefulEnv, with_state=True)
    observations, _ = env.reset(seed=0)
    assert env.get_observation_space(0).contains(observations[0])
    observations, *_ = env.step({0: np.zeros(1), 1: np.zeros(1)})
    for own in observations.values():
        assert own["state"][0] == np.float32(1 / 5)
    assert "state" not in team(StatefulEnv).reset(seed=0)[0][0]


def test_returns_of_robots_and_the_time_of_environments_are_noted():
    env = team()
    played(env)
    env.reset()
    env.step({0: np.zeros(1), 1: np.zeros(1)})
    assert env.returns == [5.0, 5.0]  # the second episode has not ended
    assert 0 < env.seconds < 1


def test_closing_closes_the_environment():
    env = team()
    env.close()
    assert env._env.calls == ["close"]
