"""Trained networks as policies that the evaluation takes."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from coopmap_agents import NEEDS_RL
from gymnasium import spaces

from coopmap_env.envs.belief import Belief, Observation

try:
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.policies import ActorCriticPolicy
except ImportError as error:
    raise ImportError(NEEDS_RL) from error

from coopmap_agents.networks.candidate_scorer import CandidateScorer
from coopmap_agents.networks.networks import acting_weights
from coopmap_agents.pretrained.policy_file import load_policy, read_page
from coopmap_agents.pretrained.shipped import shipped_file, shipped_names
from coopmap_agents.sb3.vec_env import stack

ANY_LENGTH = ("candidates", "action_mask", "teammates", "located")
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
        Of the training, for a policy that ships; see `shipped_file`.

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
        self._given = None if model is None else network_of(model, seed)
        self._fitting: dict[frozenset[Any], ActorCriticPolicy] = {}
        """By the shapes of observations: files are looked through once for each kind of them."""

    def _fit(self, given: Mapping[str, tuple[int, ...]]) -> ActorCriticPolicy:
        kind = frozenset(given.items())
        if kind not in self._fitting:
            self._fitting[kind] = load_policy(shipped_file(_fitting(given), self._seed))
        return self._fitting[kind]

    @property
    def fingerprint(self) -> str:
        """Hash of the weights: of all that ship, where the observations decide among them."""
        if self._given is not None:
            weights = acting_weights(self._given).values()
            return _sha256(values.detach().cpu().numpy().tobytes() for values in weights)
        names = shipped_names()
        return _sha256(shipped_file(name, self._seed).read_bytes() for name in names)

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
        given = {key: values.shape[1:] for key, values in rows.items()}
        network = self._given or self._fit(given)
        trained_on = network.observation_space
        assert isinstance(trained_on, spaces.Dict)
        learned = {key: box.shape or () for key, box in trained_on.spaces.items()}
        if not _fits(learned, given):
            raise ValueError(
                f"this policy was trained on observations {_free(learned)}, but is given "
                f"{_free(given)}: use the environment and the action mode that it was trained with"
            )
        actions, _ = network.predict(rows, deterministic=True)
        return dict(zip(belief.agents, actions, strict=True))


def _sha256(parts: Iterable[bytes]) -> str:
    sha = hashlib.sha256()
    for part in parts:
        sha.update(part)
    return sha.hexdigest()


def network_of(model: Any, seed: int | None = None) -> ActorCriticPolicy:
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
    if str(model) in shipped_names():
        return load_policy(shipped_file(str(model), seed))
    if not Path(model).is_file():
        raise ValueError(
            f"model {str(model)!r} is neither a file nor one of the policies that ship: "
            f"{', '.join(shipped_names()) or 'none'}"
        )
    if seed is not None:
        raise ValueError(f"seed={seed} picks a training of a policy that ships; {model} is a file")
    return load_policy(model)


def _fitting(given: Mapping[str, tuple[int, ...]]) -> str:
    """Name of the first policy that ships and fits observations of these shapes."""
    for name in shipped_names():
        page = read_page(shipped_file(name))
        if _fits({key: tuple(entry[1:]) for key, entry in page.observations.items()}, given):
            return name
    raise ValueError(
        f"no policy that ships fits observations {_free(given)}; there are "
        f"{', '.join(shipped_names()) or 'none'}: name the file of your own with model="
    )


def _fits(learned: Mapping[str, tuple[int, ...]], given: Mapping[str, tuple[int, ...]]) -> bool:
    """Whether a network that learned on some shapes can decide on others."""
    missing = set(learned) - set(given)
    if not missing <= {"state", "teammates"}:
        return False
    return _free(learned, missing) == _free(given)


def _free(shapes: Mapping[str, tuple[int, ...]], without: Iterable[str] = ()) -> Shapes:
    """Shapes, but for the lengths that do not matter."""
    return {
        key: ("any", *shape[1:]) if key in ANY_LENGTH else shape
        for key, shape in shapes.items()
        if key not in without
    }
