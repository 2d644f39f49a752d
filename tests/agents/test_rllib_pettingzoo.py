"""RLlib's own adapter of PettingZoo, as its documentation uses it."""

import logging

import pytest
from plain.small_worlds import small_world

pytest.importorskip("ray.rllib")
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.connectors.env_to_module import FlattenObservations
from ray.rllib.env.wrappers.pettingzoo_env import ParallelPettingZooEnv
from ray.tune.registry import register_env

from coopmap_agents.rllib.env import suppress_rllib_warnings
from coopmap_env.evaluation import ray_session

pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.filterwarnings("ignore::UserWarning"),
]


@pytest.fixture(scope="module", autouse=True)
def ray():
    with ray_session(workers=1) as started:
        yield started


def algorithm(**runners):
    logging.getLogger("ray.rllib").setLevel(logging.ERROR)
    register_env("small", lambda _: ParallelPettingZooEnv(small_world(action_mode="candidates")))
    config = PPOConfig().environment("small").env_runners(num_env_runners=0, **runners)
    config.multi_agent(policies={"robots"}, policy_mapping_fn=lambda *_, **__: "robots")
    config.training(train_batch_size=8, minibatch_size=8, num_epochs=1)
    with suppress_rllib_warnings():
        return config.build_algo()


def test_it_runs_with_flat_observations_and_without_masks():
    found = algorithm(
        env_to_module_connector=lambda *_, **__: FlattenObservations(multi_agent=True)
    )
    assert found.train()["env_runners"]["num_env_steps_sampled"] == 8
    found.stop()


def test_without_them_rllib_says_that_it_has_no_network_for_a_dict():
    with pytest.raises(ValueError, match="No default encoder config for obs space=Dict"):
        algorithm()
