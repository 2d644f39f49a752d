import numpy as np
import pytest
import torch
from coopmap_agents import ppo
from coopmap_agents.masking import MaskedPolicy
from coopmap_agents.vec_env import SharedPolicyVecEnv
from small_worlds import masked_world, small_world
from stable_baselines3.common.policies import MultiInputActorCriticPolicy
from stable_baselines3.common.vec_env import VecEnvWrapper

KEPT = [3, 17, 299]


def policy_of(env, cls=MaskedPolicy):
    torch.manual_seed(0)
    return cls(
        env.observation_space,
        env.action_space,
        lambda _: 1e-3,
        features_extractor_class=ppo.RobotFeatures,
        features_extractor_kwargs={"image_features": 8},
    )


def tensors(env):
    env.seed(0)
    return {key: torch.as_tensor(values) for key, values in env.reset().items()}


@pytest.fixture
def masked():
    """A policy, and observations that leave three candidates."""
    env = SharedPolicyVecEnv(masked_world, 2)
    observations = tensors(env)
    observations["action_mask"].zero_()
    observations["action_mask"][:, KEPT] = 1
    return policy_of(env), observations


def test_masked_candidates_have_probability_zero_and_the_others_share_one(masked):
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


def test_gradients_are_finite_and_none_flows_into_a_masked_logit(masked):
    policy, observations = masked
    _, log_prob, entropy = policy.evaluate_actions(observations, torch.full((4,), KEPT[0]))
    (log_prob.sum() + entropy.sum()).backward()
    gradient = policy.action_net.bias.grad
    assert torch.isfinite(gradient).all()
    assert set(torch.nonzero(gradient).ravel().tolist()) <= set(KEPT)


@pytest.mark.parametrize("deterministic", [True, False])
def test_only_candidates_on_offer_are_taken(masked, deterministic):
    policy, observations = masked
    for _ in range(20):
        actions, *_ = policy(observations, deterministic=deterministic)
        assert np.isin(actions.numpy(), KEPT).all()


def test_without_a_mask_it_is_the_multi_input_policy():
    env = SharedPolicyVecEnv(small_world, 2)
    observations = tensors(env)
    ours = policy_of(env)
    theirs = policy_of(env, MultiInputActorCriticPolicy)
    for policy in (ours, theirs):
        torch.manual_seed(1)
        policy.result = policy(observations)
    for a, b in zip(ours.result, theirs.result, strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=0)


class Watch(VecEnvWrapper):
    """Counts actions that were refused."""

    def __init__(self, venv):
        super().__init__(venv)
        self.actions = self.refused = 0

    def reset(self):
        return self.venv.reset()

    def step_wait(self):
        result = self.venv.step_wait()
        self.actions += len(result[3])
        self.refused += sum(bool(info["refused"]) for info in result[3])
        return result


def test_training_takes_no_masked_candidate(monkeypatch):
    watched = []

    def make(env_factory, n_envs):
        watched.append(Watch(SharedPolicyVecEnv(env_factory, n_envs)))
        return watched[0]

    monkeypatch.setattr(ppo, "SharedPolicyVecEnv", make)
    settings = ppo.PPOSettings(
        total_steps=256, n_envs=2, rollout_steps=32, batch_size=64, n_epochs=2
    )
    ppo.train(masked_world, settings, seed=0)
    assert watched[0].actions == 256
    assert watched[0].refused == 0
