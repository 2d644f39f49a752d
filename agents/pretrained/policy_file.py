"""Policies as files: weights by name and JSON metadata, in safetensors' format; no code inside.

The metadata say how to make the network (actions, observations, settings) and how it was trained.
The weights are those of the actor, without the critic.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from stable_baselines3.common.policies import ActorCriticPolicy

from coopmap_agents.config import PPOSettings
from coopmap_agents.networks import actor_parameters, make_network
from coopmap_env.core.files import atomic_path
from coopmap_env.core.settings import settings_from_dict
from coopmap_env.core.version import __version__

FORMAT = 2
"""Increased when the networks, the metadata or the meaning of observations change: older files can
then no longer be read. Format 2 (0.2.0) has other keys of the metadata than format 1."""
METADATA_KEY = "coopmap"
"""Key of the JSON text in the file's header."""


@dataclass(frozen=True)
class PolicyMetadata:
    """Metadata of a policy's file."""

    observations: Mapping[str, Any]
    """Type and shape of each entry of the observations, such as ["float32", 4]."""
    n_candidates: int | None
    """Number of candidates in training, in "candidates" mode."""
    action_size: int | None
    """Length of an action, in "pose" mode."""
    ppo: Mapping[str, Any]
    """`PPOSettings` of the training."""
    training: Mapping[str, Any] = field(default_factory=dict)
    """Origin of the weights: configuration, steps and validation scores of the training."""
    version: str = __version__
    format: int = FORMAT

    @classmethod
    def from_network(
        cls, network: ActorCriticPolicy, settings: PPOSettings, training: Mapping[str, Any]
    ) -> PolicyMetadata:
        """Metadata of a network."""
        observation_space, actions = network.observation_space, network.action_space
        assert isinstance(observation_space, spaces.Dict)
        is_discrete = isinstance(actions, spaces.Discrete)
        return cls(
            {
                key: [np.dtype(space.dtype).name, *(space.shape or ())]
                for key, space in observation_space.spaces.items()
                if key != "state"
            },
            int(actions.n) if isinstance(actions, spaces.Discrete) else None,
            None if is_discrete else int(np.prod(actions.shape or ())),
            asdict(settings),
            training,
        )

    def make(self) -> ActorCriticPolicy:
        """Make the network, with random weights and a critic of the local observation."""
        actions: spaces.Space[Any]
        if self.n_candidates is not None:
            actions = spaces.Discrete(self.n_candidates)
        else:
            actions = spaces.Box(-1.0, 1.0, (self.action_size or 0,), np.float32)
        boxes: dict[str, spaces.Space[Any]] = {
            key: _box(*entry) for key, entry in self.observations.items()
        }
        settings = settings_from_dict({**self.ppo, "critic": "local", "device": "cpu"}, PPOSettings)
        return make_network(spaces.Dict(boxes), actions, settings)


def save_policy(
    network: ActorCriticPolicy,
    settings: PPOSettings,
    path: str | os.PathLike[str],
    training: Mapping[str, Any] | None = None,
) -> None:
    """Write the actor of a network to a file, atomically.

    Parameters
    ----------
    network : ActorCriticPolicy
        From `make_network`, or the ``policy`` of a trained model.
    settings : PPOSettings
        Settings of the network.
    path : path
        Ends in ``.safetensors``.
    training : mapping, optional
        JSON values, the origin of the weights.

    Raises
    ------
    ValueError
        If the path has another suffix, or the network was made with other settings.
    """
    target = Path(path)
    if target.suffix != ".safetensors":
        raise ValueError(f"the suffix of a policy's file must be .safetensors, got {target}")
    metadata = PolicyMetadata.from_network(network, settings, training or {})
    weights = {
        name: values.detach().cpu().contiguous()
        for name, values in actor_parameters(network).items()
    }
    _check_shapes(
        weights, _untrained_network(metadata), f"the network was made with other settings, {target}"
    )
    target.parent.mkdir(parents=True, exist_ok=True)
    with atomic_path(target) as temporary:
        save_file(weights, temporary, {METADATA_KEY: json.dumps(asdict(metadata))})
        temporary.chmod(0o644)  # safetensors makes files that only their owner can read


def read_metadata(path: str | os.PathLike[str]) -> PolicyMetadata:
    """Read the metadata of a policy's file, without the weights.

    Raises
    ------
    ValueError
        If it is not a policy's file, or one of another format.
    """
    try:
        with safe_open(path, "pt") as file:
            values = json.loads((file.metadata() or {})[METADATA_KEY])
        if values["format"] == FORMAT:
            return PolicyMetadata(**values)
    except (SafetensorError, json.JSONDecodeError, KeyError, TypeError) as error:
        raise ValueError(
            f"{path} was not written by `coopmap train` or `save_policy`: {error}"
        ) from error
    raise ValueError(
        f"{path} was written by coopmap {values.get('version')} in format {values['format']}, "
        f"this is {__version__} and reads format {FORMAT}: train the policy again, "
        "or install the version that wrote it"
    )


def load_policy(path: str | os.PathLike[str]) -> ActorCriticPolicy:
    """Read a network from a file of `save_policy`; its critic is untrained.

    Raises
    ------
    ValueError
        As `read_metadata`, or if the weights do not belong to the network of the metadata.
    """
    network = _untrained_network(read_metadata(path))
    with safe_open(path, "pt") as file:
        weights = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118  # not a mapping
    _check_shapes(weights, network, f"the weights in {path} do not belong to its metadata")
    for name, values in actor_parameters(network).items():
        values.data.copy_(weights[name])
    network.set_training_mode(False)
    return network


def _untrained_network(metadata: PolicyMetadata) -> ActorCriticPolicy:
    with torch.random.fork_rng(devices=[]):  # keeps the state of the global generator
        return metadata.make()


def _check_shapes(
    weights: Mapping[str, torch.Tensor], network: ActorCriticPolicy, what: str
) -> None:
    shapes, needed = (
        {name: tuple(values.shape) for name, values in part.items()}
        for part in (weights, actor_parameters(network))
    )
    if shapes != needed:
        name = min(key for key in shapes | needed if shapes.get(key) != needed.get(key))
        raise ValueError(f"{what}: {name} has the shape {shapes.get(name)}, not {needed.get(name)}")


def _box(dtype: str, *shape: int) -> spaces.Box:
    low, high = (0, 255) if dtype == "uint8" else (-1, 1)
    return spaces.Box(low, high, shape, np.dtype(dtype).type)
