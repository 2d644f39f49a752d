"""A shared network in RLlib: the policy object of Stable-Baselines3 and its optimiser."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import gymnasium
import torch
from ray.rllib.algorithms.ppo.torch.ppo_torch_learner import PPOTorchLearner
from ray.rllib.core import DEFAULT_MODULE_ID
from ray.rllib.core.columns import Columns
from ray.rllib.core.rl_module import MultiRLModule, RLModuleSpec
from ray.rllib.core.rl_module.apis import ValueFunctionAPI
from ray.rllib.core.rl_module.torch import TorchRLModule
from ray.rllib.utils.debug import update_global_seed_if_necessary
from stable_baselines3.common.policies import ActorCriticPolicy

from coopmap_agents.config import PPOSettings
from coopmap_agents.networks import make_network
from coopmap_agents.rllib.env import SharedSpaces, suppress_rllib_warnings


class SharedNetworkModule(TorchRLModule, ValueFunctionAPI):
    """A network of `make_network` as a module of RLlib.

    The network applies the mask in the observation to every distribution. It also scales the
    observations, which have the same values as with Stable-Baselines3.
    """

    observation_space: gymnasium.Space[Any]
    action_space: gymnasium.Space[Any]
    model_config: dict[str, Any]
    network: ActorCriticPolicy

    def setup(self) -> None:
        """Make the network; its weights depend on the seed only, in every process."""
        settings = replace(self.model_config["settings"], device="cpu")  # RLlib moves it
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(self.model_config["seed"])
            self.network = make_network(self.observation_space, self.action_space, settings)

    def _forward(self, batch: dict[str, Any], **_: Any) -> dict[str, Any]:
        """Masked logits (n, m), or means and log standard deviations (n, 2 k)."""
        distribution: Any = self.network.get_distribution(batch[Columns.OBS]).distribution
        if isinstance(distribution, torch.distributions.Categorical):
            return {Columns.ACTION_DIST_INPUTS: distribution.logits}
        mean_and_log_std = [distribution.mean, distribution.stddev.log()]
        return {Columns.ACTION_DIST_INPUTS: torch.cat(mean_and_log_std, dim=-1)}

    def compute_values(self, batch: dict[str, Any], embeddings: Any = None) -> torch.Tensor:
        """Values (n,) of n observations."""
        return self.network.predict_values(batch[Columns.OBS]).squeeze(-1)


def shared_network_spec(
    team_spaces: SharedSpaces, settings: PPOSettings, seed: int
) -> RLModuleSpec:
    """Specification from which RLlib makes the network in every process."""
    return RLModuleSpec(
        module_class=SharedNetworkModule,
        observation_space=team_spaces.observation_space,
        action_space=team_spaces.action_space,
        model_config={"settings": settings, "seed": seed},
    )


def get_network(owner: Any) -> ActorCriticPolicy:
    """The network of a learner or of a runner."""
    module = owner.module
    if isinstance(module, MultiRLModule):
        module = module[DEFAULT_MODULE_ID]
    network: ActorCriticPolicy = module.network
    return network


def reset_runner(runner: Any, seed: int, weights: dict[str, torch.Tensor]) -> None:
    """Give a runner new environments, weights, and its own random numbers from a seed."""
    runner.config.environment(env_config={**runner.config.env_config, "seed": seed})
    with suppress_rllib_warnings():
        runner.make_env()
    get_network(runner).load_state_dict(weights)
    update_global_seed_if_necessary("torch", (seed + runner.worker_index) % 2**32)


class SharedNetworkLearner(PPOTorchLearner):
    """RLlib's PPO, in which some parameters may be frozen."""

    seconds = 0.0
    """Time spent in updates so far."""

    def configure_optimizers_for_module(self, module_id: str, config: Any = None) -> None:
        """Register the network's own optimiser: its epsilon is a thousand times RLlib's."""
        self.register_optimizer(
            module_id=module_id,
            optimizer=get_network(self).optimizer,
            params=self.get_parameters(self.module[module_id]),
            lr_or_lr_schedule=config.lr,
        )

    def compute_gradients(self, loss_per_module: dict[str, Any], **options: Any) -> dict[Any, Any]:
        """Gradients of the parameters that are trained; RLlib fails on those that are None."""
        gradients = super().compute_gradients(loss_per_module, **options)
        return {key: gradient for key, gradient in gradients.items() if gradient is not None}

    def update(self, *arguments: Any, **options: Any) -> Any:
        """Learn from a roll-out, and measure the time."""
        start = time.perf_counter()
        result = super().update(*arguments, **options)
        self.seconds += time.perf_counter() - start
        return result
