"""A policy among candidates: one network scores each of them, in any order and number.

Candidate i of m has the logit ::

    score(candidate i, summary) + RATING_GAIN * w * rating of i

The summary has the features of the observation (`ObservationFeatures`), and the mean and the
maximum over all feasible candidates. All candidates are scored by the same weights: permuting the
candidates permutes the logits, and a policy trained with m = 32 decides among 300. The value is a
function of the summary, and of the team's state where it is observed.

The second term is a direct path. With w = 1 and a score of zero (``initial_policy="rating"``) the
policy is the rating-function planner: training starts at the planner, and has to learn only where
to deviate from it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, get_args

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.distributions import CategoricalDistribution, Distribution
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.type_aliases import Schedule
from torch import nn

from coopmap_agents.architecture import (
    MASKED_LOGIT,
    MIN_STANDARD_DEVIATION,
    RATING_FEATURE_INDEX,
    RATING_GAIN,
)
from coopmap_agents.config import InitialPolicy
from coopmap_agents.networks.features import ObservationFeatures, as_tensors
from coopmap_agents.networks.layers import Tanh, mlp, sum_and_max
from coopmap_env.core.arguments import check_choice

Observations = dict[str, torch.Tensor]


class ScoringNetwork(nn.Module):
    """Scores of candidates and the value, from their features and those of the observation.

    Parameters
    ----------
    n_features : int
        F, of each candidate.
    n_context : int
        G, of the observation.
    n_state : int
        S, of the team's state, an input of the critic only; 0 without one.
    hidden : sequence of int
        Widths of the hidden layers of the actor and of the critic; the first is also the width of
        the encoder.
    """

    def __init__(
        self, n_features: int, n_context: int, n_state: int, hidden: Sequence[int]
    ) -> None:
        super().__init__()
        width = hidden[0]
        n_summary = n_context + 2 * width
        self.n_context = n_context
        self.encoder = nn.Sequential(nn.Linear(2 * n_features, width), nn.ReLU(inplace=True))
        self.from_candidate = nn.Linear(width, width)
        self.from_summary = nn.Linear(n_summary, width, bias=False)
        self.mixed = nn.Sequential(Tanh(), mlp(list(hidden)))
        self.score = nn.Linear(hidden[-1], 1, bias=False)  # a softmax is invariant to a bias
        self.value = nn.Sequential(
            mlp([n_summary + n_state, width, *hidden]), nn.Linear(hidden[-1], 1)
        )
        self.rating_weight = nn.Parameter(torch.zeros(()))

    def forward(
        self, candidates: torch.Tensor, mask: torch.Tensor, context: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Logits (n, m) before masking, and values (n, 1).

        Parameters
        ----------
        candidates : Tensor, shape (n, m, F)
        mask : Tensor of bool, shape (n, m)
            True for feasible candidates.
        context : Tensor, shape (n, G + S)
            The team's state comes last.
        """
        encoded, summary, critic_input = self._encode(candidates, mask, context)
        mixed = self.from_candidate(encoded) + self.from_summary(summary).unsqueeze(1)
        scores = self.score(self.mixed(mixed)).squeeze(-1)
        direct = RATING_GAIN * self.rating_weight * candidates[..., RATING_FEATURE_INDEX]
        return scores + direct, self.value(critic_input)

    def critic_inputs(
        self, candidates: torch.Tensor, mask: torch.Tensor, context: torch.Tensor
    ) -> torch.Tensor:
        """What the value is a function of, (n, G + 2 H + S)."""
        return self._encode(candidates, mask, context)[2]

    def _encode(
        self, candidates: torch.Tensor, mask: torch.Tensor, context: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Encoded candidates (n, m, H), summary (n, G + 2 H), critic's input (n, G + 2 H + S)."""
        weights = mask.to(candidates.dtype).unsqueeze(-1)
        n_feasible = weights.sum(dim=1, keepdim=True).clamp(min=1)
        inputs = torch.cat([candidates, _standardized(candidates, weights, n_feasible)], dim=-1)
        # flat, since of 3-D inputs a linear layer gives a view, which ReLU overwrites far slower
        encoded = self.encoder(inputs.flatten(0, 1)).view(*mask.shape, -1) * weights
        total, largest = sum_and_max(encoded)  # masked candidates are 0, and none is smaller
        own, state = context.tensor_split([self.n_context], dim=1)
        summary = torch.cat([own, total / n_feasible[:, 0], largest], dim=1)
        return encoded, summary, torch.cat([summary, state], dim=1)


def _standardized(
    candidates: torch.Tensor, weights: torch.Tensor, n_feasible: torch.Tensor
) -> torch.Tensor:
    """Features less their mean over the feasible candidates, in standard deviations."""
    centered = candidates - (candidates * weights).sum(dim=1, keepdim=True) / n_feasible
    variance = (centered**2 * weights).sum(dim=1, keepdim=True) / n_feasible
    return centered / (variance + MIN_STANDARD_DEVIATION**2).sqrt()


class CandidateScorer(ActorCriticPolicy):
    """Policy for Stable-Baselines3 in "candidates" mode.

    The observation contains the action mask, and the network applies it to every distribution:
    while collecting, while learning (so the probability ratios are correct), and when deciding. So
    standard PPO can train it, without masks as arguments.

    Parameters
    ----------
    observation_space : gymnasium.spaces.Dict
        With ``candidates`` (m, F) and ``action_mask`` (m,); see the environments' `observations`.
    action_space : gymnasium.spaces.Discrete
    lr_schedule : callable
    initial_policy : {"random", "rating"}
        Initial policy: nearly uniform, or exactly the rating-function planner.
    net_arch : sequence of int
        See `ScoringNetwork`.
    features_extractor_class, **kwargs
        As in `ActorCriticPolicy`; actor and critic share their features.

    Raises
    ------
    ValueError
        If the observations have no candidates, or an argument is not one of its choices.
    """

    def __init__(
        self,
        observation_space: spaces.Dict,
        action_space: spaces.Discrete,
        lr_schedule: Schedule,
        initial_policy: InitialPolicy = "random",
        net_arch: Sequence[int] = (64, 64),
        features_extractor_class: type[ObservationFeatures] = ObservationFeatures,
        **kwargs: Any,
    ) -> None:
        if not {"candidates", "action_mask"} <= set(getattr(observation_space, "spaces", ())):
            raise ValueError(
                "a CandidateScorer needs observations with candidates and their action_mask, as in "
                f'action_mode="candidates", got {observation_space}'
            )
        check_choice("initial_policy", initial_policy, get_args(InitialPolicy))
        if not net_arch:
            raise ValueError(f"net_arch needs at least one layer, got {net_arch!r}")
        self.initial_policy = initial_policy
        kwargs["normalize_images"] = False  # the features scale them
        super().__init__(
            observation_space, action_space, lr_schedule, list(net_arch),
            features_extractor_class=features_extractor_class, **kwargs,
        )  # fmt: skip

    def _get_constructor_parameters(self) -> dict[str, Any]:
        return {**super()._get_constructor_parameters(), "initial_policy": self.initial_policy}

    def _build(self, lr_schedule: Schedule) -> None:
        assert isinstance(self.observation_space, spaces.Dict)
        assert isinstance(self.net_arch, list)
        shape = self.observation_space["candidates"].shape
        features = self.features_extractor
        assert shape is not None
        assert isinstance(features, ObservationFeatures)
        self.network = ScoringNetwork(
            shape[-1], features.actor_dim, features.state_dim, self.net_arch
        )
        for part in (self.features_extractor, self.network):
            for module in part.modules():
                self.init_weights(module, gain=np.sqrt(2))
        self.init_weights(self.network.value[-1], gain=0.01)  # rewards of a step are small
        self.init_weights(self.network.score, gain=0.01)
        if self.initial_policy == "rating":
            nn.init.zeros_(self.network.score.weight)
            nn.init.ones_(self.network.rating_weight)
        self.optimizer = self.optimizer_class(
            self.parameters(),
            lr=lr_schedule(1),  # type: ignore[call-arg]  # of Adam and the like
            **self.optimizer_kwargs,
        )

    def forward(  # type: ignore[override]  # the parent declares one tensor and gets a dict too
        self, obs: Observations, deterministic: bool = False
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Actions (n,), values (n, 1) and log probabilities (n,) for n observations."""
        distribution, values = self._distribution_and_values(obs)
        actions = distribution.get_actions(deterministic=deterministic)
        return actions, values, distribution.log_prob(actions)

    def evaluate_actions(  # type: ignore[override]
        self, obs: Observations, actions: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor | None]:
        """Values (n, 1), log probabilities (n,) and entropies (n,) of given actions."""
        distribution, values = self._distribution_and_values(obs)
        return values, distribution.log_prob(actions), distribution.entropy()

    def get_distribution(self, obs: Observations) -> Distribution:  # type: ignore[override]
        """Distribution of the actions for n observations."""
        return self._distribution_and_values(obs)[0]

    def predict_values(self, obs: Observations) -> torch.Tensor:  # type: ignore[override]
        """Values (n, 1) of n observations."""
        return self.value_of(self.critic_inputs(obs))

    def critic_inputs(self, obs: Observations) -> torch.Tensor:
        """Inputs (n, k) of the critic's layers, of n observations."""
        return self.network.critic_inputs(*self._inputs(obs))

    def value_of(self, critic_inputs: torch.Tensor) -> torch.Tensor:
        """Values (n, 1) of inputs (n, k) of the critic's layers."""
        values: torch.Tensor = self.network.value(critic_inputs)
        return values

    def obs_to_tensor(  # type: ignore[override]
        self, observation: dict[str, np.ndarray]
    ) -> tuple[Observations, bool]:
        """See `as_tensors`."""
        return as_tensors(self.observation_space, observation, self.device)

    def _inputs(self, obs: Observations) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        context = self.extract_features(obs)
        assert isinstance(context, torch.Tensor)  # shared by actor and critic
        return obs["candidates"].float(), obs["action_mask"] != 0, context

    def _distribution_and_values(self, obs: Observations) -> tuple[Distribution, torch.Tensor]:
        candidates, mask, context = self._inputs(obs)
        logits, values = self.network(candidates, mask, context)
        assert isinstance(self.action_dist, CategoricalDistribution)
        masked = logits.masked_fill(~mask, MASKED_LOGIT)
        return self.action_dist.proba_distribution(action_logits=masked), values
