"""Process that plays episodes of the field and tells how long each step took; any commit's code.

``python _step_times.py MODE N_EPISODES`` with that code on PYTHONPATH. For each line on its input
it plays the same episodes once and answers with one line of JSON: for each step the process time of
`env.step` and of its scans and their fusion, seconds.
"""

import json
import sys
import time
from typing import Any

import numpy as np

from coopmap_env import field_v1


def play(env: Any, seed: int, fusion_times: list[float]) -> list[tuple[float, float]]:
    """Process times of the steps of one episode, and of the fusion in each."""
    observations, _ = env.reset(seed=seed)
    rng, times = np.random.default_rng(seed), []
    while env.agents:
        belief = env.belief()
        actions = {}
        for robot, agent in enumerate(env.agents):
            if "action_mask" in observations[agent]:
                feasible = np.flatnonzero(observations[agent]["action_mask"])
                actions[agent] = int(rng.choice(feasible))
            else:
                pose = belief.random_poses(robot, 1, rng)[0]
                actions[agent] = belief.action_for(robot, pose)
        start = time.process_time()
        observations, *_ = env.step(actions)
        times.append((time.process_time() - start, fusion_times.pop()))
    return times


def main() -> None:
    """Answer each line of the input with one round."""
    mode, n_episodes = sys.argv[1], int(sys.argv[2])
    make: Any = field_v1.parallel_env
    env = make(action_mode=mode, n_candidates=32)
    fuse = env._fuse_scans
    fusion_times: list[float] = []

    def timed_fuse(*args: Any) -> Any:
        start = time.process_time()
        fused = fuse(*args)
        fusion_times.append(time.process_time() - start)
        return fused

    env._fuse_scans = timed_fuse
    for _ in sys.stdin:
        times = [t for seed in range(n_episodes) for t in play(env, seed, fusion_times)]
        print(json.dumps(times), flush=True)


if __name__ == "__main__":
    main()
