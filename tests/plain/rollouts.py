"""Whole episodes of random actions, and everything that they show in one hash."""

import hashlib

import numpy as np

from coopmap_env.envs.planar import PlanarEnv

MODES = ("pose", "candidates")


def random_actions(env, rng):
    """Any action in every second place; in "pose" mode the others lead to feasible poses."""
    belief, actions = env.belief(), {}
    for robot, agent in enumerate(env.agents):
        space = env.action_space(agent)
        if hasattr(space, "n") or rng.random() < 0.5:
            actions[agent] = sample_action(space, rng)
        else:
            actions[agent] = belief.action_for(robot, belief.random_poses(robot, 1, rng)[0])
    return actions


def sample_action(space, rng):
    """A member of a Box or Discrete space; all randomness from `rng`."""
    if hasattr(space, "n"):
        return rng.integers(space.n)
    return rng.uniform(space.low, space.high).astype(space.dtype)


def random_rollout(env, seed, rng, before_step=None):
    """Everything that one episode shows, step by step; `before_step` is called before every action."""
    yield *env.reset(seed=seed), env.state()
    while env.agents:
        actions = random_actions(env, rng)
        if before_step is not None:
            before_step(env)
        yield *env.step(actions), env.state()


def trajectory_hash(env, seed, before_step=None):
    """SHA-256 over observations, rewards, ends, infos and states of an episode."""
    sha = hashlib.sha256()
    for outputs in random_rollout(env, seed, np.random.default_rng(seed), before_step):
        update_hash(sha, outputs)
    return sha.hexdigest()


def update_hash(sha, value):
    """Add a value with its types to a hash, down to the last bit."""
    if isinstance(value, dict):
        for key in sorted(value):
            sha.update(key.encode())
            update_hash(sha, value[key])
    elif isinstance(value, tuple | list):
        for part in value:
            update_hash(sha, part)
    elif isinstance(value, np.ndarray):
        sha.update(f"{value.dtype}{value.shape}".encode())
        sha.update(value.tobytes())
    else:
        sha.update(f"{type(value).__name__} {value!r}".encode())


def env_trajectory_hash(arguments, seed, make=PlanarEnv):
    """`trajectory_hash` of a new environment; what a second process runs."""
    env = make(**arguments)
    try:
        return trajectory_hash(env, seed)
    finally:
        env.close()
