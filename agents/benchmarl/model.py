"""Networks of coopmap as actors and critics of BenchMARL."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from benchmarl.models import Model, ModelConfig
from gymnasium import spaces
from stable_baselines3.common.policies import ActorCriticPolicy
from tensordict import TensorDictBase
from torch import nn
from torchrl.data import TensorSpec

from coopmap_agents.config import PPOSettings
from coopmap_agents.networks import is_of_actor, make_network

OUTPUTS = ("logits", "state_value")
"""Of actors, and of critics."""


class Network(Model):
    """The networks of `coopmap_agents.networks`, of all entries of an observation.

    An actor has logits of candidates, or means and logarithms of standard deviations of poses. A
    critic has one value for each robot; a central one has the value of the mean, over robots, of
    what each of them contributes to it.

    Parameters
    ----------
    hidden : sequence of int
        Widths of the hidden layers.
    image_features : int
        Length of the feature vector of maps.
    log_std : float
        Initial logarithm of the standard deviations of poses.
    **of_benchmarl
        As in BenchMARL's `Model`.

    Raises
    ------
    ValueError
        If the output is neither logits nor a value, as of MAPPO and IPPO, or the input is anything
        but the observations of robots.
    """

    def __init__(
        self, hidden: Sequence[int], image_features: int, log_std: float, **of_benchmarl: Any
    ) -> None:
        super().__init__(**of_benchmarl)
        self.settings = PPOSettings(
            hidden=tuple(hidden), image_features=image_features, log_std=log_std
        )
        actions = _action_space(self.action_spec[self.agent_group, "action"])
        observations = spaces.Dict({_name(key): _box(self.input_spec[key]) for key in self.in_keys})
        self.networks = nn.ModuleList(
            _part(make_network(observations, actions, self.settings), self._is_actor)
            for _ in range(1 if self.share_params else self.n_agents)
        ).to(self.device)

    @property
    def _is_actor(self) -> bool:
        """By the output: ``is_critic`` is set on a configuration that both may share."""
        return _name(self.out_key) == "logits"

    @property
    def _networks(self) -> list[Any]:
        return list(self.networks)

    def _perform_checks(self) -> None:
        super()._perform_checks()
        if not self.input_has_agent_dim:
            raise ValueError(
                "this model takes the observations of robots, and no state of the team"
            )
        if _name(self.out_key) not in OUTPUTS:
            raise ValueError(
                f"this model gives {' or '.join(OUTPUTS)}, as MAPPO and IPPO need, and not "
                f"{_name(self.out_key)}"
            )

    def _forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        observations = {_name(key): tensordict.get(key) for key in self.in_keys}
        shape = tensordict.get(self.agent_group).shape  # of the batch, and the robots
        flat = {
            key: values.reshape(-1, self.n_agents, *values.shape[len(shape) :]).float()
            for key, values in observations.items()
        }
        outputs = self._actor(flat) if self._is_actor else self._critic(flat)
        tensordict.set(self.out_key, outputs.reshape(*shape[:-1], *outputs.shape[1:]))
        return tensordict

    def _actor(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        """Parameters of the distributions (n, robots, k)."""
        return self._of_each_robot(observations, _distribution_parameters)

    def _critic(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        """Values (n, robots, 1), or (n, 1) of a central critic that robots share."""
        if not self.centralised:
            return self._of_each_robot(observations, lambda network, x: network.predict_values(x))
        pooled = [
            network.value_of(_by_robot(network.critic_inputs, observations).mean(dim=1))
            for network in self._networks
        ]
        return pooled[0] if self.share_params else torch.stack(pooled, dim=1)

    def _of_each_robot(self, observations: dict[str, torch.Tensor], function: Any) -> torch.Tensor:
        if self.share_params:
            return _by_robot(lambda x: function(self._networks[0], x), observations)
        each = [
            function(network, {key: values[:, robot] for key, values in observations.items()})
            for robot, network in enumerate(self._networks)
        ]
        return torch.stack(each, dim=1)


@dataclass
class NetworkConfig(ModelConfig):
    """Settings of a `Network`, with the defaults of coopmap's own trainings."""

    hidden: Sequence[int] = PPOSettings.hidden
    image_features: int = PPOSettings.image_features
    log_std: float = PPOSettings.log_std

    @staticmethod
    def associated_class() -> type[Network]:
        """The class that this makes."""
        return Network


def trained_network(experiment: Any) -> tuple[ActorCriticPolicy, PPOSettings]:
    """The actor of an experiment, as `coopmap_agents.pretrained.save_policy` writes it to a file.

    Only the actor is trained; the critic of BenchMARL is another network.

    Parameters
    ----------
    experiment : benchmarl.experiment.Experiment
        Its model is a `Network`.

    Returns
    -------
    network : ActorCriticPolicy
    settings : PPOSettings
        Of the network.

    Raises
    ------
    ValueError
        If the model is another one, each robot has its own, or poses come from a `TanhNormal`,
        which acts otherwise than our networks: set ``use_tanh_normal`` to False.
    """
    models = [part for part in experiment.policy.modules() if isinstance(part, Network)]
    if len(models) != 1:
        raise ValueError("the experiment has another model than coopmap_agents.benchmarl.Network")
    (model,) = models
    if not model.share_params:
        raise ValueError("each robot has its own network: set share_policy_params to True")
    (network,) = model._networks
    is_pose = isinstance(network.action_space, spaces.Box)
    if is_pose and experiment.algorithm_config.use_tanh_normal:
        raise ValueError(
            "a TanhNormal has other poses than our networks: set use_tanh_normal=False"
        )
    return network, model.settings


def _by_robot(function: Any, observations: dict[str, torch.Tensor]) -> torch.Tensor:
    """A function of rows, of all robots (n, robots, ...)."""
    n, robots = next(iter(observations.values())).shape[:2]
    outputs = function({key: values.flatten(0, 1) for key, values in observations.items()})
    result: torch.Tensor = outputs.unflatten(0, (n, robots))
    return result


def _distribution_parameters(network: Any, observations: dict[str, torch.Tensor]) -> torch.Tensor:
    distribution = network.get_distribution(observations).distribution
    if isinstance(distribution, torch.distributions.Categorical):
        logits: torch.Tensor = distribution.logits
        return logits
    return torch.cat([distribution.mean, distribution.stddev.log()], dim=-1)


def _part(network: nn.Module, is_actor: bool) -> nn.Module:
    """The network, of which the actor or the critic can be trained."""
    for name, values in network.named_parameters():
        values.requires_grad_(is_of_actor(name) == is_actor)
    return network


def _name(key: str | tuple[str, ...]) -> str:
    """Name of an entry of observations, from its path."""
    return key if isinstance(key, str) else key[-1]


def _box(spec: TensorSpec) -> spaces.Box:
    """The space of one robot's entry; of bytes, as maps are, with all their values."""
    shape = tuple(spec.shape[1:])
    if spec.dtype == torch.uint8:
        return spaces.Box(0, 255, shape, np.uint8)
    return spaces.Box(-np.inf, np.inf, shape, np.float32)


def _action_space(spec: TensorSpec) -> spaces.Space[Any]:
    """The space of one robot's action."""
    if spec.domain == "discrete":
        return spaces.Discrete(int(spec.space.n))
    return spaces.Box(-1.0, 1.0, tuple(spec.shape[1:]), np.float32)
