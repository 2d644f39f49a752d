"""The one loop of an episode."""

from itertools import count, islice

import numpy as np
import pytest

from coopmap_env.envs.planar import PlanarEnv
from coopmap_env.evaluation import (
    EpisodeRecorder,
    make_policy,
    policy_rng,
    rollout,
    run_episode,
)


def small_env():
    return PlanarEnv(max_scans=4)


def test_a_rollout_is_the_loop_of_reset_act_and_step():
    env, policy = small_env(), make_policy("rating_function:search=10")
    observations, _ = env.reset(seed=2)
    policy.reset(policy_rng(2))
    for step in rollout(small_env(), make_policy("rating_function:search=10"), seed=2):
        actions = policy.act(env.belief(), observations)
        np.testing.assert_equal(step.observations, observations)
        np.testing.assert_equal(step.actions, actions)
        observations, rewards, _, _, infos = env.step(actions)
        assert step.rewards == rewards
        np.testing.assert_equal(step.infos, infos)
    assert not env.agents


def test_the_call_resets_and_each_iteration_plays_one_step():
    env = small_env()
    steps = rollout(env, make_policy("random"), seed=0)
    first, observed = env.belief(), env.belief().map.observed_fraction
    played = list(islice(steps, 2))
    assert [len(step.actions) for step in played] == [2, 2]
    assert played[0].belief is first
    assert env.belief().map.observed_fraction > observed
    assert env.agents
    assert len(list(steps)) == 2
    assert not env.agents


def test_the_policy_draws_from_the_given_generator():
    def actions(rng):
        return [step.actions for step in rollout(small_env(), make_policy("random"), 0, rng)]

    np.testing.assert_equal(actions(np.random.default_rng(5)), actions(np.random.default_rng(5)))
    np.testing.assert_equal(actions(None), actions(policy_rng(0)))
    with pytest.raises(AssertionError):
        np.testing.assert_equal(actions(None), actions(np.random.default_rng(5)))


def test_a_recorder_measures_what_run_episode_returns():
    env = small_env()
    steps = rollout(env, make_policy("frontier"), seed=1)
    recorder = EpisodeRecorder(env, seed=1)
    for step in steps:
        recorder.add(step)
    expected = run_episode(small_env(), make_policy("frontier"), seed=1)
    found = recorder.episode()
    assert found.coverage_curve == expected.coverage_curve
    assert (found.reward, found.motion_distance) == (expected.reward, expected.motion_distance)


def test_decisions_are_timed_by_the_clock_that_is_given():
    ticks = count(step=2.5)
    steps = rollout(small_env(), make_policy("random"), seed=0, clock=lambda: next(ticks))
    assert [step.decision_s for step in steps] == [2.5] * 4
