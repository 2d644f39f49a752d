"""A block of environments, stepped together: the same code in the main process and in a worker.

Nothing here needs torch or Stable-Baselines3, so worker processes do not load them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

if TYPE_CHECKING:  # workers with other environments need not load coopmap_env
    from coopmap_env.envs import Observation

Team: TypeAlias = "ParallelEnv[str, Observation, Any]"
EnvFactory: TypeAlias = "Callable[[], Team]"
Info = dict[str, Any]


def stack(observations: Iterable[Observation]) -> Observation:
    """Stack the observations of n robots: each entry gets a first axis of length n."""
    rows = list(observations)
    return {key: np.stack([row[key] for row in rows]) for key in rows[0]}


class TeamSpaces(NamedTuple):
    """Names and spaces, which all environments of a block have in common."""

    robots: tuple[str, ...]
    observation_space: spaces.Dict
    action_space: spaces.Space[Any]


class TeamObservation(NamedTuple):
    """Observation of one environment."""

    rows: list[Observation]
    """One observation for each robot."""
    shared: Observation
    """The entry "state", which all robots share, if it was requested; else empty. It can be far
    larger than the others, so it goes through a pipe once, not once for each robot."""


class StackedTeamObservation(NamedTuple):
    """Observations of several environments, stacked."""

    rows: Observation
    """Entries of shape (n_envs * n_robots, ...)."""
    shared: Observation
    """Entries of shape (n_envs, ...)."""


class EnvStep(NamedTuple):
    """Result of a step of one environment."""

    observation: TeamObservation
    """The first one of the next episode if this one has ended."""
    rewards: list[float]
    ended: bool
    infos: list[Info]
    reset_infos: list[Info | None]
    """None if the episode has not ended."""


class BlockStep(NamedTuple):
    """Result of a step of a block; row ``i * n_robots + r`` is robot r of environment i."""

    observation: StackedTeamObservation
    rewards: NDArray[np.float32]
    dones: NDArray[np.bool_]
    infos: list[Info]
    reset_infos: list[Info | None]


class TeamBlock:
    """`n_envs` parallel environments, stepped one after the other.

    Parameters
    ----------
    env_factory, n_envs, with_state
        As in `coopmap_agents.sb3.SharedPolicyVecEnv`, for this block.

    Raises
    ------
    ValueError
        If the factory returns the same environment twice, robots have different spaces, or
        `with_state` is set for an environment without state. The environments are closed then.
    """

    def __init__(self, env_factory: EnvFactory, n_envs: int, with_state: bool = False) -> None:
        self._envs: list[Team] = []
        self._with_state = with_state
        try:
            for _ in range(n_envs):
                self._envs.append(env_factory())
            if len({id(env) for env in self._envs}) < n_envs:
                raise ValueError("env_factory must make a new environment on each call")
            self._team_spaces = _common_spaces(self._envs[0], with_state)
        except BaseException:
            self.close()
            raise

    def team_spaces(self) -> TeamSpaces:
        """Names and spaces of the first environment."""
        return self._team_spaces

    def reset(
        self, seeds: Sequence[int | None], options: Sequence[dict[str, Any] | None]
    ) -> tuple[StackedTeamObservation, list[Info]]:
        """Start an episode in each environment, each with its own seed and options."""
        resets = [
            self._reset_env(env, seed=seed, options=own)
            for env, seed, own in zip(self._envs, seeds, options, strict=True)
        ]
        return stack_team_observations(observation for observation, _ in resets), [
            info for _, infos in resets for info in infos
        ]

    def step(self, actions: NDArray[Any]) -> BlockStep:
        """Step all environments, and reset those that are done.

        Parameters
        ----------
        actions : (n_envs * n_robots, ...) array
        """
        n_robots = len(self._team_spaces.robots)
        env_actions = actions.reshape(len(self._envs), n_robots, *actions.shape[1:])
        steps = [self._step_one(env, own) for env, own in zip(self._envs, env_actions, strict=True)]
        return BlockStep(
            stack_team_observations(step.observation for step in steps),
            np.array([reward for step in steps for reward in step.rewards], dtype=np.float32),
            np.repeat([step.ended for step in steps], n_robots),
            [info for step in steps for info in step.infos],
            [info for step in steps for info in step.reset_infos],
        )

    def apply(
        self, numbers: Sequence[int], function: Callable[..., Any], *arguments: Any
    ) -> list[Any]:
        """Results of ``function(env, *arguments)`` for the environments of these numbers."""
        return [function(self._envs[i], *arguments) for i in numbers]

    def close(self) -> None:
        """Close all environments; repeated calls do nothing."""
        while self._envs:
            self._envs.pop(0).close()

    def _step_one(self, env: Team, actions: NDArray[Any]) -> EnvStep:
        robots = self._team_spaces.robots
        observations, rewards, terminated, truncated, env_infos = env.step(
            dict(zip(robots, actions, strict=True))
        )
        done = {robot: bool(terminated[robot] or truncated[robot]) for robot in robots}
        if len(set(done.values())) > 1:
            raise RuntimeError(f"robots must end their episode together, got {done}")
        observation = self._observe(env, observations)
        infos: list[Info] = [dict(env_infos[robot]) for robot in robots]
        for robot, info in zip(robots, infos, strict=True):
            info["TimeLimit.truncated"] = bool(truncated[robot] and not terminated[robot])
        ended = done[robots[0]]
        reset_infos: list[Info | None] = [None] * len(robots)
        if ended:
            for info, last in zip(infos, observation.rows, strict=True):
                info["terminal_observation"] = {**last, **observation.shared}
            observation, reset_infos[:] = self._reset_env(env)
        return EnvStep(observation, [rewards[robot] for robot in robots], ended, infos, reset_infos)

    def _reset_env(self, env: Team, **arguments: Any) -> tuple[TeamObservation, list[Info]]:
        observations, infos = env.reset(**arguments)
        return self._observe(env, observations), [
            infos[robot] for robot in self._team_spaces.robots
        ]

    def _observe(self, env: Team, observations: dict[str, Observation]) -> TeamObservation:
        shared: Observation = {"state": env.state()} if self._with_state else {}
        return TeamObservation([observations[robot] for robot in self._team_spaces.robots], shared)


def stack_team_observations(envs: Iterable[TeamObservation]) -> StackedTeamObservation:
    """Stack the observations of several environments."""
    observations = list(envs)
    rows = stack(row for env in observations for row in env.rows)
    return StackedTeamObservation(rows, stack(env.shared for env in observations))


def concatenate_blocks(blocks: Iterable[StackedTeamObservation], n_robots: int) -> Observation:
    """Concatenate the observations of several blocks; shared entries are repeated in all rows."""
    parts = list(blocks)
    rows = {key: np.concatenate([part.rows[key] for part in parts]) for key in parts[0].rows}
    for key in parts[0].shared:
        rows[key] = np.concatenate([part.shared[key] for part in parts]).repeat(n_robots, axis=0)
    return rows


def _common_spaces(env: Team, with_state: bool) -> TeamSpaces:
    robots = tuple(env.possible_agents)
    both = env.observation_space(robots[0]), env.action_space(robots[0])
    observation_space, action_space = both
    if not isinstance(observation_space, spaces.Dict):
        raise ValueError(f"observations must be a Dict space, got {observation_space}")
    for robot in robots:
        own = env.observation_space(robot), env.action_space(robot)
        if own != both:
            raise ValueError(
                f"robots that share a policy must share their spaces: {robot} has {own}, "
                f"{robots[0]} has {both}"
            )
    if with_state:
        observation_space = _with_state(observation_space, env)
    return TeamSpaces(robots, observation_space, action_space)


def _with_state(space: spaces.Dict, env: Team) -> spaces.Dict:
    state_space = getattr(env, "state_space", None)
    if state_space is None:
        raise ValueError(f"with_state=True needs an environment with a state_space, not {env}")
    if "state" in space.spaces:
        raise ValueError('with_state=True would overwrite the entry "state" of the observations')
    return spaces.Dict({**space.spaces, "state": state_space})
