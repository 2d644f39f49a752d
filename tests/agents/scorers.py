"""Scorers and their inputs, as the tests of several files need them."""

import numpy as np
import torch
from gymnasium import spaces
from vec_envs import shared

from coopmap_agents.networks import CandidateScorer


def scorer_of(env, seed=0, **options):
    """An untrained policy with clearly different scores (unless initialised with the rating)."""
    torch.manual_seed(seed)
    policy = CandidateScorer(
        env.observation_space,
        env.action_space,
        lambda _: 1e-3,
        net_arch=[16, 8],
        features_extractor_kwargs={"image_features": 8},
        **options,
    )
    with torch.no_grad():
        policy.network.value[-1].weight.mul_(100.0)
        if policy.initial_policy != "rating":
            policy.network.score.weight.mul_(300.0)
            policy.network.rating_weight.fill_(0.1)
    return policy


def played_rows(make_env, n_steps=3, n_envs=2, seed=0):
    """A vectorised environment and its observations after some random steps, as tensors."""
    env = shared(make_env, n_envs)
    env.seed(seed)
    observations = env.reset()
    rng = np.random.default_rng(seed)
    for _ in range(n_steps):
        masks = env.action_masks()
        actions = np.array([rng.choice(np.flatnonzero(mask)) for mask in masks])
        observations, *_ = env.step(actions)
    return env, as_tensors(observations)


def sampled_rows(space, n=4, seed=0):
    """Random members of a space as tensors; some candidates of each row are unmasked."""
    space.seed(seed)
    samples = [space.sample() for _ in range(n)]
    rows = {key: np.stack([sample[key] for sample in samples]) for key in space.spaces}
    rows["action_mask"][:, 0] = 1
    rows["candidates"][rows["action_mask"] == 0] = 0
    return as_tensors(rows)


def as_tensors(rows):
    return {key: torch.as_tensor(values) for key, values in rows.items()}


def logits(policy, observations):
    """Before masking, shape (n, m)."""
    with torch.no_grad():
        return policy.network(*policy._inputs(observations))[0]


def other_sizes(space, m, n_teammates):
    """The same observations but for the numbers of candidates and teammates."""
    parts = dict(space.spaces)
    for key, length in (
        ("candidates", m),
        ("action_mask", m),
        ("teammates", n_teammates),
        ("located", n_teammates + 1),
    ):
        if key in parts:
            old = parts[key]
            shape = (length, *old.shape[1:])
            parts[key] = spaces.Box(old.low.min(), old.high.max(), shape, old.dtype)
    return spaces.Dict(parts)
