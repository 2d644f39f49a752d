"""A policy's network that decides by torch."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import coopmap_agents._require_rl  # noqa: F401

# isort: split
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.policies import ActorCriticPolicy

from coopmap_agents.networks import CandidateScorer, actor_parameters
from coopmap_agents.pretrained.library import find_policy
from coopmap_agents.pretrained.policy_file import load_policy


class TorchNetwork:
    """A network of Stable-Baselines3; see `LearnedPolicy` for what it decides."""

    def __init__(self, network: ActorCriticPolicy) -> None:
        self._network = network

    @property
    def observation_shapes(self) -> dict[str, tuple[int, ...]]:
        """Shape of each entry of the observations in training."""
        trained_on = self._network.observation_space
        assert isinstance(trained_on, spaces.Dict)
        return {key: box.shape or () for key, box in trained_on.spaces.items()}

    def weights(self) -> list[NDArray[np.float32]]:
        """Weights of the actor."""
        parameters = actor_parameters(self._network).values()
        return [values.detach().cpu().numpy() for values in parameters]

    def decide(self, rows: Mapping[str, NDArray[Any]]) -> NDArray[Any]:
        """The most probable actions for the observations of n robots.

        Raises
        ------
        ValueError
            If the weights, which are finite, are too large to compute with.
        """
        try:
            actions, _ = self._network.predict(dict(rows), deterministic=True)
        except ValueError as error:  # of torch, about the parameters of a distribution
            raise ValueError(
                f"this policy's network gives no actions for these observations: {error!s:.80}..."
            ) from error
        return actions


def resolve_network(model: Any, seed: int | None = None) -> ActorCriticPolicy:
    """The network of a model, of a file, or of a pretrained policy; see `LearnedPolicy`."""
    if isinstance(model, BaseAlgorithm):
        model = model.policy
    if isinstance(model, ActorCriticPolicy):
        if isinstance(model.action_space, spaces.Discrete) and not isinstance(
            model, CandidateScorer
        ):
            raise ValueError(
                "a model that chooses among candidates must have a CandidateScorer, "
                f"got {type(model).__name__}"
            )
        return model
    return load_policy(find_policy(model, seed))
