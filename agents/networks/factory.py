"""The network for an action space, and its weights: of the actor, of the critic, copied, frozen."""

from __future__ import annotations

from dataclasses import replace
from math import prod
from typing import Any

import torch
from gymnasium import spaces
from stable_baselines3.common.policies import ActorCriticPolicy
from torch import nn

from coopmap_agents.config import PPOSettings
from coopmap_agents.networks.candidate_scorer import CandidateScorer
from coopmap_agents.networks.features import ObservationFeatures
from coopmap_agents.networks.pose_policy import PosePolicy
from coopmap_env.core.limits import check_bytes

BYTES_PER_PARAMETER = 4
ADAM_EPSILON = 1e-5
"""As in Stable-Baselines3: a thousand times torch's, against large steps from tiny gradients."""
CRITIC_PREFIXES = (
    "network.value.",
    "mlp_extractor.value_net.",
    "value_net.",
    "features_extractor.state.",
)
"""Prefixes of the names of parameters that only the critic uses."""
CONTEXT_WEIGHTS = (
    "network.from_summary.weight",
    "network.value.0.0.weight",
    "mlp_extractor.policy_net.0.weight",
    "mlp_extractor.value_net.0.weight",
)
"""Weights whose first columns are those of `ObservationFeatures`, without the state."""


def is_of_actor(name: str) -> bool:
    """Whether acting needs the parameter of this name, which is so for all but the critic's."""
    return not name.startswith(CRITIC_PREFIXES)


def actor_parameters(network: nn.Module) -> dict[str, nn.Parameter]:
    """Parameters that acting needs, by name."""
    return {name: values for name, values in network.named_parameters() if is_of_actor(name)}


def network_class(
    action_space: spaces.Space[Any], settings: PPOSettings
) -> tuple[type[ActorCriticPolicy], dict[str, Any]]:
    """Class of the network for an action space, and its keyword arguments."""
    options: dict[str, Any] = {
        "net_arch": list(settings.hidden),
        "features_extractor_kwargs": {"image_features": settings.image_features},
        "optimizer_kwargs": {"eps": ADAM_EPSILON, "fused": True},
    }
    if isinstance(action_space, spaces.Discrete):
        return CandidateScorer, {**options, "initial_policy": settings.initial_policy}
    if settings.initial_policy == "rating":
        raise ValueError(
            'initial_policy="rating" needs candidates as actions, these actions are poses'
        )
    return PosePolicy, {**options, "log_std_init": settings.log_std}


def make_network(
    observation_space: spaces.Space[Any], action_space: spaces.Space[Any], settings: PPOSettings
) -> ActorCriticPolicy:
    """Make an untrained network; torch's global generator draws its weights.

    Raises
    ------
    ValueError
        If robots choose among candidates that they do not observe, or as `parameter_shapes`.
    """
    parameter_shapes(observation_space, action_space, settings)
    return _make(observation_space, action_space, settings)


def parameter_shapes(
    observation_space: spaces.Space[Any], action_space: spaces.Space[Any], settings: PPOSettings
) -> dict[str, tuple[int, ...]]:
    """Shapes of a network's parameters by name, without the memory that the network takes.

    Raises
    ------
    ValueError
        If the network is larger than the limit of `coopmap_env.core.limits`, or as `make_network`.
    """
    with torch.device("meta"):  # tensors with a shape and without content; no number is drawn
        network = _make(observation_space, action_space, replace(settings, device="meta"))
    shapes = {name: tuple(values.shape) for name, values in network.named_parameters()}
    n_parameters = sum(prod(shape) for shape in shapes.values())
    check_bytes(BYTES_PER_PARAMETER * n_parameters, "the network")
    return shapes


def _make(
    observation_space: spaces.Space[Any], action_space: spaces.Space[Any], settings: PPOSettings
) -> ActorCriticPolicy:
    kind, options = network_class(action_space, settings)
    rate = settings.learning_rate
    return kind(observation_space, action_space, lambda _: rate, **options).to(settings.device)


def copy_weights(source: ActorCriticPolicy, target: ActorCriticPolicy) -> None:
    """Copy the weights of a network; the critics may have different shapes, and are left out then.

    Entries that only the target observes get weights of 0: it acts as the source does, at first.

    Raises
    ------
    ValueError
        With the first weight of the actor that has another shape.
    """
    sources = {
        name: _widened(values.detach(), source, target) if name in CONTEXT_WEIGHTS else values
        for name, values in source.named_parameters()
    }
    targets = dict(target.named_parameters())
    shapes, needed = ({k: tuple(v.shape) for k, v in part.items()} for part in (sources, targets))
    differing = {k for k in shapes | needed if shapes.get(k) != needed.get(k)}
    for name in sorted(differing):
        if is_of_actor(name):
            raise ValueError(
                f"the initial network is not of the same settings: {name} "
                f"has the shape {shapes.get(name)}, not {needed.get(name)}"
            )
    for name in set(targets) - differing:
        targets[name].data.copy_(sources[name])


def _widened(
    weights: torch.Tensor, source: ActorCriticPolicy, target: ActorCriticPolicy
) -> torch.Tensor:
    """Weights (h, k) of the context, with columns of 0 for what only the target observes."""
    features, others = source.features_extractor, target.features_extractor
    if not (isinstance(features, ObservationFeatures) and isinstance(others, ObservationFeatures)):
        return weights
    own, wanted = features.widths, others.widths
    if not set(own) <= set(wanted):
        return weights
    *parts, rest = weights.split([*own.values(), weights.shape[1] - sum(own.values())], dim=1)
    columns = dict(zip(own, parts, strict=True))
    zeros = {key: weights.new_zeros(len(weights), width) for key, width in wanted.items()}
    return torch.cat([*(zeros | columns).values(), rest], dim=1)


def set_actor_trainable(network: nn.Module, trainable: bool) -> None:
    """Train all parameters, or those of the critic alone."""
    for weights in actor_parameters(network).values():
        weights.requires_grad_(trainable)
