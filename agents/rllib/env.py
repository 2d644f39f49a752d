"""A vector environment in RLlib: each robot is a row, and for RLlib an environment of its own.

RLlib's adapter of multi-agent environments reports truncation for each robot, which RLlib ignores,
and handles one robot after the other. As rows of a vector environment, robots are truncated as any
environment is, and share one policy.
"""

from __future__ import annotations

import contextlib
import logging
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple, TypeVar

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray
from ray.rllib.env.single_agent_env_runner import SingleAgentEnvRunner

from coopmap_agents.trainer import add_rewards, make_rows
from coopmap_env.envs import Observation
from coopmap_env.vector import EnvFactory, WorkerVectorEnv

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


class RLlibRows(VectorEnv[Observation, NDArray[Any], NDArray[Any]]):
    """The rows of a vector environment, for RLlib's runners of single agents.

    RLlib keeps what it gets, so observations are copies. Infos are left out: RLlib does not need
    them, and would send them all to the learner.

    Parameters
    ----------
    context : mapping
        With the entries ``env_factory``, ``team_spaces`` (`SharedSpaces`) and ``seed``, from
        `coopmap_agents.rllib.make_config`, and RLlib's ``num_envs``, the number of rows.
    """

    def __init__(self, context: Mapping[str, Any]) -> None:
        team_spaces: SharedSpaces = context["team_spaces"]
        self._env = env = make_rows(
            context["env_factory"],
            context["num_envs"] // len(team_spaces.robots),
            workers=0,
            with_state="state" in team_spaces.observation_space.spaces,
            autoreset_mode=AutoresetMode.NEXT_STEP,
        )
        self._entropy = context["seed"]
        self.num_envs, self.metadata, self.render_mode = env.num_envs, env.metadata, None
        self.single_observation_space = env.single_observation_space
        self.single_action_space = env.single_action_space
        self.observation_space, self.action_space = env.observation_space, env.action_space
        self._running_returns = np.zeros(env.num_envs)
        self.returns: list[float] = []
        """Sum of rewards of each robot in each episode that ended."""
        self.seconds = 0.0
        """Time spent in the environment."""

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode in each world.

        RLlib's seeds are consecutive over its workers, so some would be equal in two trainings.
        Therefore they are mixed with the training's seed.
        """
        seeds = None
        if seed is not None:
            mixed = np.random.SeedSequence((self._entropy, seed))
            seeds = mixed.generate_state(self._env.n_worlds).tolist()
        observations, _ = self._timed(lambda: self._env.reset(seed=seeds, options=options))
        self._running_returns[:] = 0.0
        return _copied(observations), {}

    def step(
        self, actions: NDArray[Any]
    ) -> tuple[Observation, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Step all worlds, and reset those that have ended in the step before."""
        observations, rewards, terminated, truncated, _ = self._timed(
            lambda: self._env.step(actions)
        )
        self.returns += add_rewards(self._running_returns, rewards, terminated | truncated)
        return _copied(observations), rewards.copy(), terminated.copy(), truncated.copy(), {}

    def close_extras(self, **kwargs: Any) -> None:
        """Close the vector environment."""
        self._env.close()

    def _timed(self, function: Callable[[], Result]) -> Result:
        start = time.perf_counter()
        result = function()
        self.seconds += time.perf_counter() - start
        return result


class RowsRunner(SingleAgentEnvRunner):
    """RLlib's runner of environments, whose errors reach the main process."""

    def apply(self, func: Callable[..., Result], *arguments: Any, **options: Any) -> Result:
        """Call a function with this runner; its errors are raised, not the end of the process."""
        return func(self, *arguments, **options)


def collect_statistics(runner: Any) -> tuple[float, list[float]]:
    """Seconds and returns of the environment of a runner."""
    env: RLlibRows = runner.env.unwrapped
    return env.seconds, env.returns


@contextlib.contextmanager
def suppress_rllib_warnings() -> Iterator[None]:
    """Suppress two warnings: about RLlib's new API, and about a name registered twice."""
    logger = logging.getLogger("ray.rllib")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message=".*Overriding environment rllib-single-agent")
            yield
    finally:
        logger.setLevel(level)


def _copied(observations: Observation) -> Observation:
    return {key: values.copy() for key, values in observations.items()}
