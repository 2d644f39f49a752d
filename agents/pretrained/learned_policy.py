"""Trained networks as policies of the evaluation."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.policies import ActorCriticPolicy
from torch import nn

from coopmap_agents.networks import CandidateScorer, actor_parameters, stack
from coopmap_agents.pretrained.library import pretrained_names, pretrained_path
from coopmap_agents.pretrained.policy_file import load_policy, read_metadata
from coopmap_agents.record import POLICY_FILE
from coopmap_env.core.files import brief
from coopmap_env.envs import Belief, Observation

VARIABLE_LENGTH_KEYS = ("candidates", "action_mask", "teammates", "located")
"""Entries of an observation whose first axis may differ in length from training."""

Shapes = dict[str, tuple[int | str, ...]]


class LearnedPolicy:
    """A trained network as a `Policy`: each robot takes its most probable action.

    It decides among any number of candidates. If it was trained with teammates, their number may be
    any, including none.

    Parameters
    ----------
    model : path, str, ActorCriticPolicy or PPO, optional
        A file of `save_policy`, the name of a pretrained policy, a network, or a model of
        Stable-Baselines3. By default the first pretrained policy that fits the observations.
    seed : int, optional
        Seed of the training, for a pretrained policy; see `pretrained_path`.

    Raises
    ------
    ValueError
        If the file cannot be read, there is no pretrained policy of this name, or the model chooses
        among candidates and is not a `CandidateScorer`.
    """

    def __init__(
        self,
        model: ActorCriticPolicy | BaseAlgorithm | str | os.PathLike[str] | None = None,
        seed: int | None = None,
    ) -> None:
        self._seed = seed
        self._network = None if model is None else resolve_network(model, seed)
        self._pretrained: dict[frozenset[Any], ActorCriticPolicy] = {}
        """Pretrained networks by the shapes of observations: files are searched once for each."""

    def _load_compatible(self, observed: Mapping[str, tuple[int, ...]]) -> ActorCriticPolicy:
        kind = frozenset(observed.items())
        if kind not in self._pretrained:
            self._pretrained[kind] = load_policy(
                pretrained_path(_first_compatible(observed), self._seed)
            )
        return self._pretrained[kind]

    @property
    def fingerprint(self) -> str:
        """Hash of the weights; of all pretrained policies, where the observations decide which."""
        if self._network is not None:
            weights = actor_parameters(self._network).values()
            return _sha256(values.detach().cpu().numpy().tobytes() for values in weights)
        names = pretrained_names()
        return _sha256(pretrained_path(name, self._seed).read_bytes() for name in names)

    @property
    def n_parameters(self) -> int | None:
        """Numbers that acting needs; None before observations decide which network it is."""
        parameters = self._actor()
        return None if parameters is None else sum(values.numel() for values in parameters)

    @property
    def model_bytes(self) -> int | None:
        """Bytes of these."""
        parameters = self._actor()
        return None if parameters is None else sum(values.nbytes for values in parameters)

    def _actor(self) -> list[nn.Parameter] | None:
        """Parameters of the network that decides: of pretrained ones, the last one that did."""
        networks = [*self._pretrained.values(), *([self._network] if self._network else [])]
        return list(actor_parameters(networks[-1]).values()) if networks else None

    def reset(self, rng: np.random.Generator) -> None:
        """Does nothing: the policy has no memory and is deterministic."""

    def act(self, belief: Belief, observations: Mapping[str, Observation]) -> dict[str, Any]:
        """One action for each robot, from its own observation.

        Raises
        ------
        ValueError
            If the observations do not have the shapes of training, no pretrained policy fits them,
            or the weights are too large to compute with.
        """
        rows = stack(observations[agent] for agent in belief.agents)
        observed = {key: values.shape[1:] for key, values in rows.items()}
        network = self._network or self._load_compatible(observed)
        trained_on = network.observation_space
        assert isinstance(trained_on, spaces.Dict)
        trained = {key: box.shape or () for key, box in trained_on.spaces.items()}
        if not _is_compatible(trained, observed):
            raise ValueError(
                f"this policy was trained on observations {_without_lengths(trained)}, but got "
                f"{_without_lengths(observed)}: use the environment and action mode of its training"
            )
        actions = _decide(network, rows)
        return dict(zip(belief.agents, actions, strict=True))


def _decide(network: ActorCriticPolicy, rows: Mapping[str, Any]) -> Any:
    """The most probable actions; weights that are finite can still be too large to compute with."""
    try:
        actions, _ = network.predict(dict(rows), deterministic=True)
    except ValueError as error:  # of torch, about the parameters of a distribution
        raise ValueError(
            f"this policy's network gives no actions for these observations: {error!s:.80}..."
        ) from error
    return actions


def _sha256(parts: Iterable[bytes]) -> str:
    sha = hashlib.sha256()
    for part in parts:
        sha.update(part)
    return sha.hexdigest()


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
    if isinstance(model, str) and model in pretrained_names():
        return load_policy(pretrained_path(model, seed))
    _check_is_file(model)
    if seed is not None:
        raise ValueError(
            f"seed={seed} selects a training of a pretrained policy; {model} is a file"
        )
    return load_policy(model)


def _check_is_file(model: Any) -> None:
    is_path = isinstance(model, str | os.PathLike)
    if is_path and os.path.isfile(model):
        return
    if is_path and os.path.isdir(model):
        raise ValueError(
            f"model {str(model)!r} is a folder: name a file in it, such as {POLICY_FILE}"
        )
    raise ValueError(
        f"model {brief(model)} is neither a file nor one of the pretrained policies: "
        f"{', '.join(pretrained_names()) or 'none'}"
    )


def _first_compatible(observed: Mapping[str, tuple[int, ...]]) -> str:
    """Name of the first pretrained policy that fits observations of these shapes."""
    for name in pretrained_names():
        metadata = read_metadata(pretrained_path(name))
        if _is_compatible(
            {key: tuple(entry[1:]) for key, entry in metadata.observations.items()}, observed
        ):
            return name
    raise ValueError(
        f"no pretrained policy fits observations {_without_lengths(observed)}; there are "
        f"{', '.join(pretrained_names()) or 'none'}: give the file of your own as model="
    )


def _is_compatible(
    trained: Mapping[str, tuple[int, ...]], observed: Mapping[str, tuple[int, ...]]
) -> bool:
    """Whether a network trained on some shapes can decide on others."""
    missing = set(trained) - set(observed)
    if not missing <= {"state", "teammates"}:
        return False
    return _without_lengths(trained, missing) == _without_lengths(observed)


def _without_lengths(shapes: Mapping[str, tuple[int, ...]], without: Iterable[str] = ()) -> Shapes:
    """Shapes, without the lengths that may differ from training."""
    return {
        key: ("any", *shape[1:]) if key in VARIABLE_LENGTH_KEYS else shape
        for key, shape in shapes.items()
        if key not in without
    }
