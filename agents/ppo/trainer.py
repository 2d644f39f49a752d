"""Proximal policy optimisation (Schulman et al. 2017) with one policy for all robots.

The loop is `PPOTrainer.learn`: play a roll-out, estimate advantages, learn from it. It plays a
`MappingVectorEnv`, whose arrays it copies once, into the roll-out; nothing is done robot by robot.
Networks, settings, losses and files are those of `coopmap_agents.sb3`; random numbers differ, and
so do weights::

    settings = PPOSettings(n_envs=32, rollout_steps=32, n_epochs=1, learning_rate=1e-3)
    network = train_network(EnvConfig("planar", {"action_mode": "candidates"}), settings, seed=0)

The same seed and settings give the same weights, to the last bit, with any number of workers and
interrupted between segments or not.
"""

from __future__ import annotations

import time
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.policies import ActorCriticPolicy
from torch import nn

from coopmap_agents.config import PPOSettings
from coopmap_agents.networks import make_network, set_actor_trainable
from coopmap_agents.ppo.advantages import generalized_advantages
from coopmap_agents.ppo.rollout import Batch, Rollout
from coopmap_agents.record import SegmentReport
from coopmap_agents.trainer import Trainer, add_rewards, make_rows, torch_threads
from coopmap_env.vector import EnvFactory


def train_network(
    env_factory: EnvFactory,
    settings: PPOSettings,
    seed: int,
    warm_start: ActorCriticPolicy | None = None,
    workers: int = 0,
) -> ActorCriticPolicy:
    """Train a policy that all robots of a team share, in memory.

    Parameters
    ----------
    env_factory, settings, seed, workers
        As of `PPOTrainer`.
    warm_start : ActorCriticPolicy, optional
        Initial network, made with the same settings; it is copied.

    Raises
    ------
    ValueError
        As `PPOTrainer`, or if `warm_start` has weights of other shapes.
    """
    with closing(PPOTrainer(env_factory, settings, seed, workers)) as trainer:
        trainer.learn_all(warm_start)
        return trainer.network


