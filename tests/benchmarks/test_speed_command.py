"""Speed, for comparing versions: `pytest tests/benchmarks --benchmark-enable`."""

import numpy as np
import pytest

import coopmap_baselines
from coopmap_env import planar_v1
from coopmap_env.simulation import PlanarSimulator
from coopmap_env.studies.speed.planar import WHOLE_WORLD


@pytest.fixture
def half_finished_env():
    env = planar_v1.parallel_env(settings=WHOLE_WORLD, split="train")
    policy = coopmap_baselines.make("rating_function", search=50)
    observations, _ = env.reset(seed=0)
    policy.reset(np.random.default_rng(0))
    for _ in range(8):
        observations, *_ = env.step(policy.act(env.belief(), observations))
    return env


def test_reset(benchmark):
    env = planar_v1.parallel_env()
    benchmark(env.reset, seed=0)
    assert env.agents


def test_step_with_random_actions(benchmark):
    env = planar_v1.parallel_env(max_scans=10**9)
    env.reset(seed=0)
    for k, agent in enumerate(env.agents):
        env.action_space(agent).seed(k)
    actions = {agent: env.action_space(agent).sample() for agent in env.agents}
    _, rewards, *_ = benchmark(env.step, actions)
    assert set(rewards) == set(env.possible_agents)


@pytest.mark.parametrize("search", [100, "exhaustive"])
def test_decision_of_the_rating_function(benchmark, half_finished_env, search):
    policy = coopmap_baselines.make("rating_function", search=search)
    policy.reset(np.random.default_rng(0))
    actions = benchmark(policy.act, half_finished_env.belief(), {})
    assert set(actions) == set(half_finished_env.agents)


def test_rating_a_thousand_poses(benchmark, half_finished_env):
    belief = half_finished_env.belief()
    cells = belief.feasible_cells(0)
    ids = np.random.default_rng(0).choice(cells, 1000) * belief.lattice.n_headings
    rated = benchmark(belief.rate, 0, ids)
    assert np.isfinite(rated.rating).all()


def test_fusing_the_scans_of_a_team(benchmark, half_finished_env):
    rng = np.random.default_rng(0)
    env = half_finished_env
    simulator = PlanarSimulator(env.truth, env.settings.camera, env.settings.noise)
    scans = [simulator.scan_from(pose, rng) for pose in env.belief().camera_poses]
    gains = benchmark(half_finished_env.belief().map.integrate, scans)
    assert len(gains) == 2
