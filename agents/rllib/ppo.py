"""Proximal policy optimisation with one policy for all robots, on RLlib and so on Ray.

Environments, networks, hyper-parameters and files are those of `coopmap_agents.sb3`; roll-outs are
collected by workers on this machine or on a cluster, see `ray_session`. `RLlibTrainer` serves
`coopmap_agents.training`; RLlib's own classes can be used as well::

    with ray_session(workers=2):
        algorithm = make_config(EnvConfig(), PPOSettings(), seed=0, workers=2).build_algo()
        algorithm.train()

Differences between RLlib and Stable-Baselines3:

==========  =================================================  ===============================
            RLlib                                              Stable-Baselines3
==========  =================================================  ===============================
advantages  standardised over a roll-out                       over a batch
batches     in the order of the roll-out in the first epoch    shuffled in every epoch
            one row after each episode, masked in the losses   only rows that are learned from
==========  =================================================  ===============================

The same seed, settings and number of workers give the same weights, to the last bit, interrupted
between segments or not. With another number of workers, worlds and so weights differ.
"""

from __future__ import annotations

import contextlib
import math
import os
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
from ray.exceptions import RayError
from ray.rllib.algorithms import Algorithm
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.core import DEFAULT_MODULE_ID
from ray.rllib.utils.debug import update_global_seed_if_necessary
from ray.rllib.utils.metrics import (
    ENV_RUNNER_RESULTS,
    LEARNER_RESULTS,
    NUM_MODULE_STEPS_SAMPLED,
)
from stable_baselines3.common.policies import ActorCriticPolicy

from coopmap_agents.config import PPOSettings
from coopmap_agents.networks import set_actor_trainable
from coopmap_agents.record import SegmentReport
from coopmap_agents.rllib.env import (
    RLlibRows,
    RowsRunner,
    collect_statistics,
    shared_spaces,
    suppress_rllib_warnings,
)
from coopmap_agents.rllib.network import (
    SharedNetworkLearner,
    get_network,
    reset_runner,
    shared_network_spec,
)
from coopmap_agents.trainer import Trainer
from coopmap_env.evaluation import ray_session, ray_workers_checked
from coopmap_env.vector import EnvFactory

WORKER_ENDED = (
    "a worker process was killed or has ended early: the same command continues the training after "
    "its last segment; if memory was short, free some, for the number of workers must stay"
)
LOGGED_METRICS = {
    "train/policy_gradient_loss": "policy_loss",
    "train/value_loss": "vf_loss",
    "train/entropy": "entropy",
    "train/explained_variance": "vf_explained_var",
}
"""Metrics of each update in TensorBoard's logs, and RLlib's names of them."""


def make_config(
    env_factory: EnvFactory, settings: PPOSettings, seed: int, workers: int = 0
) -> PPOConfig:
    """Translate the settings for RLlib; `build_algo` then makes the algorithm.

    Parameters
    ----------
    env_factory : callable
        Makes a new parallel environment, such as an `EnvConfig`; workers get it by cloudpickle.
    settings : PPOSettings
    seed : int
        Seed of everything. RLlib seeds the global generators of random, numpy and torch with it.
    workers : int
        Processes for the environments, each with the same number of them; 0 steps them in this
        process.

    Raises
    ------
    ValueError
        If `workers` does not divide the number of environments, or robots have different spaces.
    """
    if workers < 0 or settings.n_envs % max(workers, 1):
        raise ValueError(
            f"workers must be 0 or divide PPOSettings.n_envs = {settings.n_envs}, got {workers}"
        )
    with_state = settings.critic == "central"
    team_spaces = shared_spaces(env_factory, with_state)
    n_rows = settings.n_envs * len(team_spaces.robots)
    config = (
        PPOConfig()
        .environment(
            RLlibRows,
            env_config={"env_factory": env_factory, "team_spaces": team_spaces, "seed": seed},
            normalize_actions=False,
            clip_actions=True,
            disable_env_checking=True,  # the check takes random actions, even masked ones
        )
        .rl_module(rl_module_spec=shared_network_spec(team_spaces, settings, seed))
        .env_runners(
            env_runner_cls=RowsRunner,
            gym_env_vectorize_mode=gymnasium.VectorizeMode.VECTOR_ENTRY_POINT,
            num_env_runners=workers,
            num_envs_per_env_runner=n_rows // max(workers, 1),
            rollout_fragment_length=settings.rollout_steps,
            sample_timeout_s=None,  # RLlib discards roll-outs that arrive later
        )
        .learners(
            learner_class=SharedNetworkLearner,
            num_learners=0,
            num_gpus_per_learner=int(settings.device != "cpu"),
        )
        .training(
            train_batch_size_per_learner=n_rows * settings.rollout_steps,
            minibatch_size=settings.batch_size,
            num_epochs=settings.n_epochs,
            lr=settings.learning_rate,
            gamma=settings.gamma,
            lambda_=settings.gae_lambda,
            clip_param=settings.clip_range,
            entropy_coeff=settings.entropy_coefficient,
            vf_loss_coeff=settings.value_coefficient,
            vf_clip_param=math.inf,
            grad_clip=settings.max_gradient_norm,
            grad_clip_by="global_norm",
            use_kl_loss=False,
        )
        .fault_tolerance(restart_failed_env_runners=False)  # errors must be visible
        .debugging(seed=seed, log_level="ERROR")
    )
    assert isinstance(config, PPOConfig)
    return config


