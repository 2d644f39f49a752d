"""Map networks of torch as files: see `coopmap_agents.model_files`."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import coopmap_agents._require_rl  # noqa: F401

# isort: split
import torch

from coopmap_agents.map_prediction.metadata import MAP_NETWORKS, MapMetadata
from coopmap_agents.map_prediction.network import MapNetwork
from coopmap_agents.model_files import Weights, read_model, write_model
from coopmap_agents.weights import check_shapes, check_values
from coopmap_env.core.files import FileError


def save_map_network(
    network: MapNetwork, path: str | os.PathLike[str], training: Mapping[str, Any] | None = None
) -> None:
    """Write a network to a file, atomically.

    Parameters
    ----------
    network : MapNetwork
    path : path
        Ends in ``.safetensors`` or in ``.onnx``.
    training : mapping, optional
        JSON values, the origin of the weights.

    Raises
    ------
    ValueError
        If the path has another suffix, or a weight is not finite.
    """
    weights = {
        name: values.detach().cpu().contiguous().numpy()
        for name, values in network.state_dict().items()
    }
    try:
        check_values(weights)
    except ValueError as error:
        raise ValueError(f"{path} cannot be written: {error}") from error
    write_model(path, MAP_NETWORKS, MapMetadata(network.settings, dict(training or {})), weights)


def convert_map_network(source: str | os.PathLike[str], target: str | os.PathLike[str]) -> None:
    """Write the map network of a file in the format of another suffix, with the same metadata.

    Raises
    ------
    FileError
        As `load_map_network`.
    ValueError
        If the target has another suffix than those of `save_map_network`.
    """
    write_model(target, MAP_NETWORKS, *_read(source))


def load_map_network(path: str | os.PathLike[str]) -> MapNetwork:
    """Read a network from a file of `save_map_network`.

    Raises
    ------
    FileError
        If it is no such file, or one of another format, or its weights do not belong to its
        metadata or are not finite.
    """
    metadata, weights = _read(path)
    with torch.random.fork_rng(devices=[]):  # keeps the state of the global generator
        network = MapNetwork(metadata.network)
    network.load_state_dict({k: torch.from_numpy(v.copy()) for k, v in weights.items()})
    return network.eval()


def _read(path: str | os.PathLike[str]) -> tuple[MapMetadata, Weights]:
    metadata, weights = read_model(path, MAP_NETWORKS)
    try:
        check_shapes(weights, metadata.graph().weights)
        check_values(weights)
    except ValueError as error:
        raise FileError(f"{path}: {error}") from error
    return metadata, weights
