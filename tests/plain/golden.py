"""Trajectories of every registered id, in hashes that do not depend on names or wording.

In `tests`, ``python -m plain.golden golden/trajectories.json`` records what the environments do
now: only for a change of behaviour, which gets a new ``-vN`` and a line in CHANGELOG.
"""

import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pettingzoo
from plain.rollouts import random_actions

import coopmap_baselines
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
    messages may be reworded without a change of what happens.
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
    """Everything that one episode returns: observations, rewards, ends, infos, states, the map."""
    shown = [env.reset(seed=seed), env.state()]
    while env.agents:
        shown += [env.step(act(env)), env.state()]
    belief = env.belief()
    return digest([shown, belief.map.log_odds_fixed, belief.positions])


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


def hashes_of(env_id) -> dict[str, str]:
    """Hashes of an id in both action modes, and with each planner."""
    found = {mode: " ".join(trajectory_hashes(env_id, mode)) for mode in MODES}
    return found | {name: " ".join(planner_hashes(env_id, name)) for name in PLANNERS}


def hashes_elsewhere(env_id) -> dict[str, str]:
    """`hashes_of` in a process that rounds alike on every processor with AVX2.

    BLAS and numpy choose their kernels by the processor, and these differ in the last bit.
    """
    no_avx512 = "AVX512F AVX512CD AVX512_SKX AVX512_CLX AVX512_CNL AVX512_ICL AVX512_SPR"
    done = subprocess.run(
        [sys.executable, "-m", "plain.golden", env_id],
        env={**os.environ, "OPENBLAS_CORETYPE": "Haswell", "NPY_DISABLE_CPU_FEATURES": no_avx512,
             "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        capture_output=True,
        text=True,
        check=False,
    )  # fmt: skip
    if done.returncode:
        raise RuntimeError(f"{env_id} could not be played:\n{done.stderr}")
    found: dict[str, str] = json.loads(done.stdout.splitlines()[-1])
    return found


if __name__ == "__main__":
    if sys.argv[1] in SCANS:
        print(json.dumps(hashes_of(sys.argv[1])))
    else:
        recorded = {env_id: hashes_elsewhere(env_id) for env_id in SCANS}
        Path(sys.argv[1]).write_text(json.dumps(recorded, indent=1) + "\n", encoding="utf-8")
