"""Trained networks as policies of the evaluation.

Where torch is installed (extra ``rl``) it decides, as in trainings, so that results are those of
the validation in training.json and of all records so far, bit for bit. Where it is missing, ONNX
Runtime decides (extra ``onnx``), from the ONNX files of the pretrained policies. Its numbers differ
by rounding, by less than 1e-5, and nearly always the same actions follow. A file that ends in
``.onnx`` is run by ONNX Runtime in both cases.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from coopmap_agents._backends import has_torch, require_torch
from coopmap_agents.model_files import read_onnx
from coopmap_agents.observations import LATER_KEYS, VARIABLE_LENGTH_KEYS, stack
from coopmap_agents.pretrained.library import find_policy, pretrained_names, pretrained_path
from coopmap_agents.pretrained.onnx.file_kind import POLICIES
from coopmap_agents.pretrained.onnx.network import OnnxNetwork
from coopmap_agents.weights import fingerprint_of
from coopmap_env.envs import Belief, Observation

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.policies import ActorCriticPolicy

Shapes = dict[str, tuple[int | str, ...]]


class ActingNetwork(Protocol):
    """What decides: a `TorchNetwork` or an `OnnxNetwork`."""

    @property
    def observation_shapes(self) -> dict[str, tuple[int, ...]]:
        """Shape of each entry of the observations in training."""

    def weights(self) -> list[NDArray[np.float32]]:
        """Weights of the actor, in the order of torch."""

    def decide(self, rows: Mapping[str, NDArray[Any]]) -> NDArray[Any]:
        """The most probable actions for the observations of n robots."""


class LearnedPolicy:
    """A trained network as a `Policy`: each robot takes its most probable action.

    It decides among any number of candidates. If it was trained with teammates, their number may be
    any, including none. The module says whether torch or ONNX Runtime decides.

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
    ImportError
        With the pip command, if what the file needs is not installed.
    """

    def __init__(
        self,
        model: ActorCriticPolicy | BaseAlgorithm | str | os.PathLike[str] | None = None,
        seed: int | None = None,
    ) -> None:
        self._seed = seed
        self._network = None if model is None else _acting_network(model, seed)
        self._pretrained: dict[frozenset[Any], ActingNetwork] = {}
        """Pretrained networks by the shapes of observations: files are searched once for each."""

    def _load_compatible(self, observed: Mapping[str, tuple[int, ...]]) -> ActingNetwork:
        kind = frozenset(observed.items())
        if kind not in self._pretrained:
            self._pretrained[kind] = _acting_network(_first_compatible(observed), self._seed)
        return self._pretrained[kind]

    @property
    def fingerprint(self) -> str:
        """Hash of the weights; of all pretrained policies, where the observations decide which.

        It is the same for both formats of a file, and for torch and ONNX Runtime.
        """
        if self._network is not None:
            return fingerprint_of(values.tobytes() for values in self._network.weights())
        names = pretrained_names()
        return fingerprint_of(pretrained_path(name, self._seed).read_bytes() for name in names)

    @property
    def n_parameters(self) -> int | None:
        """Numbers that acting needs; None before observations decide which network it is."""
        weights = self._weights()
        return None if weights is None else sum(values.size for values in weights)

    @property
    def model_bytes(self) -> int | None:
        """Bytes of these."""
        weights = self._weights()
        return None if weights is None else sum(values.nbytes for values in weights)

    def _weights(self) -> list[NDArray[np.float32]] | None:
        """Weights of the network that decides: of pretrained ones, the last one that did."""
        networks = [*self._pretrained.values(), *([self._network] if self._network else [])]
        return networks[-1].weights() if networks else None

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
        trained = network.observation_shapes
        if not _is_compatible(trained, observed):
            raise ValueError(
                f"this policy was trained on observations {_without_lengths(trained)}, but got "
                f"{_without_lengths(observed)}: use the environment and action mode of its training"
            )
        return dict(zip(belief.agents, network.decide(rows), strict=True))


def _acting_network(model: Any, seed: int | None) -> ActingNetwork:
    """What decides; see the module."""
    is_path = isinstance(model, str | os.PathLike)
    if is_path and Path(model).suffix == ".onnx":
        return OnnxNetwork.from_path(find_policy(model, seed))
    if is_path and model in pretrained_names() and not has_torch():
        return OnnxNetwork.from_path(find_policy(model, seed, "onnx"))
    if is_path:
        require_torch(find_policy(model, seed))  # the errors about the file come first
    from coopmap_agents.pretrained.torch_network import TorchNetwork, resolve_network

    return TorchNetwork(resolve_network(model, seed))


def _first_compatible(observed: Mapping[str, tuple[int, ...]]) -> str:
    """Name of the first pretrained policy that fits observations of these shapes."""
    for name in pretrained_names():
        metadata = read_onnx(pretrained_path(name, file_format="onnx"), POLICIES).metadata
        if _is_compatible(metadata.shapes(), observed):
            return name
    raise ValueError(
        f"no pretrained policy fits observations {_without_lengths(observed)}; there are "
        f"{', '.join(pretrained_names()) or 'none'}: give the file of your own as model="
    )


def _is_compatible(
    trained: Mapping[str, tuple[int, ...]], observed: Mapping[str, tuple[int, ...]]
) -> bool:
    """Whether a network trained on some shapes can decide on others."""
    missing, unknown = set(trained) - set(observed), set(observed) - set(trained)
    if not (missing <= {"state", "teammates"} and unknown <= set(LATER_KEYS)):
        return False
    return _without_lengths(trained, missing) == _without_lengths(observed, unknown)


def _without_lengths(shapes: Mapping[str, tuple[int, ...]], without: Iterable[str] = ()) -> Shapes:
    """Shapes, without the lengths that may differ from training."""
    return {
        key: ("any", *shape[1:]) if key in VARIABLE_LENGTH_KEYS else shape
        for key, shape in shapes.items()
        if key not in without
    }
