"""Proximal policy optimisation with one policy for all robots, on Stable-Baselines3.

`train` trains in memory; `coopmap_agents.training.loop` adds files, validation and resuming::

    model = train(lambda: planar_v0.parallel_env(reward="coverage"), PPOSettings(), seed=0)
    save_policy(model.policy, PPOSettings(), "policy.safetensors")
    env = planar_v0.parallel_env(reward="coverage", split="test")
    evaluation = evaluate(env, LearnedPolicy("policy.safetensors"), seeds=range(100))

In "candidates" mode the network is a `CandidateScorer`, which masks what is not on offer by itself,
in "pose" mode a `PosePolicy`. `coopmap_agents.training.imitation` makes a network that has learned from a
planner, to go on from.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
from coopmap_agents import NEEDS_RL
from gymnasium import spaces

try:
    from stable_baselines3 import PPO
    from stable_baselines3.common.callbacks import BaseCallback, CallbackList, ConvertCallback
    from stable_baselines3.common.logger import configure
    from stable_baselines3.common.policies import ActorCriticPolicy
    from stable_baselines3.common.vec_env import VecEnvWrapper, VecMonitor
except ImportError as error:
    raise ImportError(NEEDS_RL) from error

from coopmap_agents.networks.networks import copy_weights, let_actor_learn, network_class
from coopmap_agents.sb3.vec_env import EnvFactory, SharedPolicyVecEnv
from coopmap_agents.settings import PPOSettings
from coopmap_agents.training.segments import SegmentReport, segment_seed, segment_steps


def make_model(env_factory: EnvFactory, settings: PPOSettings, seed: int, workers: int = 0) -> PPO:
    """Make an untrained model with its environments.

    Parameters
    ----------
    env_factory : callable
        Makes a new parallel environment; see `SharedPolicyVecEnv`.
    settings : PPOSettings
    seed : int
        Decides the weights. Stable-Baselines3 seeds the global generators of random, numpy and
        torch with it.
    workers : int
        Processes for the environments; 0 steps them in this one. The result does not depend on it.

    Raises
    ------
    ValueError
        If robots choose among candidates that they do not observe, or a map has more channels than
        cells across.
    """
    central = settings.critic == "central"
    rows = SharedPolicyVecEnv(env_factory, settings.n_envs, workers=workers, with_state=central)
    env = VecMonitor(Stopwatch(rows))
    try:
        _require_channels_first(rows.observation_space)
        policy, options = network_class(env.action_space, settings)
        return PPO(
            policy,
            env,
            learning_rate=settings.learning_rate,
            n_steps=settings.rollout_steps,
            batch_size=settings.batch_size,
            n_epochs=settings.n_epochs,
            gamma=settings.gamma,
            gae_lambda=settings.gae_lambda,
            clip_range=settings.clip_range,
            ent_coef=settings.entropy_coefficient,
            vf_coef=settings.value_coefficient,
            max_grad_norm=settings.max_gradient_norm,
            policy_kwargs=options,
            seed=seed,
            device=settings.device,
        )
    except BaseException:
        env.close()
        raise


def train(
    env_factory: EnvFactory,
    settings: PPOSettings,
    seed: int,
    callback: Any = None,
    warm_start: ActorCriticPolicy | None = None,
    workers: int = 0,
) -> PPO:
    """Train a policy that all robots of a team share.

    Parameters
    ----------
    env_factory, settings, workers
        As in `make_model`.
    seed : int
        Decides everything: worlds, exploration and networks.
    callback : BaseCallback or callable, optional
        Of Stable-Baselines3, for logs; may end the training.
    warm_start : ActorCriticPolicy, optional
        A network to begin with, made with the same settings; it stays as it is.

    Returns
    -------
    stable_baselines3.PPO
        Its network is ``policy``.

    Raises
    ------
    ValueError
        As `make_model`, or if `warm_start` is another network.
    """
    training = PPOTraining(env_factory, settings, seed, workers)
    try:
        if warm_start is not None:
            copy_weights(warm_start, training.network)
        segment = 0
        while training.steps < settings.total_steps and training.learn(segment, callback):
            segment += 1
        return training.model
    finally:
        training.close()


class PPOTraining:
    """A training by Stable-Baselines3, segment by segment.

    Parameters
    ----------
    env_factory, settings, seed, workers
        As in `train`.
    logs : Path, optional
        Folder of TensorBoard's logs.
    """

    def __init__(
        self,
        env_factory: EnvFactory,
        settings: PPOSettings,
        seed: int,
        workers: int = 0,
        logs: Path | None = None,
    ) -> None:
        self._settings = settings
        self._seed = seed
        self.model = make_model(env_factory, settings, seed, workers)
        self._logger = configure(str(logs), ["tensorboard"]) if logs else None
        if self._logger:
            self.model.set_logger(self._logger)
        self.report = SegmentReport()
        """Of the last segment."""

    @property
    def network(self) -> ActorCriticPolicy:
        """Actor and critic as they are now."""
        return self.model.policy

    @property
    def steps(self) -> int:
        """Steps that were learned from."""
        return self.model.num_timesteps

    @steps.setter
    def steps(self, steps: int) -> None:
        self.model.num_timesteps = steps

    def learn(self, segment: int, callback: Any = None) -> bool:
        """Learn for one segment; false if the callback has ended the training."""
        model, env = self.model, self.model.get_env()
        assert env is not None
        model.set_random_seed(segment_seed(self._seed, segment))
        model.set_env(env, force_reset=True)
        watch = _Watch(self._settings.critic_steps)
        callbacks: list[BaseCallback] = [watch]
        if callback is not None:
            own = callback if isinstance(callback, BaseCallback) else ConvertCallback(callback)
            callbacks.append(own)
        wanted = segment_steps(self._settings, self.steps)
        target = self.steps + wanted
        stopwatch: Any = env  # wrappers hand on what is asked of those inside
        before, in_environments = time.perf_counter(), stopwatch.seconds
        model.learn(wanted, CallbackList(callbacks), reset_num_timesteps=False)
        self.report = SegmentReport(
            seconds=time.perf_counter() - before,
            environment_seconds=stopwatch.seconds - in_environments,
            collecting_seconds=watch.collecting,
            returns=watch.returns,
        )
        return self.steps >= target

    def log(self, scores: dict[str, float]) -> None:
        """Write scores to TensorBoard, if there are logs."""
        if self._logger:
            for name, value in scores.items():
                self._logger.record(name, value)
            self._logger.dump(self.steps)

    def close(self) -> None:
        """Close environments and logs."""
        env = self.model.get_env()
        assert env is not None
        env.close()
        if self._logger:
            self._logger.close()


def _require_channels_first(space: spaces.Space[Any]) -> None:
    """Stable-Baselines3 takes the shortest axis of an image for its channels, and swaps axes."""
    assert isinstance(space, spaces.Dict)
    for name, box in space.spaces.items():
        shape = box.shape or ()
        if len(shape) == 3 and shape[0] > min(shape[1:]):
            raise ValueError(
                f"the observation {name} has the shape {shape}, with more channels than cells "
                "across, which Stable-Baselines3 takes for channels last: use larger view_cells"
            )


class Stopwatch(VecEnvWrapper):
    """Sums up how long its environments take to step, with the resets of those that end."""

    seconds = 0.0

    def reset(self) -> Any:
        """Reset all."""
        return self.venv.reset()

    def step_async(self, actions: np.ndarray) -> None:
        """Send the actions, timed."""
        before = time.perf_counter()
        self.venv.step_async(actions)
        self.seconds += time.perf_counter() - before

    def step_wait(self) -> Any:
        """Wait for the step, timed."""
        before = time.perf_counter()
        result = self.venv.step_wait()
        self.seconds += time.perf_counter() - before
        return result


class _Watch(BaseCallback):
    """Lets only the critic learn at first, notes returns and how long roll-outs take."""

    def __init__(self, critic_steps: int) -> None:
        super().__init__()
        self.critic_steps = critic_steps
        self.collecting = 0.0
        self.returns: list[float] = []

    def _on_rollout_start(self) -> None:
        self._started = time.perf_counter()
        let_actor_learn(self.model.policy, self.model.num_timesteps >= self.critic_steps)

    def _on_rollout_end(self) -> None:
        self.collecting += time.perf_counter() - self._started

    def _on_training_end(self) -> None:
        let_actor_learn(self.model.policy, True)

    def _on_step(self) -> bool:
        infos = self.locals["infos"]
        self.returns += [float(info["episode"]["r"]) for info in infos if "episode" in info]
        return True
