"""Masked candidates are never taken."""

import numpy as np
import pytest
import torch
from plain.small_worlds import masked_world
from scorers import as_tensors, played_rows, scorer_of
from stable_baselines3.common.vec_env import VecEnvWrapper

from coopmap_agents.config import PPOSettings
from coopmap_agents.sb3 import SharedPolicyVecEnv, ppo

KEPT = [3, 17, 299]


@pytest.fixture
def masked():
    """A policy, and observations that leave three candidates."""
    env, observations = played_rows(masked_world, n_steps=0)
    observations["action_mask"].zero_()
    observations["action_mask"][:, KEPT] = 1
    return scorer_of(env), observations


def test_masked_candidates_have_probability_zero_and_the_others_sum_to_one(masked):
    policy, observations = masked
    probabilities = policy.get_distribution(observations).distribution.probs
    assert (probabilities[:, KEPT] > 0).all()
    torch.testing.assert_close(probabilities[:, KEPT].sum(dim=1), torch.ones(4))
    others = np.setdiff1d(np.arange(300), KEPT)
    assert (probabilities[:, others] == 0).all()


def test_the_entropy_is_that_of_the_candidates_left(masked):
    policy, observations = masked
    distribution = policy.get_distribution(observations)
    p = distribution.distribution.probs[:, KEPT]
    torch.testing.assert_close(distribution.entropy(), -(p * p.log()).sum(dim=1))


def test_actions_are_evaluated_with_the_probabilities_they_were_drawn_with(masked):
    policy, observations = masked
    actions, values, log_prob = policy(observations)
    again = policy.evaluate_actions(observations, actions)
    torch.testing.assert_close(again[0], values)
    torch.testing.assert_close(again[1], log_prob)
    torch.testing.assert_close(policy.predict_values(observations), values)


def test_gradients_are_finite_and_none_flows_into_a_masked_candidate(masked):
    policy, observations = masked
    observations["candidates"].requires_grad_()
    _, log_prob, entropy = policy.evaluate_actions(observations, torch.full((4,), KEPT[0]))
    (log_prob.sum() + entropy.sum()).backward()
    gradients = [p.grad for p in policy.parameters() if p.grad is not None]
    assert all(torch.isfinite(gradient).all() for gradient in gradients)
    gradient = observations["candidates"].grad.abs().sum(dim=(0, 2))
    assert torch.isfinite(gradient).all()
    assert set(torch.nonzero(gradient).ravel().tolist()) == set(KEPT)


def masks_of_all_kinds(n, m, rng):
    """Rows that keep one, the first, the last, a half, all but one, and all."""
    masks = np.zeros((n, m), dtype=np.int8)
    masks[0, rng.integers(m)] = 1
    masks[1, : m // 3] = 1
    masks[2, -2:] = 1
    masks[3, ::2] = 1
    masks[4, np.arange(m) != rng.integers(m)] = 1
    masks[5:] = rng.random((n - 5, m)) < rng.random((n - 5, 1))
    masks[5:, 0] |= ~masks[5:].any(axis=1)
    return masks


@pytest.mark.parametrize("deterministic", [True, False])
@pytest.mark.parametrize("initial_policy", ["random", "rating"])
def test_only_unmasked_candidates_are_taken(initial_policy, deterministic):
    env, observations = played_rows(masked_world, n_envs=8)
    policy, rng = scorer_of(env, initial_policy=initial_policy), np.random.default_rng(0)
    # a masked rating of 0 would be the best of all if it counted
    observations["candidates"] = -torch.rand(16, 300, 9, generator=torch.Generator().manual_seed(0))
    for _ in range(20):
        masks = masks_of_all_kinds(16, 300, rng)
        rows = observations | as_tensors({"action_mask": masks})
        actions, *_ = policy(rows, deterministic=deterministic)
        assert (masks[np.arange(16), actions.numpy()] == 1).all()
        numbers = {key: values.numpy() for key, values in rows.items()}
        actions, _ = policy.predict(numbers, deterministic=deterministic)
        assert (masks[np.arange(16), actions] == 1).all()


def test_an_empty_mask_is_no_error():
    env, observations = played_rows(masked_world)
    observations["action_mask"].zero_()
    actions, values, log_prob = scorer_of(env)(observations)
    assert ((actions >= 0) & (actions < 300)).all()
    assert torch.isfinite(values).all()
    assert torch.isfinite(log_prob).all()


class RejectionCounter(VecEnvWrapper):
    """Counts rejected actions."""

    def __init__(self, venv):
        super().__init__(venv)
        self.n_actions = self.n_rejected = 0

    def reset(self):
        return self.venv.reset()

    def step_wait(self):
        result = self.venv.step_wait()
        self.n_actions += len(result[3])
        self.n_rejected += sum(bool(info["rejected_reason"]) for info in result[3])
        return result


def test_training_takes_no_masked_candidate(monkeypatch):
    watched = []

    def make(rows):
        watched.append(RejectionCounter(SharedPolicyVecEnv(rows)))
        return watched[0]

    monkeypatch.setattr(ppo, "SharedPolicyVecEnv", make)
    settings = PPOSettings(total_steps=256, n_envs=2, rollout_steps=32, batch_size=64, n_epochs=2)
    ppo.train(masked_world, settings, seed=0)
    assert watched[0].n_actions == 256
    assert watched[0].n_rejected == 0
