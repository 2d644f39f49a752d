"""Trained networks as policies that the evaluation takes."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from coopmap_agents import RL_EXTRA_HINT
from gymnasium import spaces

from coopmap_env.envs.belief import Belief, Observation

try:
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.policies import ActorCriticPolicy
except ImportError as error:
    raise ImportError(RL_EXTRA_HINT) from error

from coopmap_agents.networks.candidate_scorer import CandidateScorer
from coopmap_agents.networks.networks import actor_parameters
from coopmap_agents.pretrained.policy_file import load_policy, read_metadata
from coopmap_agents.pretrained.shipped import pretrained_names, pretrained_path
from coopmap_agents.sb3.vec_env import stack

VARIABLE_LENGTH_KEYS = ("candidates", "action_mask", "teammates", "located")
"""Entries of an observation whose first axis may have another length than in training."""

Shapes = dict[str, tuple[int | str, ...]]


class LearnedPolicy:
    """A trained network as a `Policy`: each robot does what it holds to be best, without chance.

    It decides among any number of candidates and beside any number of teammates, none included, if
    it was trained with some.

    Parameters
    ----------
    model : path, str, ActorCriticPolicy or PPO, optional
        A file of `save_policy`, the name of a policy that ships with coopmap, a network, or a model
        of Stable-Baselines3 that holds one. By default the first one that ships and fits the
        observations.
    seed : int, optional
        Of the training, for a policy that ships; see `pretrained_path`.

    Raises
    ------
    ValueError
        If the file cannot be read, no such policy ships, or the model chooses among candidates and
        is no `CandidateScorer`.
    """

    def __init__(
        self,
        model: ActorCriticPolicy | BaseAlgorithm | str | os.PathLike[str] | None = None,
        seed: int | None = None,
    ) -> None:
        self._seed = seed
        self._network = None if model is None else resolve_network(model, seed)
        self._pretrained: dict[frozenset[Any], ActorCriticPolicy] = {}
        """By the shapes of observations: files are looked through once for each kind of them."""

    def _load_compatible(self, observed: Mapping[str, tuple[int, ...]]) -> ActorCriticPolicy:
        kind = frozenset(observed.items())
        if kind not in self._pretrained:
            self._pretrained[kind] = load_policy(
                pretrained_path(_first_compatible(observed), self._seed)
            )
        return self._pretrained[kind]

    @property
    def fingerprint(self) -> str:
        """Hash of the weights: of all that ship, where the observations decide among them."""
        if self._network is not None:
            weights = actor_parameters(self._network).values()
            return _sha256(values.detach().cpu().numpy().tobytes() for values in weights)
        names = pretrained_names()
        return _sha256(pretrained_path(name, self._seed).read_bytes() for name in names)

    def reset(self, rng: np.random.Generator) -> None:
        """Nothing to forget and nothing to draw."""

    def act(self, belief: Belief, observations: Mapping[str, Observation]) -> dict[str, Any]:
        """One action for each robot, from its own observation.

        Raises
        ------
        ValueError
            If the observations are not of the shape that the network was trained on, or none that
            ships fits them.
        """
        rows = stack(observations[agent] for agent in belief.agents)
        observed = {key: values.shape[1:] for key, values in rows.items()}
        network = self._network or self._load_compatible(observed)
        trained_on = network.observation_space
        assert isinstance(trained_on, spaces.Dict)
        trained = {key: box.shape or () for key, box in trained_on.spaces.items()}
        if not _is_compatible(trained, observed):
            raise ValueError(
                f"this policy was trained on observations {_without_lengths(trained)}, but is given "
                f"{_without_lengths(observed)}: use the environment and the action mode that it was trained with"
            )
        actions, _ = network.predict(rows, deterministic=True)
        return dict(zip(belief.agents, actions, strict=True))


def _sha256(parts: Iterable[bytes]) -> str:
    sha = hashlib.sha256()
    for part in parts:
        sha.update(part)
    return sha.hexdigest()


def resolve_network(model: Any, seed: int | None = None) -> ActorCriticPolicy:
    """The network of a model, of a file, or of a policy that ships; see `LearnedPolicy`."""
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
    if str(model) in pretrained_names():
        return load_policy(pretrained_path(str(model), seed))
    if not Path(model).is_file():
        raise ValueError(
            f"model {str(model)!r} is neither a file nor one of the policies that ship: "
            f"{', '.join(pretrained_names()) or 'none'}"
        )
    if seed is not None:
        raise ValueError(f"seed={seed} picks a training of a policy that ships; {model} is a file")
    return load_policy(model)


def _first_compatible(observed: Mapping[str, tuple[int, ...]]) -> str:
    """Name of the first policy that ships and fits observations of these shapes."""
    for name in pretrained_names():
        metadata = read_metadata(pretrained_path(name))
        if _is_compatible(
            {key: tuple(entry[1:]) for key, entry in metadata.observations.items()}, observed
        ):
            return name
    raise ValueError(
        f"no policy that ships fits observations {_without_lengths(observed)}; there are "
        f"{', '.join(pretrained_names()) or 'none'}: name the file of your own with model="
    )


def _is_compatible(
    trained: Mapping[str, tuple[int, ...]], observed: Mapping[str, tuple[int, ...]]
) -> bool:
    """Whether a network that learned on some shapes can decide on others."""
    missing = set(trained) - set(observed)
    if not missing <= {"state", "teammates"}:
        return False
    return _without_lengths(trained, missing) == _without_lengths(observed)


def _without_lengths(shapes: Mapping[str, tuple[int, ...]], without: Iterable[str] = ()) -> Shapes:
    """Shapes, but for the lengths that do not matter."""
    return {
        key: ("any", *shape[1:]) if key in VARIABLE_LENGTH_KEYS else shape
        for key, shape in shapes.items()
        if key not in without
    }
