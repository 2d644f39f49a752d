"""Single environments, stepped one by one as the rows of a vector environment."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.envs import MappingEnv
from coopmap_env.studies.equality.shown import RESULTS, Entries, Shown, stack_infos


class _WorldStep(NamedTuple):
    """What one world shows; each is a list of an entry for each robot."""

    observations: list[Any]
    infos: list[Any]
    results: list[tuple[float, bool, bool]]
    last: tuple[list[Any], list[Any]] | None


class SingleWorlds:
    """Environments of their own, with the automatic resets of `coopmap_env.vector`.

    Parameters
    ----------
    make : callable
        Makes an environment.
    n_worlds : int
    resets_in_same_step : bool
        "SameStep"; otherwise "NextStep".
    """

    def __init__(
        self, make: Callable[[], MappingEnv[Any]], n_worlds: int, resets_in_same_step: bool
    ) -> None:
        self.envs = [make() for _ in range(n_worlds)]
        self._same_step = resets_in_same_step

    def reset(self, seeds: Sequence[int]) -> Shown:
        """Start an episode in each world."""
        return _stack([_reset(env, s) for env, s in zip(self.envs, seeds, strict=True)], False)

    def step(self, actions: NDArray[Any]) -> Shown:
        """Step or reset each world; actions by row."""
        by_world = np.split(actions, len(self.envs))
        return _stack([self._step(*pair) for pair in zip(self.envs, by_world, strict=True)], True)

    def _step(self, env: MappingEnv[Any], actions: NDArray[Any]) -> _WorldStep:
        if not env.agents:
            return _reset(env, None)
        robots = env.possible_agents
        observations, rewards, terminated, truncated, infos = env.step(
            dict(zip(robots, actions, strict=True))
        )
        results = [(rewards[robot], terminated[robot], truncated[robot]) for robot in robots]
        own = [observations[robot] for robot in robots], [infos[robot] for robot in robots]
        if env.agents or not self._same_step:
            return _WorldStep(*own, results, None)
        first = _reset(env, None)
        return first._replace(results=results, last=own)

    def close(self) -> None:
        """Close all environments."""
        for env in self.envs:
            env.close()


def _reset(env: MappingEnv[Any], seed: int | None) -> _WorldStep:
    observations, infos = env.reset(seed=seed)
    robots = env.possible_agents
    results = [(0.0, False, False)] * len(robots)
    return _WorldStep(
        [observations[robot] for robot in robots], [infos[robot] for robot in robots], results, None
    )


def _stack(worlds: list[_WorldStep], has_results: bool) -> Shown:
    now = _entries(
        [o for w in worlds for o in w.observations], [i for w in worlds for i in w.infos]
    )
    if has_results:
        by_name = zip(*(result for world in worlds for result in world.results), strict=True)
        now |= {name: np.array(values) for name, values in zip(RESULTS, by_name, strict=True)}
    n_robots = len(worlds[0].results)
    ended = [k for k, world in enumerate(worlds) if world.last is not None]
    rows = np.array([k * n_robots + robot for k in ended for robot in range(n_robots)], dtype=int)
    if not ended:
        return Shown(now, rows, {})
    kept = [world.last for world in worlds if world.last is not None]
    last = _entries([o for own, _ in kept for o in own], [i for _, own in kept for i in own])
    last["final_info"] = np.ones(len(rows), dtype=bool)
    return Shown(now, rows, last)


def _entries(observations: list[Any], infos: list[Any]) -> Entries:
    entries = {
        f"observation {key}": np.stack([one[key] for one in observations])
        for key in observations[0]
    }
    return entries | stack_infos(infos)