class PPOTrainer(Trainer):
    """A training, segment by segment.

    Parameters
    ----------
    env_factory : EnvConfig or callable
        See `make_rows`.
    settings : PPOSettings
    seed : int
        Seed of everything: worlds, exploration and networks.
    workers : int
        Processes for the environments; 0 steps them in this one. The result does not depend on it.
    logs : Path, optional
        Folder of TensorBoard's logs.

    Raises
    ------
    ValueError
        If robots choose among candidates that they do not observe, or the network or a roll-out is
        too large.
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
        self._env = env = make_rows(
            env_factory, settings.n_envs, workers, with_state=settings.critic == "central"
        )
        try:
            observed, actions = env.single_observation_space, env.single_action_space
            with torch.random.fork_rng(devices=[]):
                torch.manual_seed(seed)
                self._network = make_network(observed, actions, settings)
            self._device = self._network.device
            assert isinstance(observed, spaces.Dict)
            self._rollout = Rollout(
                observed, actions, settings.rollout_steps, env.num_envs, self._device
            )
            super().__init__(settings, seed, logs)
        except BaseException:
            env.close()
            raise

    @property
    def network(self) -> ActorCriticPolicy:
        """Actor and critic that are trained, no copy."""
        return self._network

    def learn(self, segment: int) -> bool:
        """Learn for one segment."""
        settings, seed = self._settings, self._segment_seed(segment)
        start, self._environment_seconds, collecting = time.perf_counter(), 0.0, 0.0
        self._returns: list[float] = []
        target = self.steps + self._segment_steps()
        with torch.random.fork_rng(), torch_threads(settings.threads):
            torch.manual_seed(seed)  # draws the actions
            order = torch.Generator().manual_seed(seed)  # draws the batches
            self._begin_episodes(seed)
            while self.steps < target:
                set_actor_trainable(self._network, self.steps >= settings.critic_warmup_steps)
                before = time.perf_counter()
                advantages = self._play_rollout()
                collecting += time.perf_counter() - before
                losses = [
                    self._update(batch)
                    for _ in range(settings.n_epochs)
                    for batch in self._rollout.batches(advantages, settings.batch_size, order)
                ]
                self.steps += advantages.numel()
                self._log_losses(losses)
            set_actor_trainable(self._network, True)
        seconds = time.perf_counter() - start
        self.report = SegmentReport(seconds, self._environment_seconds, collecting, self._returns)
        return True

    def close(self) -> None:
        """Close environments and logs."""
        self._env.close()
        super().close()

    def _begin_episodes(self, seed: int) -> None:
        """Start an episode in each world.

        Consecutive seeds would not do: trainings with seeds 0 and 1 would share all worlds but one.
        """
        seeds = np.random.SeedSequence(seed).generate_state(self._env.n_worlds)
        self._observations, _ = self._env.reset(seed=seeds.tolist())
        self._running_returns = np.zeros(self._env.num_envs)

    @torch.no_grad()
    def _play_rollout(self) -> torch.Tensor:
        """Fill the roll-out; its advantages, shape (T, R)."""
        rollout, settings = self._rollout, self._settings
        for t in range(settings.rollout_steps):
            rows = rollout.store_observations(t, self._observations)
            with torch.inference_mode():  # a tenth faster than without gradients alone
                actions, values, log_probs = self._network(rows)
            rewards, ends = self._step(actions.cpu().numpy())
            rollout.actions[t], rollout.log_probs[t] = actions, log_probs
            rollout.values[t] = values.squeeze(-1)
            rollout.rewards[t], rollout.ends[t] = rewards, ends
        last_values = self._network.predict_values(self._on_device(self._observations))
        return generalized_advantages(
            rollout.rewards,
            rollout.values,
            last_values.squeeze(-1),
            rollout.ends,
            settings.gamma,
            settings.gae_lambda,
        )

    def _step(self, actions: NDArray[Any]) -> tuple[torch.Tensor, torch.Tensor]:
        """Step all worlds; rewards, with the value of what was cut off, and ends."""
        box = self._env.single_action_space
        if isinstance(box, spaces.Box):
            actions = np.clip(actions, box.low, box.high)
        start = time.perf_counter()
        self._observations, rewards, terminated, truncated, _ = self._env.step(actions)
        self._environment_seconds += time.perf_counter() - start
        ends = terminated | truncated
        self._returns += add_rewards(self._running_returns, rewards, ends)
        paid = torch.as_tensor(rewards, dtype=torch.float32).to(self._device)
        if (cut := truncated & ~terminated).any():
            last = {key: own[cut] for key, own in self._env.final_observations.items()}
            values = self._network.predict_values(self._on_device(last)).squeeze(-1)
            paid[torch.from_numpy(cut).to(self._device)] += self._settings.gamma * values
        return paid, torch.from_numpy(ends)

    def _update(self, batch: Batch) -> torch.Tensor:
        """One gradient step; policy and value loss, entropy, fraction of clipped ratios."""
        settings, network = self._settings, self._network
        values, log_probs, entropies = network.evaluate_actions(batch.observations, batch.actions)
        assert entropies is not None  # of both distributions
        advantages = batch.advantages
        if len(advantages) > 1:
            advantages = (advantages - advantages.mean()) / (advantages.std() + 1e-8)
        ratio = (log_probs - batch.log_probs).exp()
        clipped = ratio.clamp(1 - settings.clip_range, 1 + settings.clip_range)
        policy_loss = -torch.min(advantages * ratio, advantages * clipped).mean()
        value_loss = nn.functional.mse_loss(values.squeeze(-1), batch.returns)
        entropy = entropies.mean()
        loss = (
            policy_loss
            + settings.value_coefficient * value_loss
            - settings.entropy_coefficient * entropy
        )
        network.optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(network.parameters(), settings.max_gradient_norm, foreach=True)
        network.optimizer.step()
        is_clipped = ((ratio - 1).abs() > settings.clip_range).float().mean()
        return torch.stack([policy_loss, value_loss, entropy, is_clipped]).detach()

    def _log_losses(self, losses: list[torch.Tensor]) -> None:
        names = ("policy_gradient_loss", "value_loss", "entropy", "clip_fraction")
        means = torch.stack(losses).mean(dim=0).tolist()
        self.log({f"train/{name}": value for name, value in zip(names, means, strict=True)})

    def _on_device(self, observations: dict[str, NDArray[Any]]) -> dict[str, torch.Tensor]:
        return {
            key: torch.from_numpy(values).to(self._device) for key, values in observations.items()
        }
