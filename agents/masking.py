"""A policy network that never takes a candidate which is masked out.

The observation holds the mask, so the network can apply it wherever it makes a distribution:
while it collects, while it learns (the probabilities of what was done are those it was done with),
and when it decides. Plain PPO can then train it; nothing has to pass masks around.
"""

from __future__ import annotations

from . import NEEDS_RL

try:
    import torch
    from stable_baselines3.common.distributions import CategoricalDistribution, Distribution
    from stable_baselines3.common.policies import MultiInputActorCriticPolicy
except ImportError as error:
    raise ImportError(NEEDS_RL) from error

MASKED_LOGIT = -1e8
"""Its probability is exactly 0 in float32, and 0 times it is 0: no NaN in the entropy."""

Observations = dict[str, torch.Tensor]


class MaskedPolicy(MultiInputActorCriticPolicy):
    """Stable-Baselines3's MultiInputPolicy with the logits of masked candidates cut off.

    Without an ``action_mask`` in the observation it is that policy unchanged. Actor and critic
    share their features extractor.
    """

    def forward(  # type: ignore[override]  # the parent declares one tensor and gets a dict too
        self, obs: Observations, deterministic: bool = False
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Actions (n, ...), values (n, 1) and log probabilities (n,) for n observations."""
        latent_pi, latent_vf = self._latents(obs)
        distribution = self._distribution(latent_pi, obs)
        actions = distribution.get_actions(deterministic=deterministic)
        log_prob = distribution.log_prob(actions)
        assert self.action_space.shape is not None
        return (
            actions.reshape((-1, *self.action_space.shape)),
            self.value_net(latent_vf),
            log_prob,
        )

    def evaluate_actions(  # type: ignore[override]
        self, obs: Observations, actions: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor | None]:
        """Values (n, 1), log probabilities (n,) and entropies (n,) of actions that were done."""
        latent_pi, latent_vf = self._latents(obs)
        distribution = self._distribution(latent_pi, obs)
        return self.value_net(latent_vf), distribution.log_prob(actions), distribution.entropy()

    def get_distribution(self, obs: Observations) -> Distribution:  # type: ignore[override]
        """Distribution of the actions for n observations."""
        return self._distribution(self._latents(obs)[0], obs)

    def _latents(self, obs: Observations) -> tuple[torch.Tensor, torch.Tensor]:
        features = self.extract_features(obs)
        assert isinstance(features, torch.Tensor)  # shared by actor and critic
        latents: tuple[torch.Tensor, torch.Tensor] = self.mlp_extractor(features)
        return latents

    def _distribution(self, latent_pi: torch.Tensor, obs: Observations) -> Distribution:
        if "action_mask" not in obs:
            return self._get_action_dist_from_latent(latent_pi)
        assert isinstance(self.action_dist, CategoricalDistribution)
        logits = self.action_net(latent_pi).masked_fill(obs["action_mask"] == 0, MASKED_LOGIT)
        return self.action_dist.proba_distribution(action_logits=logits)
