"""Trajectories of every registered id, in hashes that do not depend on names or wording.

In `tests`, ``python -m plain.golden golden/trajectories.json`` records what the environments do
now: only for a change of behaviour, which gets a new ``-vN`` and a line in CHANGELOG. The hashes
hold on every x86-64 processor.
"""

import hashlib
import json
import math
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
N_PLAYED = {"coopmap/Planar-v1": 100, "coopmap/Field-v1": 16, "coopmap/FieldSearch-v1": 12}
"""Episodes that are played without ``-m long``: those of the field take most of the time."""
MODES = ("pose", "candidates")
SCANS = {"coopmap/Planar-v1": 8, "coopmap/Field-v1": 3, "coopmap/FieldSearch-v1": 4}
"""Scans of each robot in an episode."""
M_40 = {"search": 40, "coordination": "sequential"}
PLANNERS = {
    "rating_function": M_40,
    "information_gain": M_40,
    "coverage": M_40,
    "frontier": {"utility": "nearest"},
    "raster": {},
    "random": {},
}
"""Options of each planner."""
PARTS = (*MODES, *PLANNERS)


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
    """Everything that one episode returns: observations, rewards, ends, infos, states, the map.

    In the form that it had when the hashes were recorded.
    """
    shown = [as_recorded(env.reset(seed=seed)), env.state()[:-2]]
    while env.agents:
        shown += [as_recorded(env.step(act(env))), env.state()[:-2]]
    belief = env.belief()
    return digest([shown, belief.map.log_odds_fixed, belief.positions])


AFTER_A_RESET = ("n_scans", "observed_fraction", "shown_fraction")
"""Entries that infos had after a reset."""
REASONS = ("rejected_reason", "localization_failure", "correction_failure")
"""Entries that were texts, and empty without a reason."""


def as_recorded(returned):
    """What `reset` or `step` returned, as it was when the hashes were recorded.

    Nothing knew of the time and what is left of the episode. Infos had action masks and texts,
    reward terms in a dict, None where a number is not known, and less after a reset.
    """
    observations, *others, infos = returned
    old = {}
    for agent, observation in observations.items():
        del observation["budget"]
        info = infos[agent]
        del info["elapsed_time"]
        old[agent] = old_info(info) if others else {k: info[k] for k in AFTER_A_RESET if k in info}
        if "action_mask" in observation:
            old[agent]["action_mask"] = observation["action_mask"]
    return (observations, *others, old)


def old_info(info):
    """The info after a step in its old form; the names of its entries do not count."""
    old = {key: value for key, value in info.items() if not key.startswith("reward_")}
    old["reward_terms"] = {key: info[key] for key in info if key not in old}
    for key in REASONS:
        if key in old:
            old[key] = "some reason" if old[key] else ""
    if "located" in old:
        old["collided_with"] = "something" if old["collided"] else ""
        for key in ("base_error", "base_angle_error"):
            old[key] = None if math.isinf(old[key]) else old[key]
    return old


def random_episode(env, seed) -> bytes:
    """One episode of random actions, feasible and infeasible ones."""
    rng = np.random.default_rng(seed)
    return episode_digest(env, seed, lambda env: random_actions(env, rng))


def make_env(env_id, **kwargs):
    """The environment of an id without wrappers."""
    env = pettingzoo.make("parallel", env_id, max_scans=SCANS[env_id], **kwargs)
    return getattr(env, "unwrapped", env)


def trajectory_hashes(env_id, mode, n_episodes=N_EPISODES, **kwargs) -> list[str]:
    """Eight hexadecimal digits of each episode of an id in an action mode."""
    env = make_env(env_id, action_mode=mode, n_candidates=8, **kwargs)
    try:
        return [random_episode(env, seed).hex()[:8] for seed in range(n_episodes)]
    finally:
        env.close()


def planner_hashes(env_id, name, n_episodes=3, **kwargs) -> list[str]:
    """The same of episodes in which a planner acts."""
    env = make_env(env_id, **kwargs)
    policy = coopmap_baselines.make(name, **PLANNERS[name])
    hashes = []
    for seed in range(n_episodes):
        policy.reset(np.random.default_rng(seed))
        shown = episode_digest(env, seed, lambda env: policy.act(env.belief(), {}))
        hashes.append(shown.hex()[:8])
    env.close()
    return hashes


def hashes_of(env_id, part, n_episodes=N_EPISODES) -> list[str]:
    """Hashes of an id in an action mode, or with a planner, which plays three episodes."""
    if part in MODES:
        return trajectory_hashes(env_id, part, n_episodes)
    return planner_hashes(env_id, part)


def all_hashes(env_id) -> dict[str, str]:
    """Hashes of an id in both action modes, and with each planner."""
    return {part: " ".join(hashes_of(env_id, part)) for part in PARTS}


OLD_PROCESSOR = {
    "OPENBLAS_CORETYPE": "Prescott",
    "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL AVX512_SPR",
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX2_Usable,-FMA_Usable",
}
"""Environment variables with which BLAS, numpy and the C library of Linux take the code that they
have for an x86-64 processor without AVX2 and fused multiply-add."""


def first_hashes(env_id, n_episodes) -> dict[str, str]:
    """`all_hashes`, of the first episodes only."""
    found = {mode: " ".join(trajectory_hashes(env_id, mode, n_episodes)) for mode in MODES}
    return found | {name: " ".join(planner_hashes(env_id, name, 1)) for name in PLANNERS}


def first_hashes_with(variables, env_ids, n_episodes) -> dict[str, dict[str, str]]:
    """`first_hashes` of some ids, played in a process with other environment variables."""
    done = subprocess.run(
        [sys.executable, "-m", "plain.golden", str(n_episodes), *env_ids],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path)), **variables},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        raise RuntimeError(f"{env_ids} could not be played with {variables}:\n{done.stderr}")
    found: dict[str, dict[str, str]] = json.loads(done.stdout.splitlines()[-1])
    return found


if __name__ == "__main__":
    if sys.argv[1].isdigit():
        n = int(sys.argv[1])
        print(json.dumps({env_id: first_hashes(env_id, n) for env_id in sys.argv[2:]}))
    else:
        recorded = {env_id: all_hashes(env_id) for env_id in sys.argv[2:] or SCANS}
        Path(sys.argv[1]).write_text(json.dumps(recorded, indent=1) + "\n", encoding="utf-8")
