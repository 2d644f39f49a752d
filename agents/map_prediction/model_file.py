"""Map networks as files: weights by name and JSON metadata, in safetensors' format; no code inside.

Files of others can be read: the network is made only if it is as large as the weights in the file.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import save

from coopmap_agents.map_config import MapNetworkSettings
from coopmap_agents.map_prediction.network import MapNetwork
from coopmap_agents.pretrained.policy_file import split_safetensors
from coopmap_env.core.files import FileError, read_bytes, write_atomically
from coopmap_env.core.settings import settings_from_dict, settings_to_dict
from coopmap_env.core.version import __version__

METADATA_KEY = "coopmap_map_network"
"""Key of the JSON text in the file's header."""
FORMAT = 1
"""Increased when the network, or the meaning of its input, changes."""


def save_map_network(
    network: MapNetwork, path: str | os.PathLike[str], training: Mapping[str, Any] | None = None
) -> None:
    """Write a network to a file, atomically.

    Parameters
    ----------
    network : MapNetwork
    path : path
    training : mapping, optional
        JSON values, the origin of the weights.
    """
    metadata = {
        "format": FORMAT,
        "version": __version__,
        "network": settings_to_dict(network.settings),
        "training": dict(training or {}),
    }
    weights = {name: values.contiguous() for name, values in network.state_dict().items()}
    write_atomically(Path(path), save(weights, {METADATA_KEY: json.dumps(metadata)}))


def load_map_network(path: str | os.PathLike[str]) -> MapNetwork:
    """Read a network from a file of `save_map_network`.

    Raises
    ------
    FileError
        If it is no such file, or one of another format, or its weights do not belong to its
        metadata or are not finite.
    """
    content = read_bytes(path)
    try:
        text, weights = split_safetensors(content, METADATA_KEY)
        metadata = json.loads(text)
        found = metadata["format"]
    except Exception as error:  # safetensors raises many types of exceptions for a broken file
        raise FileError(
            f"{path} was not written by `coopmap train-map` or `save_map_network`: {error!r:.300}"
        ) from error
    if found != FORMAT:
        raise FileError(
            f"{path} has the format {found!r:.20}, this is coopmap {__version__} and reads format "
            f"{FORMAT}: train the network again, or install the version that wrote it"
        )
    try:
        return _with_weights(settings_from_dict(metadata["network"], MapNetworkSettings), weights)
    except (ValueError, LookupError, TypeError) as error:
        raise FileError(f"{path} is broken: {error!s:.300}") from error


def _with_weights(settings: MapNetworkSettings, weights: dict[str, torch.Tensor]) -> MapNetwork:
    with torch.device("meta"):  # shapes without memory: a short text can describe a large network
        needed = {name: values.shape for name, values in MapNetwork(settings).state_dict().items()}
    if {name: values.shape for name, values in weights.items()} != needed:
        raise ValueError(f"its weights are not those of a network with {settings}")
    for name, values in weights.items():
        if values.dtype != torch.float32 or not values.isfinite().all():
            raise ValueError(f"the weights {name} must be finite numbers of type float32")
    with torch.random.fork_rng(devices=[]):  # keeps the state of the global generator
        network = MapNetwork(settings)
    network.load_state_dict(weights)
    return network.eval()
