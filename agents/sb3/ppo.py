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
from coopmap_agents import RL_EXTRA_HINT
from gymnasium import spaces

try:
    from stable_baselines3 import PPO
    from stable_baselines3.common.callbacks import BaseCallback, CallbackList, ConvertCallback
    from stable_baselines3.common.logger import configure
    from stable_baselines3.common.policies import ActorCriticPolicy
    from stable_baselines3.common.vec_env import VecEnvWrapper, VecMonitor
except ImportError as error:
    raise ImportError(RL_EXTRA_HINT) from error

from coopmap_agents.networks.networks import copy_weights, network_class, set_actor_trainable
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
    env = VecMonitor(TimedVecEnv(rows))
    try:
        _check_channels_first(rows.observation_space)
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
    training = SB3Trainer(env_factory, settings, seed, workers)
    try:
        if warm_start is not None:
            copy_weights(warm_start, training.network)
        segment = 0
        while training.steps < settings.total_steps and training.learn(segment, callback):
            segment += 1
        return training.model
    finally:
        training.close()


class SB3Trainer:
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
        rollout_callback = _RolloutCallback(self._settings.critic_warmup_steps)
        callbacks: list[BaseCallback] = [rollout_callback]
        if callback is not None:
            own = callback if isinstance(callback, BaseCallback) else ConvertCallback(callback)
            callbacks.append(own)
        n_steps = segment_steps(self._settings, self.steps)
        target = self.steps + n_steps
        timed_env: Any = env  # wrappers hand on what is asked of those inside
        before, in_environments = time.perf_counter(), timed_env.seconds
        model.learn(n_steps, CallbackList(callbacks), reset_num_timesteps=False)
        self.report = SegmentReport(
            seconds=time.perf_counter() - before,
            environment_seconds=timed_env.seconds - in_environments,
            collecting_seconds=rollout_callback.collecting_seconds,
            returns=rollout_callback.returns,
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


def _check_channels_first(space: spaces.Space[Any]) -> None:
    """Stable-Baselines3 takes the shortest axis of an image for its channels, and swaps axes."""
    assert isinstance(space, spaces.Dict)
    for name, box in space.spaces.items():
        shape = box.shape or ()
        if len(shape) == 3 and shape[0] > min(shape[1:]):
            raise ValueError(
                f"the observation {name} has the shape {shape}, with more channels than cells "
                "across, which Stable-Baselines3 takes for channels last: use larger crop_cells"
            )


class TimedVecEnv(VecEnvWrapper):
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


class _RolloutCallback(BaseCallback):
    """Lets only the critic learn at first, notes returns and how long roll-outs take."""

    def __init__(self, critic_warmup_steps: int) -> None:
        super().__init__()
        self.critic_warmup_steps = critic_warmup_steps
        self.collecting_seconds = 0.0
        self.returns: list[float] = []

    def _on_rollout_start(self) -> None:
        self._started = time.perf_counter()
        set_actor_trainable(self.model.policy, self.model.num_timesteps >= self.critic_warmup_steps)

    def _on_rollout_end(self) -> None:
        self.collecting_seconds += time.perf_counter() - self._started

    def _on_training_end(self) -> None:
        set_actor_trainable(self.model.policy, True)

    def _on_step(self) -> bool:
        infos = self.locals["infos"]
        self.returns += [float(info["episode"]["r"]) for info in infos if "episode" in info]
        return True
