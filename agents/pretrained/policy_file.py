"""Policies as files: weights by name and JSON metadata, in safetensors' format; no code inside.

The metadata say how to make the network (actions, observations, settings) and how it was trained.
The weights are those of the actor, without the critic.

Files of others can be read: nothing in them is executed, they name no other file, and the network
is made only if it is as large as the weights in the file.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import load, save
from stable_baselines3.common.policies import ActorCriticPolicy

from coopmap_agents.config import PPOSettings
from coopmap_agents.networks import actor_parameters, is_of_actor
from coopmap_agents.pretrained.metadata import FORMAT, PolicyMetadata
from coopmap_env.core.files import FileError, brief, read_bytes, write_atomically
from coopmap_env.core.version import __version__

METADATA_KEY = "coopmap"
"""Key of the JSON text in the file's header."""


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
        If the path has another suffix, the network was made with other settings, or a weight is
        not finite.
    """
    target = Path(path)
    if target.suffix != ".safetensors":
        raise ValueError(f"the suffix of a policy's file must be .safetensors, got {target}")
    metadata = PolicyMetadata.from_network(network, settings, training or {})
    weights = {
        name: values.detach().cpu().contiguous()
        for name, values in actor_parameters(network).items()
    }
    try:
        _check_shapes(weights, metadata)
    except ValueError as error:
        raise ValueError(f"the network was made with other settings, {target}: {error}") from error
    try:
        _check_values(weights)
    except ValueError as error:
        raise ValueError(f"{target} cannot be written: {error}") from error
    write_atomically(target, save(weights, {METADATA_KEY: json.dumps(asdict(metadata))}))


def read_metadata(path: str | os.PathLike[str]) -> PolicyMetadata:
    """Read the metadata of a policy's file.

    Raises
    ------
    FileError
        If it is not a policy's file, or one of another format.
    """
    return _read(path)[0]


def load_policy(path: str | os.PathLike[str]) -> ActorCriticPolicy:
    """Read a network from a file of `save_policy`; its critic is untrained.

    Raises
    ------
    FileError
        As `read_metadata`, or if the weights do not belong to the network of the metadata, or are
        not finite.
    """
    metadata, weights = _read(path)
    try:
        _check_shapes(weights, metadata)
        _check_values(weights)
        with torch.random.fork_rng(devices=[]):  # keeps the state of the global generator
            network = metadata.make()
    except Exception as error:  # torch raises many types of exceptions for odd shapes
        raise FileError(f"{path}: {error}") from error
    for name, values in actor_parameters(network).items():
        values.data.copy_(weights[name])
    network.set_training_mode(False)
    return network


def _read(path: str | os.PathLike[str]) -> tuple[PolicyMetadata, dict[str, torch.Tensor]]:
    """Metadata and weights of a file; the weights are not checked yet."""
    content = read_bytes(path)
    try:
        weights = load(content)
        header_length = int.from_bytes(content[:8], "little")
        header = json.loads(content[8 : 8 + header_length])
        values = json.loads(header["__metadata__"][METADATA_KEY])
        if values["format"] == FORMAT:
            return PolicyMetadata(**values), weights
        version = f"{values.get('version')!s:.40}"
    except Exception as error:  # safetensors raises many types of exceptions for a broken file
        raise FileError(
            f"{path} was not written by `coopmap train` or `save_policy`: {_reason(error)}"
        ) from error
    raise FileError(
        f"{path} was written by coopmap {version} in format {brief(values['format'])}, "
        f"this is {__version__} and reads format {FORMAT}: train the policy again, "
        "or install the version that wrote it"
    )


def _reason(error: Exception) -> str:
    return f"missing or unknown {error}" if isinstance(error, KeyError) else f"{error!s:.300}"


def _check_shapes(weights: Mapping[str, torch.Tensor], metadata: PolicyMetadata) -> None:
    """ValueError unless the weights have the shapes of the network of the metadata.

    They are compared before the network is made: a short text can describe a large network.
    """
    needed = {
        name: shape for name, shape in metadata.parameter_shapes().items() if is_of_actor(name)
    }
    shapes = {name: tuple(values.shape) for name, values in weights.items()}
    if shapes != needed:
        name = min(key for key in shapes | needed if shapes.get(key) != needed.get(key))
        raise ValueError(
            "the weights do not belong to the metadata: "
            f"{name} has the shape {shapes.get(name)}, not {needed.get(name)}"
        )


def _check_values(weights: Mapping[str, torch.Tensor]) -> None:
    for name, values in weights.items():
        if values.dtype != torch.float32:
            raise ValueError(f"the weights {name} must be of type float32, not {values.dtype}")
        if not values.isfinite().all():
            raise ValueError(f"the weights {name} must be finite numbers")
