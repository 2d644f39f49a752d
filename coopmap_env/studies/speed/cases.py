"""What is timed of an environment, in this version and in an earlier one.

`CASES` has one entry for each kind of environment. A case is added here, and then appears in
`coopmap bench` or in `python -m coopmap_env.studies.speed.regression`, which runs this file as a
program with an earlier version of the package. So it uses nothing but numpy and what the
package's users use.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from coopmap_env import field_v1, planar_v1

Timings = dict[str, list[float]]
"""Seconds of a processor that each operation took, by kind, in an order that never changes."""
Run = Callable[[], Timings]
"""Does the same operations at each call."""

SCANS_EACH = 16
"""Length of an episode."""
N_WORLDS = 32
"""Of a vector environment."""


def sample_actions(env: Any, rng: np.random.Generator) -> dict[str, Any]:
    """Actions from the whole action space."""
    return {agent: env.action_space(agent).sample() for agent in env.agents}


def feasible_actions(env: Any, rng: np.random.Generator) -> dict[str, Any]:
    """Poses that each robot believes it can reach, so that all of them move."""
    belief = env.belief()
    return {
        agent: belief.action_for(robot, belief.random_poses(robot, 1, rng)[0])
        for robot, agent in enumerate(env.agents)
    }


def random_episodes(
    env: Any,
    episodes: int,
    choose: Callable[[Any, np.random.Generator], dict[str, Any]] = sample_actions,
) -> Run:
    """Random actions of seeded episodes: times of ``sampling``, ``step`` and ``reset``.

    Parameters
    ----------
    env : pettingzoo.ParallelEnv
        Equal seeds give equal episodes.
    episodes : int
        Seeds 0, 1, ... of the worlds.
    choose : callable
        Samples the actions of a step.
    """

    def run() -> Timings:
        timings: Timings = {"sampling": [], "step": [], "reset": []}
        clock, rng = time.process_time, np.random.default_rng(0)
        for k, agent in enumerate(env.possible_agents):
            env.action_space(agent).seed(k)
        for seed in range(episodes):
            start = clock()
            env.reset(seed=seed)
            timings["reset"].append(clock() - start)
            while env.agents:
                start = clock()
                actions = choose(env, rng)
                sampled = clock()
                env.step(actions)
                stepped = clock()
                timings["sampling"].append(sampled - start)
                timings["step"].append(stepped - sampled)
        return timings

    return run


def vector_episodes(env: Any, episodes: int, clock: Callable[[], float] = time.process_time) -> Run:
    """Random actions in all worlds: times of ``sampling``, ``step`` and ``reset`` of them all.

    Parameters
    ----------
    env : MappingVectorEnv
        With ``autoreset_mode="Disabled"``: all worlds are reset by one call.
    episodes : int
        Of each world.
    clock : callable
        Seconds; those of a wall for threads and workers.
    """

    def run() -> Timings:
        timings: Timings = {"sampling": [], "step": [], "reset": []}
        env.action_space.seed(0)
        for episode in range(episodes):
            start = clock()
            env.reset(seed=episode * env.n_worlds)
            timings["reset"].append(clock() - start)
            for _ in range(SCANS_EACH):
                start = clock()
                actions = env.action_space.sample()
                sampled = clock()
                env.step(actions)
                stepped = clock()
                timings["sampling"].append(sampled - start)
                timings["step"].append(stepped - sampled)
        return timings

    return run


def planar_pose() -> Run:
    """Two robots, any pose in reach."""
    return random_episodes(planar_v1.parallel_env(max_scans=SCANS_EACH), episodes=8)


def planar_candidates() -> Run:
    """Two robots, 32 candidates."""
    env = planar_v1.parallel_env(max_scans=SCANS_EACH, action_mode="candidates")
    return random_episodes(env, episodes=4)


def planar_vector(action_mode: str, n_worlds: int = N_WORLDS, **options: Any) -> Any:
    """Worlds of two robots in one call."""
    return planar_v1.vector_env(
        n_worlds, autoreset_mode="Disabled", max_scans=SCANS_EACH, action_mode=action_mode,
        **options,
    )  # fmt: skip


def planar_vector_pose() -> Run:
    """32 worlds of two robots, any pose in reach."""
    return vector_episodes(planar_vector("pose"), episodes=2)


def planar_vector_candidates() -> Run:
    """32 worlds of two robots, 32 candidates."""
    return vector_episodes(planar_vector("candidates"), episodes=1)


def field() -> Run:
    """Two robots with masts, feasible joints."""
    return random_episodes(field_v1.parallel_env(max_scans=SCANS_EACH), 1, feasible_actions)


def unmasked_actions(env: Any, rng: np.random.Generator) -> dict[str, Any]:
    """Any of the candidates that are offered."""
    return {
        agent: int(rng.choice(len(env.belief().candidates[robot])))
        for robot, agent in enumerate(env.agents)
    }


def field_candidates() -> Run:
    """Two robots with masts, 32 candidates."""
    env = field_v1.parallel_env(max_scans=SCANS_EACH, action_mode="candidates")
    return random_episodes(env, 1, unmasked_actions)


CASES: dict[str, Callable[[], Run]] = {
    "planar_pose": planar_pose,
    "planar_candidates": planar_candidates,
    "planar_vector_pose": planar_vector_pose,
    "planar_vector_candidates": planar_vector_candidates,
    "field": field,
    "field_candidates": field_candidates,
}
"""Makes what is timed; the first call of it compiles the kernels."""


def serve() -> None:
    """Answer lines with names of cases by lines of JSON: timings of a run, or an error."""
    runs: dict[str, Run] = {}
    for line in sys.stdin:
        name = line.strip()
        try:
            if name not in runs:
                runs[name] = CASES[name]()
            answer: dict[str, Any] = {"timings": runs[name]()}
        except Exception as error:  # the earlier version may not have what a new case needs
            answer = {"error": f"{type(error).__name__}: {error}"}
        print(json.dumps(answer), file=sys.__stdout__, flush=True)


if __name__ == "__main__":
    serve()
