"""Trajectories of every registered id, in hashes that do not depend on names or wording.

``python -m plain.golden tests/golden/trajectories.json`` in `tests` writes what the environment
does now: only for a change of behaviour, which gets a new ``-vN`` and a line in CHANGELOG.
"""

import hashlib
import json
import sys
from pathlib import Path

import coopmap_baselines
import numpy as np
import pettingzoo
from plain.rollouts import random_actions

import coopmap_env  # noqa: F401 - registers the ids

N_EPISODES = 100
MODES = ("pose", "candidates")
SCANS = {"coopmap/Planar-v0": 8, "coopmap/Field-v0": 3, "coopmap/FieldSearch-v0": 4}
"""Scans of each robot in an episode."""
M_40 = {"search": 40, "coordination": "sequential"}
PLANNERS = {
    "rating_function": M_40,
    "information_gain": M_40,
    "coverage": M_40,
    "frontier": {},
    "raster": {},
    "random": {},
}
"""Options of each planner."""


def digest(value) -> bytes:
    """SHA-256 of the values in nested containers, to the last bit.

    Of a dict only the set of its values counts, of a text only whether it is empty: keys and
    messages may be worded anew without a change of what happens.
    """
    sha = hashlib.sha256()
    if isinstance(value, dict):
        for part in sorted(digest(part) for part in value.values()):
            sha.update(part)
    elif isinstance(value, tuple | list):
        for part in value:
            sha.update(digest(part))
    elif isinstance(value, np.ndarray):
        sha.update(f"{value.dtype}{value.shape}".encode() + value.tobytes())
    elif isinstance(value, str):
        sha.update(b"text" if value else b"no text")
    elif isinstance(value, np.generic):
        sha.update(digest(value.item()))
    else:
        sha.update(f"{type(value).__name__} {value!r}".encode())
    return sha.digest()


def episode_digest(env, seed, act) -> bytes:
    """Everything that one episode shows: observations, rewards, ends, infos, states, the map."""
    shown = [env.reset(seed=seed), env.state()]
    while env.agents:
        shown += [env.step(act(env)), env.state()]
    belief = env.belief()
    return digest([shown, belief.map.levels, belief.positions])


def random_episode(env, seed) -> bytes:
    """One episode of random actions, feasible and infeasible ones."""
    rng = np.random.default_rng(seed)
    return episode_digest(env, seed, lambda env: random_actions(env, rng))


def trajectory_hashes(env_id, mode) -> list[str]:
    """Eight hexadecimal digits of each of `N_EPISODES` episodes of an id in an action mode."""
    env = pettingzoo.make(
        "parallel", env_id, action_mode=mode, n_candidates=8, max_scans=SCANS[env_id]
    )
    env = getattr(env, "unwrapped", env)
    try:
        return [random_episode(env, seed).hex()[:8] for seed in range(N_EPISODES)]
    finally:
        env.close()


def planner_hashes(env_id, name, n_episodes=3) -> list[str]:
    """The same of episodes in which a planner acts."""
    env = pettingzoo.make("parallel", env_id, max_scans=SCANS[env_id])
    env = getattr(env, "unwrapped", env)
    policy = coopmap_baselines.make(name, **PLANNERS[name])
    hashes = []
    for seed in range(n_episodes):
        policy.reset(np.random.default_rng(seed))
        shown = episode_digest(env, seed, lambda env: policy.act(env.belief(), {}))
        hashes.append(shown.hex()[:8])
    env.close()
    return hashes


def all_hashes() -> dict[str, str]:
    """Hashes of all ids, in both action modes and with each planner."""
    found = {}
    for env_id in SCANS:
        for mode in MODES:
            found[f"{env_id} {mode}"] = " ".join(trajectory_hashes(env_id, mode))
        for name in PLANNERS:
            found[f"{env_id} {name}"] = " ".join(planner_hashes(env_id, name))
    return found


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(json.dumps(all_hashes(), indent=1) + "\n")
