"""Proximal policy optimisation with one policy for all robots, on Stable-Baselines3.

`train` trains in memory; `coopmap_agents.training` adds files, validation and resuming::

    model = train(lambda: planar_v1.parallel_env(reward="coverage"), PPOSettings(), seed=0)
    save_policy(model.policy, PPOSettings(), "policy.safetensors")
    env = planar_v1.parallel_env(reward="coverage", split="test")
    evaluation = evaluate(env, LearnedPolicy("policy.safetensors"), seeds=range(100))

In "candidates" mode the network is a `CandidateScorer`, which applies the action mask itself; in
"pose" mode it is a `PosePolicy`. `coopmap_agents.training.behavior_clone` fits a network to a
planner, as a warm start.
"""

from __future__ import annotations

import time
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback, CallbackList, ConvertCallback
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.vec_env import VecEnvWrapper, VecMonitor

from coopmap_agents.config import PPOSettings
from coopmap_agents.networks import (
    network_class,
    parameter_shapes,
    set_actor_trainable,
)
from coopmap_agents.record import SegmentReport
from coopmap_agents.sb3.vec_env import SharedPolicyVecEnv
from coopmap_agents.trainer import Trainer, make_rows
from coopmap_env.vector import EnvFactory


def make_model(env_factory: EnvFactory, settings: PPOSettings, seed: int, workers: int = 0) -> PPO:
    """Make an untrained model with its environments.

    Parameters
    ----------
    env_factory : callable
        Makes a new parallel environment; see `make_rows`.
    settings : PPOSettings
    seed : int
        Seed of the weights. Stable-Baselines3 seeds the global generators of random, numpy and
        torch with it.
    workers : int
        Processes for the environments; 0 steps them in this one. The result does not depend on it.

    Raises
    ------
    ValueError
        If robots choose among candidates that they do not observe, a map has more channels than
        cells across, or the network is too large, as in `parameter_shapes`.
    """
    central = settings.critic == "central"
    rows = SharedPolicyVecEnv(make_rows(env_factory, settings.n_envs, workers, central))
    env = VecMonitor(TimedVecEnv(rows))
    try:
        _check_channels_first(rows.observation_space)
        parameter_shapes(env.observation_space, env.action_space, settings)  # checks the size
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
        Seed of everything: worlds, exploration and networks.
    callback : BaseCallback or callable, optional
        Callback of Stable-Baselines3, for logs; may end the training.
    warm_start : ActorCriticPolicy, optional
        Initial network, made with the same settings; it is copied.

    Returns
    -------
    stable_baselines3.PPO
        The network is its ``policy``.

    Raises
    ------
    ValueError
        As `make_model`, or if `warm_start` has weights of other shapes.
    """
    with closing(SB3Trainer(env_factory, settings, seed, workers)) as trainer:
        trainer.learn_all(warm_start, partial(trainer.learn, callback=callback))
        return trainer.model


class SB3Trainer(Trainer):
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
        self.model = make_model(env_factory, settings, seed, workers)
        super().__init__(settings, seed, logs)
        if self._logger is not None:
            self.model.set_logger(self._logger)

    @property
    def network(self) -> ActorCriticPolicy:
        """Actor and critic that are trained, no copy."""
        return self.model.policy

    @property
    def steps(self) -> int:
        """Number of steps learned from."""
        return self.model.num_timesteps

    @steps.setter
    def steps(self, steps: int) -> None:
        self.model.num_timesteps = steps

    def learn(self, segment: int, callback: Any = None) -> bool:
        """Learn for one segment; false if the callback has ended the training."""
        model, env = self.model, self.model.get_env()
        assert env is not None
        model.set_random_seed(self._segment_seed(segment))
        model.set_env(env, force_reset=True)
        recorder = _RolloutRecorder()
        warmup = _CriticWarmup(self._settings.critic_warmup_steps)
        callbacks: list[BaseCallback] = [warmup, recorder]
        if callback is not None:
            is_object = isinstance(callback, BaseCallback)
            callbacks.append(callback if is_object else ConvertCallback(callback))
        n_steps = self._segment_steps()
        target = self.steps + n_steps
        timed_env: Any = env  # wrappers forward attributes of the environments inside
        start, environment_start = time.perf_counter(), timed_env.seconds
        model.learn(n_steps, CallbackList(callbacks), reset_num_timesteps=False)
        self.report = SegmentReport(
            seconds=time.perf_counter() - start,
            environment_seconds=timed_env.seconds - environment_start,
            collecting_seconds=recorder.collecting_seconds,
            returns=recorder.returns,
        )
        return self.steps >= target

    def close(self) -> None:
        """Close environments and logs."""
        env = self.model.get_env()
        assert env is not None
        env.close()
        super().close()


def _check_channels_first(space: spaces.Space[Any]) -> None:
    """Stable-Baselines3 assumes that the shortest axis of an image is its channels."""
    assert isinstance(space, spaces.Dict)
    for name, box in space.spaces.items():
        shape = box.shape or ()
        if len(shape) == 3 and shape[0] > min(shape[1:]):
            raise ValueError(
                f"the observation {name} has the shape {shape}, with more channels than cells "
                "across, which Stable-Baselines3 assumes to be channels last: use larger crop_cells"
            )


class TimedVecEnv(VecEnvWrapper):
    """Measures the time in which environments step, including resets at ends of episodes."""

    seconds = 0.0
    """Sum over all steps."""

    def reset(self) -> Any:
        """Reset all environments."""
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


class _CriticWarmup(BaseCallback):
    """Freezes the actor during the first steps of a training, in which only the critic learns."""

    def __init__(self, steps: int) -> None:
        super().__init__()
        self.steps = steps

    def _on_rollout_start(self) -> None:
        set_actor_trainable(self.model.policy, self.model.num_timesteps >= self.steps)

    def _on_training_end(self) -> None:
        set_actor_trainable(self.model.policy, True)

    def _on_step(self) -> bool:
        return True


class _RolloutRecorder(BaseCallback):
    """Records returns and the duration of roll-outs."""

    def __init__(self) -> None:
        super().__init__()
        self.collecting_seconds = 0.0
        self.returns: list[float] = []

    def _on_rollout_start(self) -> None:
        self._started = time.perf_counter()

    def _on_rollout_end(self) -> None:
        self.collecting_seconds += time.perf_counter() - self._started

    def _on_step(self) -> bool:
        infos = self.locals["infos"]
        self.returns += [float(info["episode"]["r"]) for info in infos if "episode" in info]
        return True
