"""Speed in the field, for comparing versions: `pytest tests/benchmarks --benchmark-enable`."""

from dataclasses import replace

import numpy as np
import pytest

import coopmap_baselines
from coopmap_env.envs.field import FieldEnv, FieldSettings

pytest.importorskip("pybullet")


@pytest.fixture(scope="module")
def env():
    """Half-way through an episode."""
    made = FieldEnv(max_scans=10**9)
    policy = coopmap_baselines.make("rating_function", search=50)
    observations, _ = made.reset(seed=0)
    policy.reset(np.random.default_rng(0))
    for _ in range(8):
        observations, *_ = made.step(policy.act(made.belief(), observations))
    yield made
    made.close()


@pytest.mark.parametrize("physics", ["kinematic", "stepped"])
def test_step_to_random_feasible_poses(benchmark, physics):
    env = FieldEnv(max_scans=10**9, settings=replace(FieldSettings(), physics=physics))
    env.reset(seed=0)
    rng = np.random.default_rng(0)

    def actions():
        belief = env.belief()
        chosen = {
            agent: belief.action_for(robot, belief.random_poses(robot, 1, rng)[0])
            for robot, agent in enumerate(env.agents)
        }
        return (chosen,), {}

    _, rewards, *_ = benchmark.pedantic(env.step, setup=actions, rounds=20)
    assert set(rewards) == set(env.possible_agents)
    env.close()


def test_reset(benchmark):
    env = FieldEnv()
    benchmark(env.reset, seed=0)
    assert env.agents
    env.close()


@pytest.mark.parametrize("policy", ["rating_function", "information_gain", "coverage"])
def test_decision_of_300_candidates(benchmark, env, policy):
    chosen = coopmap_baselines.make(policy, search=300)
    chosen.reset(np.random.default_rng(0))
    actions = benchmark(chosen.act, env.belief(), {})
    assert set(actions) == set(env.agents)


def test_fusing_the_scans_of_a_team(benchmark, env):
    gains = benchmark(env.belief().map.copy().integrate, env.last_scans)
    assert len(gains) == 2