class RLlibTrainer(Trainer):
    """A training by RLlib, segment by segment.

    Parameters
    ----------
    env_factory, settings, seed, workers
        As in `make_config`.
    logs : Path, optional
        Folder of TensorBoard's logs.

    Raises
    ------
    ValueError
        As `make_config`, or if robots choose among candidates that they do not observe, or Ray has
        fewer processors than there are workers.
    """

    steps = 0
    """Number of steps learned from."""

    def __init__(
        self,
        env_factory: EnvFactory,
        settings: PPOSettings,
        seed: int,
        workers: int = 0,
        logs: Path | None = None,
    ) -> None:
        self._workers = workers
        with contextlib.ExitStack() as stack, suppress_rllib_warnings():
            config = make_config(env_factory, settings, seed, workers)
            _check_processors(stack.enter_context(ray_session(workers)), workers)
            self.algorithm = config.build_algo()
            stack.callback(_stop, self.algorithm)
            super().__init__(settings, seed, logs)
            self._resources = stack.pop_all()
        learners: Any = self.algorithm.learner_group
        self._learner: SharedNetworkLearner = next(
            iter(learners.foreach_learner(lambda learner: learner))
        ).get()

    @property
    def network(self) -> ActorCriticPolicy:
        """Actor and critic that are trained, no copy."""
        return get_network(self._learner)

    def learn(self, segment: int) -> bool:
        """Learn for one segment.

        Raises
        ------
        WorkerError
            If a process of Ray has ended.
        """
        with ray_workers_checked(WORKER_ENDED):
            return self._learn(segment)

    def _learn(self, segment: int) -> bool:
        start, update_start = time.perf_counter(), self._learner.seconds
        self._reset_runners(self._segment_seed(segment))
        target = self.steps + self._segment_steps()
        while self.steps < target:
            set_actor_trainable(self.network, self.steps >= self._settings.critic_warmup_steps)
            result = self.algorithm.train()
            self.steps += int(
                result[ENV_RUNNER_RESULTS][NUM_MODULE_STEPS_SAMPLED][DEFAULT_MODULE_ID]
            )
            metrics = result[LEARNER_RESULTS][DEFAULT_MODULE_ID]
            self.log({name: float(metrics[key]) for name, key in LOGGED_METRICS.items()})
        statistics = self._on_runners(collect_statistics)
        seconds = time.perf_counter() - start
        self.report = SegmentReport(
            seconds=seconds,
            # workers step their environments in parallel
            environment_seconds=max(env_seconds for env_seconds, _ in statistics),
            collecting_seconds=seconds - (self._learner.seconds - update_start),
            returns=[value for _, returns in statistics for value in returns],
        )
        return True

    def close(self) -> None:
        """Close environments and logs, and Ray if it was started here."""
        self._resources.close()
        super().close()

    def _reset_runners(self, seed: int) -> None:
        """Give all runners new environments, the weights, and random numbers of this seed."""
        update_global_seed_if_necessary("torch", seed)
        weights = {name: values.cpu() for name, values in self.network.state_dict().items()}
        self._on_runners(partial(reset_runner, seed=seed, weights=weights))

    def _on_runners(self, function: Callable[[Any], Any]) -> list[Any]:
        """Results of a function of each runner that has environments."""
        group: Any = self.algorithm.env_runner_group
        results: list[Any] = group.foreach_env_runner(function, local_env_runner=not self._workers)
        return results


def _stop(algorithm: Algorithm) -> None:
    """End the workers, and remove the unused folder that RLlib has made in the home folder."""
    with contextlib.suppress(RayError):  # of workers that have ended before
        algorithm.stop()
    with contextlib.suppress(OSError):  # it is not empty
        os.rmdir(algorithm.logdir)


def _check_processors(ray: Any, workers: int) -> None:
    """Check the number of processors: RLlib would wait for more silently."""
    processors = int(ray.cluster_resources().get("CPU", 0))
    if processors < workers:
        raise ValueError(
            f"{workers} workers need a processor each, but Ray was started with {processors}"
        )
