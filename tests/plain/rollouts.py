"""Episodes of random actions, and one hash of everything that they return."""

import hashlib

import numpy as np

from coopmap_env.envs.planar import PlanarEnv

MODES = ("pose", "candidates")


def random_actions(env, rng):
    """Random actions; in "pose" mode every second one leads to a feasible pose."""
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
    """Everything that an episode returns, step by step; `before_step` is called before steps."""
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
    """Add a value and its types to a hash, to the last bit."""
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
    """`trajectory_hash` of a new environment; run in a second process."""
    env = make(**arguments)
    try:
        return trajectory_hash(env, seed)
    finally:
        env.close()
