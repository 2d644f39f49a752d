"""A policy among all poses: a Gaussian around what a network says, for each number of an action.

That of Stable-Baselines3 but for what its critic may see: the state of the whole team, where the
observations carry it (`ObservationFeatures`).
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from coopmap_agents import RL_EXTRA_HINT

try:
    import torch
    from stable_baselines3.common.policies import MultiInputActorCriticPolicy
    from torch import nn
except ImportError as error:
    raise ImportError(RL_EXTRA_HINT) from error

from coopmap_agents.networks.features import ObservationFeatures, as_tensors


def mlp(widths: list[int]) -> nn.Sequential:
    """Linear layers from each width to the next, with tanh."""
    parts: list[nn.Module] = []
    for n_in, n_out in pairwise(widths):
        parts += [nn.Linear(n_in, n_out), nn.Tanh()]
    return nn.Sequential(*parts)


class ActorCriticExtractor(nn.Module):
    """Layers of the actor, from a robot's own features, and of the critic, from all.

    Stands where Stable-Baselines3 has its `MlpExtractor`, which gives both the same.
    """

    def __init__(self, features: ObservationFeatures, hidden: list[int]) -> None:
        super().__init__()
        self.latent_dim_pi = self.latent_dim_vf = hidden[-1]
        self.actor_dim = features.actor_dim
        self.policy_net = mlp([features.actor_dim, *hidden])
        self.value_net = mlp([features.features_dim, *hidden])

    def forward(self, features: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Both."""
        return self.forward_actor(features), self.forward_critic(features)

    def forward_actor(self, features: torch.Tensor) -> torch.Tensor:
        """What the action comes of, shape (n, latent_dim_pi)."""
        actor: torch.Tensor = self.policy_net(features[:, : self.actor_dim])
        return actor

    def forward_critic(self, features: torch.Tensor) -> torch.Tensor:
        """What the value comes of, shape (n, latent_dim_vf)."""
        critic: torch.Tensor = self.value_net(features)
        return critic


class PosePolicy(MultiInputActorCriticPolicy):
    """Policy for Stable-Baselines3 in "pose" mode; arguments as there."""

    def __init__(self, *args: Any, **options: Any) -> None:
        options.setdefault("features_extractor_class", ObservationFeatures)
        super().__init__(*args, **options)

    def _build_mlp_extractor(self) -> None:
        assert isinstance(self.features_extractor, ObservationFeatures)
        assert isinstance(self.net_arch, list)
        self.mlp_extractor = ActorCriticExtractor(  # type: ignore[assignment]
            self.features_extractor, self.net_arch
        )

    def obs_to_tensor(  # type: ignore[override]
        self, observation: dict[str, np.ndarray]
    ) -> tuple[dict[str, torch.Tensor], bool]:
        """See `as_tensors`."""
        return as_tensors(self.observation_space, observation, self.device)
