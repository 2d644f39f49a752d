import contextlib
from functools import partial

import numpy as np
import pytest
from gymnasium import spaces
from plain.small_worlds import masked_world, small_world
from plain.toy_team import ConstantReward, StatefulEnv
from stable_baselines3.common.vec_env import VecCheckNan
from vec_envs import shared


def test_every_robot_of_an_environment_observes_its_state():
    env = shared(StatefulEnv, 2, with_state=True)
    assert env.observation_space["state"] == StatefulEnv.state_space
    assert env.observation_space["pose"] == ConstantReward().observation_space("robot_0")["pose"]
    first = env.reset()
    np.testing.assert_array_equal(first["state"], first["pose"][:, 1:])
    assert (first["state"][:2, 1] != first["state"][2:, 1]).all()
    later, *_ = env.step(np.zeros((4, 1)))
    np.testing.assert_array_equal(later["state"][:, 0], np.float32(0.2))
    np.testing.assert_array_equal(later["state"], later["pose"][:, 1:])


def test_a_terminal_observation_has_the_last_state_and_the_returned_one_the_first_of_the_next():
    env = shared(partial(StatefulEnv, n_steps=1), 2, with_state=True)
    first = env.reset()
    observations, _, _, infos = env.step(np.zeros((4, 1)))
    last = np.array([info["terminal_observation"]["state"] for info in infos])
    np.testing.assert_array_equal(last[:, 0], 1.0)
    np.testing.assert_array_equal(last[:, 1], first["state"][:, 1])
    np.testing.assert_array_equal(observations["state"], observations["pose"][:, 1:])
    assert not np.isin(observations["state"][:, 1], last[:, 1]).any()


@pytest.mark.parametrize("make_world", [small_world, masked_world], ids=["pose", "candidates"])
def test_the_state_is_that_of_the_environment_and_in_its_space(make_world):
    env = VecCheckNan(shared(make_world, 2, with_state=True), raise_exception=True)
    env.action_space.seed(0)
    env.seed(0)
    observations = env.reset()
    for _ in range(6):
        np.testing.assert_array_equal(observations["state"], env.env_method("state"))
        for row in range(env.num_envs):
            own = {key: values[row] for key, values in observations.items()}
            assert env.observation_space.contains(own)
        actions = np.stack([env.action_space.sample() for _ in range(env.num_envs)])
        observations, _, dones, infos = env.step(actions)
        if dones[0]:
            assert env.observation_space.contains(infos[0]["terminal_observation"])


def test_workers_send_the_same_states():
    alone = shared(partial(StatefulEnv, n_steps=2), 3, with_state=True)
    with contextlib.closing(
        shared(partial(StatefulEnv, n_steps=2), 3, workers=2, with_state=True)
    ) as env:
        assert env.observation_space == alone.observation_space
        for one in (env, alone):
            one.seed(0)
        np.testing.assert_equal(env.reset(), alone.reset())
        for _ in range(4):
            np.testing.assert_equal(env.step(np.zeros((6, 1))), alone.step(np.zeros((6, 1))))


def test_without_with_state_there_is_no_state():
    env = shared(StatefulEnv, 1)
    assert "state" not in env.observation_space.spaces
    assert "state" not in env.reset()


def test_an_environment_without_state_space_is_refused():
    with pytest.raises(ValueError, match="needs an environment with a state_space"):
        shared(ConstantReward, 1, with_state=True)


class Crowded(StatefulEnv):
    def observation_space(self, agent):
        own = super().observation_space(agent)
        return spaces.Dict({**own.spaces, "state": own["pose"]})


def test_an_entry_of_the_same_name_is_not_overwritten():
    with pytest.raises(ValueError, match='would overwrite the entry "state"'):
        shared(Crowded, 1, with_state=True)
