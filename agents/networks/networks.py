"""Networks for every kind of actions, the same for every engine that trains them.

A network is a policy object of Stable-Baselines3: it holds actor and critic, knows its spaces and
can act. `CandidateScorer` chooses among candidates, `PosePolicy` among all poses.
"""

from __future__ import annotations

from typing import Any

from coopmap_agents import RL_EXTRA_HINT
from gymnasium import spaces

try:
    from stable_baselines3.common.policies import ActorCriticPolicy
    from torch import nn
except ImportError as error:
    raise ImportError(RL_EXTRA_HINT) from error

from coopmap_agents.networks.candidate_scorer import CandidateScorer
from coopmap_agents.networks.pose_policy import PosePolicy
from coopmap_agents.settings import PPOSettings

CRITIC_PREFIXES = (
    "network.value.",
    "mlp_extractor.value_net.",
    "value_net.",
    "features_extractor.state.",
)
"""Beginnings of the names of the critic's own parameters: what acting does not need."""


def actor_parameters(network: nn.Module) -> dict[str, nn.Parameter]:
    """All weights by name but for the critic's own."""
    return {
        name: values
        for name, values in network.named_parameters()
        if not name.startswith(CRITIC_PREFIXES)
    }


def network_class(
    action_space: spaces.Space[Any], settings: PPOSettings
) -> tuple[type[ActorCriticPolicy], dict[str, Any]]:
    """Class of the network for these actions, and its options."""
    options: dict[str, Any] = {
        "net_arch": list(settings.hidden),
        "features_extractor_kwargs": {"image_features": settings.image_features},
    }
    if isinstance(action_space, spaces.Discrete):
        return CandidateScorer, {**options, "initial_policy": settings.initial_policy}
    if settings.initial_policy == "rating":
        raise ValueError(
            'initial_policy="rating" is for choosing among candidates, these actions are poses'
        )
    return PosePolicy, {**options, "log_std_init": settings.log_std}


def make_network(
    observation_space: spaces.Space[Any], action_space: spaces.Space[Any], settings: PPOSettings
) -> ActorCriticPolicy:
    """Make an untrained network; its weights come from torch's global generator.

    Raises
    ------
    ValueError
        If robots choose among candidates that they do not observe.
    """
    kind, options = network_class(action_space, settings)
    rate = settings.learning_rate
    return kind(observation_space, action_space, lambda _: rate, **options).to(settings.device)


def copy_weights(source: ActorCriticPolicy, target: ActorCriticPolicy) -> None:
    """Copy what both networks have; all that acts must be there, the critic may differ.

    Raises
    ------
    ValueError
        With the first weight that has another shape.
    """
    given, own = dict(source.named_parameters()), dict(target.named_parameters())
    shapes, needed = ({k: tuple(v.shape) for k, v in part.items()} for part in (given, own))
    differing = {k for k in shapes | needed if shapes.get(k) != needed.get(k)}
    for name in sorted(differing):
        if not name.startswith(CRITIC_PREFIXES):
            raise ValueError(
                f"the network to begin with is another than these settings make here: {name} "
                f"has the shape {shapes.get(name)}, not {needed.get(name)}"
            )
    for name in set(own) - differing:
        own[name].data.copy_(given[name])


def set_actor_trainable(network: nn.Module, learns: bool) -> None:
    """Let all of it learn, or the critic alone."""
    for weights in actor_parameters(network).values():
        weights.requires_grad_(learns)
