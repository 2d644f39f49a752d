"""The metadata of a map network's file, and the kind of these files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from coopmap_agents.map_config import MapNetworkSettings
from coopmap_agents.map_prediction.graph import map_graph
from coopmap_agents.model_files import ModelKind
from coopmap_agents.onnx.graph import Graph
from coopmap_env.core.files import brief
from coopmap_env.core.settings import Settings
from coopmap_env.core.version import __version__

METADATA_KEY = "coopmap_map_network"
"""Key of the JSON text in the file."""
FORMAT = 1
"""Increased when the network, or the meaning of its input, changes."""


@dataclass(frozen=True)
class MapMetadata(Settings):
    """Metadata of a map network's file.

    Raises
    ------
    ValueError
        With the field, if a value is not as described.
    """

    network: MapNetworkSettings
    training: Mapping[str, Any] = field(default_factory=dict)
    """Origin of the weights: configuration, steps and validation scores of the training."""
    version: str = __version__
    format: int = FORMAT

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.training, Mapping):
            raise ValueError(f"training must be a JSON object, got {brief(self.training)}")

    def graph(self) -> Graph:
        """The operations of the network."""
        return map_graph(self.network)


MAP_NETWORKS = ModelKind(
    name="map network",
    metadata_type=MapMetadata,
    metadata_key=METADATA_KEY,
    format=FORMAT,
    graph=MapMetadata.graph,
    command="coopmap train-map",
    function="save_map_network",
)
