"""Environments stepped one after the other, which write into the arrays of a vector environment.

The same code runs in the main process and in each worker.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from gymnasium import spaces

from coopmap_env.vector.step_arrays import ArrayPlan, StepArrays, robot_slices
from coopmap_env.vector.team_spaces import Team, TeamSpaces
from coopmap_env.vector.world_access import naming_world

EnvFactory: TypeAlias = "Callable[[], Team]"


class WorldBlock:
    """Some of the worlds of a vector environment.

    Parameters
    ----------
    env_factory : callable
        Makes a new environment.
    worlds : range
        Which; indices into the arrays.
    with_state : bool
        Whether the state is observed.

    Raises
    ------
    ValueError
        If the factory returns the same environment twice. The environments are closed then.
    """

    def __init__(self, env_factory: EnvFactory, worlds: range, with_state: bool) -> None:
        self._envs: dict[int, Team] = {}
        try:
            for world in worlds:
                self._envs[world] = env_factory()
            if len({id(env) for env in self._envs.values()}) < len(worlds):
                raise ValueError("env_factory must make a new environment on each call")
            self.team = TeamSpaces.from_env(self._envs[worlds[0]], with_state)
        except BaseException:
            self.close()
            raise

    def connect(self, plan: ArrayPlan, memory: Any, n_states: int) -> None:
        """Take the memory to read actions from and write results to."""
        self._actions, self._buffers = plan.arrays(memory)
        self._n_states = n_states
        self._slices = robot_slices(self.team)

    def advance(
        self,
        buffer: int,
        stepped: Sequence[int],
        reset: Sequence[int],
        seeds: Sequence[int | None],
        options: dict[str, Any] | None,
    ) -> None:
        """See `MappingVectorEnv._advance`."""
        arrays = self._buffers[buffer]
        for world, seed in zip(reset, seeds, strict=True):
            with naming_world(world):
                env = self._envs[world]
                observations, infos = env.reset(seed=seed, options=options)
                self._write(arrays, world, observations, infos)
        for world in stepped:
            with naming_world(world):
                self._step(arrays, world)

    def ready(self) -> None:
        """Do nothing: the reply says that the environments were made."""

    def apply(self, worlds: Sequence[int], function: Callable[..., Any], *arguments: Any) -> Any:
        """See `MappingVectorEnv.apply`."""
        results = []
        for world in worlds:
            with naming_world(world):
                results.append(function(self._envs[world], *arguments))
        return results

    def world(self, index: int) -> Team:
        """The environment of one world."""
        return self._envs[index]

    def close(self) -> None:
        """Close all environments; repeated calls do nothing."""
        while self._envs:
            self._envs.popitem()[1].close()

    def _step(self, arrays: StepArrays, world: int) -> None:
        robots = self.team.robots
        observations, rewards, terminated, truncated, infos = self._envs[world].step(
            self._actions_of(world)
        )
        for index, robot in enumerate(robots):
            arrays.rewards[world, index] = rewards[robot]
            arrays.terminations[world, index] = terminated[robot]
            arrays.truncations[world, index] = truncated[robot]
        done = arrays.terminations[world] | arrays.truncations[world]
        if done.any() != done.all():
            ends = dict(zip(robots, done.tolist(), strict=True))
            raise RuntimeError(f"robots must end their episode together, got {ends}")
        self._write(arrays, world, observations, infos)

    def _actions_of(self, world: int) -> dict[str, Any]:
        robots, actions = self.team.robots, self._actions[world]
        if isinstance(self.team.actions[0], spaces.Discrete):
            return dict(zip(robots, actions, strict=True))
        given, start = {}, 0
        for robot, space in zip(robots, self.team.actions, strict=True):
            shape = space.shape or ()
            stop = start + int(np.prod(shape))
            given[robot] = actions[start:stop].reshape(shape).copy()
            start = stop
        return given

    def _write(
        self,
        arrays: StepArrays,
        world: int,
        observations: Mapping[str, Any],
        infos: Mapping[str, Any],
    ) -> None:
        for index, (robot, parts) in enumerate(zip(self.team.robots, self._slices, strict=True)):
            for key, part in parts.items():
                arrays.observations[key][world, part] = observations[robot][key]
            for key, values in arrays.infos.items():
                values[world, index] = infos[robot][key]
        if self.team.state is not None:
            state = self._envs[world].state()
            arrays.observations["state"][world] = np.concatenate([state] * self._n_states)
