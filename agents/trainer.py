"""What a training loop and an engine share; `PPOTrainer`, `SB3Trainer`, `RLlibTrainer` are engines.

Networks and logs are those of Stable-Baselines3 in all. The module stands below the engines, and so
outside of `coopmap_agents.training`, which imports them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import coopmap_agents._require_rl  # noqa: F401

# isort: split
import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from stable_baselines3.common.logger import Logger, configure
from stable_baselines3.common.policies import ActorCriticPolicy

from coopmap_agents.config import EnvConfig, PPOSettings
from coopmap_agents.networks import copy_weights
from coopmap_agents.record import SegmentReport
from coopmap_env.vector import EnvFactory, MappingVectorEnv, WorkerVectorEnv


def make_rows(
    env_factory: EnvFactory,
    n_envs: int,
    workers: int,
    with_state: bool,
    autoreset_mode: AutoresetMode = AutoresetMode.SAME_STEP,
) -> MappingVectorEnv[Any]:
    """The vector environment that a training learns from: rows are robots.

    Parameters
    ----------
    env_factory : EnvConfig or callable
        An `EnvConfig` makes the vector environment of its kind; what another callable makes is
        stepped by a `WorkerVectorEnv`.
    n_envs : int
        Number of worlds.
    workers : int
        Processes for the worlds; 0 steps them in this one.
    with_state : bool
        Adds the team's state to the observations, for a central critic.
    autoreset_mode : AutoresetMode
        When worlds are reset; see `coopmap_env.vector`.
    """
    options: dict[str, Any] = {
        "autoreset_mode": autoreset_mode,
        "with_state": with_state,
        "num_workers": workers,
    }
    if isinstance(env_factory, EnvConfig):
        return env_factory.vector_env(n_envs, **options)
    return WorkerVectorEnv(env_factory, n_envs, **options)


@contextmanager
def torch_threads(n: int) -> Iterator[None]:
    """Let torch use a number of threads in this context; with another, sums round differently."""
    before = torch.get_num_threads()
    torch.set_num_threads(n)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def add_rewards(
    returns: NDArray[np.float64], rewards: NDArray[np.float64], ends: NDArray[np.bool_]
) -> list[float]:
    """Add a step's rewards to the returns of the running episodes; gives those that ended.

    Parameters
    ----------
    returns, rewards : ndarray, shape (rows,)
        The returns are changed in place; those of ended episodes start again at 0.
    ends : ndarray of bool, shape (rows,)
        Where the step ended an episode.
    """
    returns += rewards
    ended: list[float] = returns[ends].tolist()
    returns[ends] = 0.0
    return ended


class Trainer(ABC):
    """A training, segment by segment.

    What a segment gives depends only on the network before it (weights and optimiser), the seed and
    the segment's number.

    Parameters
    ----------
    settings : PPOSettings
    seed : int
        Seed of everything.
    logs : Path, optional
        Folder of TensorBoard's logs.
    """

    def __init__(self, settings: PPOSettings, seed: int, logs: Path | None) -> None:
        self._settings = settings
        self._seed = seed
        self._logger: Logger | None = configure(str(logs), ["tensorboard"]) if logs else None
        self.report = SegmentReport()
        """Report of the last segment."""

    @property
    @abstractmethod
    def network(self) -> ActorCriticPolicy:
        """Actor and critic that are trained, no copy."""

    @property
    @abstractmethod
    def steps(self) -> int:
        """Number of steps learned from; set it after loading a checkpoint."""

    @steps.setter
    @abstractmethod
    def steps(self, steps: int) -> None: ...

    @abstractmethod
    def learn(self, segment: int) -> bool:
        """Learn for one segment, whose number is given; false if it ended early."""

    def learn_all(
        self,
        warm_start: ActorCriticPolicy | None = None,
        learn: Callable[[int], bool] | None = None,
    ) -> None:
        """Learn segment by segment, until all steps are learned from or a segment ended early.

        Parameters
        ----------
        warm_start : ActorCriticPolicy, optional
            Initial network, made with the same settings; it is copied.
        learn : callable, optional
            Called in place of `learn`.

        Raises
        ------
        ValueError
            If `warm_start` has weights of other shapes.
        """
        if warm_start is not None:
            copy_weights(warm_start, self.network)
        segment = 0
        while self.steps < self._settings.total_steps and (learn or self.learn)(segment):
            segment += 1

    def log(self, scores: dict[str, float]) -> None:
        """Write scores to TensorBoard, if there are logs."""
        if self._logger is not None:
            for name, value in scores.items():
                self._logger.record(name, value)
            self._logger.dump(self.steps)

    def close(self) -> None:
        """Close environments and logs."""
        if self._logger is not None:
            self._logger.close()

    def _segment_seed(self, segment: int) -> int:
        """Seed of a segment's random numbers."""
        entropy = np.random.SeedSequence(self._seed, spawn_key=(segment,))
        return int(entropy.generate_state(1)[0])

    def _segment_steps(self) -> int:
        """Length of the next segment."""
        settings = self._settings
        return min(settings.segment_steps, settings.total_steps - self.steps)
