"""A policy among all poses: a Gaussian with independent entries, whose mean is a network's output.

It is the policy of Stable-Baselines3 except for the input of the critic, which includes the state
of the team where that is observed (`ObservationFeatures`).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from stable_baselines3.common.policies import MultiInputActorCriticPolicy
from torch import nn

from coopmap_agents.networks.features import ObservationFeatures, as_tensors
from coopmap_agents.networks.layers import mlp


class ActorCriticExtractor(nn.Module):
    """Hidden layers of the actor, from the robot's features, and of the critic, from all features.

    Replaces the `MlpExtractor` of Stable-Baselines3, which gives both the same input.
    """

    def __init__(self, features: ObservationFeatures, hidden: list[int]) -> None:
        super().__init__()
        self.latent_dim_pi = self.latent_dim_vf = hidden[-1]
        self.actor_dim = features.actor_dim
        self.policy_net = mlp([features.actor_dim, *hidden])
        self.value_net = mlp([features.features_dim, *hidden])

    def forward(self, features: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Latent vectors of the actor and of the critic."""
        return self.forward_actor(features), self.forward_critic(features)

    def forward_actor(self, features: torch.Tensor) -> torch.Tensor:
        """Latent vectors of the actor, shape (n, latent_dim_pi)."""
        actor: torch.Tensor = self.policy_net(features[:, : self.actor_dim])
        return actor

    def forward_critic(self, features: torch.Tensor) -> torch.Tensor:
        """Latent vectors of the critic, shape (n, latent_dim_vf)."""
        critic: torch.Tensor = self.value_net(features)
        return critic


class PosePolicy(MultiInputActorCriticPolicy):
    """Policy for Stable-Baselines3 in "pose" mode; arguments as in its `MultiInputPolicy`."""

    def __init__(self, *args: Any, **options: Any) -> None:
        options.setdefault("features_extractor_class", ObservationFeatures)
        options["normalize_images"] = False  # the features scale them
        super().__init__(*args, **options)

    def _build_mlp_extractor(self) -> None:
        assert isinstance(self.features_extractor, ObservationFeatures)
        assert isinstance(self.net_arch, list)
        self.mlp_extractor = ActorCriticExtractor(  # type: ignore[assignment]
            self.features_extractor, self.net_arch
        )

    def critic_inputs(self, obs: dict[str, torch.Tensor]) -> torch.Tensor:
        """Inputs (n, k) of the critic's layers, of n observations."""
        features = self.extract_features(obs)
        assert isinstance(features, torch.Tensor)  # shared by actor and critic
        return features

    def value_of(self, critic_inputs: torch.Tensor) -> torch.Tensor:
        """Values (n, 1) of inputs (n, k) of the critic's layers."""
        values: torch.Tensor = self.value_net(self.mlp_extractor.forward_critic(critic_inputs))
        return values

    def obs_to_tensor(  # type: ignore[override]
        self, observation: dict[str, np.ndarray]
    ) -> tuple[dict[str, torch.Tensor], bool]:
        """See `as_tensors`."""
        return as_tensors(self.observation_space, observation, self.device)
