"""A team as an environment of RLlib.

RLlib's own adapter of PettingZoo reports truncation for each robot, which RLlib ignores: the time
limit would count as termination. Here truncation is reported once, for the whole team. Robots are
named by their numbers: RLlib keeps names in sets, and the order of strings in a set, and so of the
rows of a batch, would differ from process to process.
"""

from __future__ import annotations

import contextlib
import logging
import time
import warnings
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple, TypeVar

import numpy as np
from gymnasium import spaces
from ray.rllib.env.env_context import EnvContext
from ray.rllib.env.multi_agent_env import MultiAgentEnv
from ray.rllib.env.multi_agent_env_runner import MultiAgentEnvRunner

from coopmap_env.envs import Observation
from coopmap_env.vector import EnvFactory, WorkerVectorEnv

Observations = dict[Any, Observation]
"""By the number of the robot; the key is Any, as in RLlib."""
Flags = dict[Any, bool]
Result = TypeVar("Result")


class SharedSpaces(NamedTuple):
    """Names of a team's robots, and the spaces that they have in common."""

    robots: tuple[str, ...]
    observation_space: spaces.Dict
    action_space: spaces.Space[Any]


def shared_spaces(env_factory: EnvFactory, with_state: bool) -> SharedSpaces:
    """Names and spaces of the robots that a factory's environments have.

    Raises
    ------
    ValueError
        If robots have different spaces, or there is no state where it is needed.
    """
    with contextlib.closing(WorkerVectorEnv(env_factory, 1, with_state=with_state)) as env:
        assert isinstance(env.single_observation_space, spaces.Dict)
        return SharedSpaces(env.robots, env.single_observation_space, env.single_action_space)


class RLlibTeamEnv(MultiAgentEnv):
    """A parallel environment whose robots end their episode together.

    Infos are left out: RLlib does not need them, and would send them all to the learner.

    Parameters
    ----------
    context : EnvContext
        With the entries ``env_factory``, ``team_spaces`` (`SharedSpaces`) and ``seed``, from
        `coopmap_agents.rllib.make_config`.
    """

    def __init__(self, context: EnvContext) -> None:
        super().__init__()
        team_spaces = context["team_spaces"]
        self._env = context["env_factory"]()
        self._with_state = "state" in team_spaces.observation_space.spaces
        self._entropy = (context["seed"], context.worker_index)
        self._robots = team_spaces.robots
        self.possible_agents = list(range(len(team_spaces.robots)))
        self.agents = self.possible_agents
        self.observation_spaces = dict.fromkeys(self.agents, team_spaces.observation_space)
        self.action_spaces = dict.fromkeys(self.agents, team_spaces.action_space)
        self._returns = [0.0] * len(team_spaces.robots)
        self.returns: list[float] = []
        """Sum of rewards of each robot in each episode that ended."""
        self.seconds = 0.0
        """Time spent in the environment."""

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, dict[Any, Any]]:
        """Start an episode.

        RLlib's seeds are consecutive, over workers and over environments, so some would be equal.
        Therefore they are mixed with the training's seed and the worker's number.
        """
        if seed is not None:
            mixed = np.random.SeedSequence((*self._entropy, seed))
            seed = int(mixed.generate_state(1)[0])
        observations, _ = self._timed(lambda: self._env.reset(seed=seed, options=options))
        self._returns = [0.0] * len(self._robots)
        return self._by_number(observations), {}

    def step(  # type: ignore[override]  # the parent already differs from Gymnasium's
        self, action_dict: dict[Any, Any]
    ) -> tuple[Observations, dict[Any, float], Flags, Flags, dict[Any, Any]]:
        """Step all robots.

        Raises
        ------
        RuntimeError
            If some robots have ended their episode and others have not.
        """
        actions = {robot: action_dict[i] for i, robot in enumerate(self._robots)}
        observations, rewards, terminated, truncated, _ = self._timed(
            lambda: self._env.step(actions)
        )
        ends = {(bool(terminated[robot]), bool(truncated[robot])) for robot in self._robots}
        if len(ends) > 1:
            raise RuntimeError(
                f"robots must end their episode together, got terminated {terminated} and "
                f"truncated {truncated}"
            )
        is_terminated, is_truncated = ends.pop()
        row = [float(rewards[robot]) for robot in self._robots]
        self._returns = [total + reward for total, reward in zip(self._returns, row, strict=True)]
        if is_terminated or is_truncated:
            self.returns += self._returns
        return (
            self._by_number(observations),
            dict(enumerate(row)),
            {"__all__": is_terminated},
            {"__all__": is_truncated and not is_terminated},
            {},
        )

    def close(self) -> None:
        """Close the environment."""
        self._env.close()

    def _by_number(self, observations: dict[str, Observation]) -> Observations:
        """Observations by the robots' numbers, with the state if the critic uses it."""
        state = {"state": self._env.state()} if self._with_state else {}
        return {i: {**observations[robot], **state} for i, robot in enumerate(self._robots)}

    def _timed(self, function: Callable[[], Result]) -> Result:
        start = time.perf_counter()
        result = function()
        self.seconds += time.perf_counter() - start
        return result


class TeamEnvRunner(MultiAgentEnvRunner):
    """RLlib's runner of environments, whose errors reach the main process."""

    def apply(self, func: Callable[..., Result], *arguments: Any, **options: Any) -> Result:
        """Call a function with this runner; its errors are raised, not the end of the process."""
        return func(self, *arguments, **options)


def collect_statistics(runner: Any) -> tuple[float, list[float]]:
    """Seconds and returns of all environments of a runner."""
    envs = [env.unwrapped for env in runner.env.envs]
    return sum(env.seconds for env in envs), [value for env in envs for value in env.returns]


@contextlib.contextmanager
def suppress_rllib_warnings() -> Iterator[None]:
    """Suppress two warnings: about RLlib's new API, and about a name registered twice."""
    logger = logging.getLogger("ray.rllib")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message=".*Overriding environment rllib-multi-agent")
            yield
    finally:
        logger.setLevel(level)
