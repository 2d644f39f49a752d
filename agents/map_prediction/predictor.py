"""Predicted occupancy of the cells of a map, and the networks that ship with coopmap.

Where torch is installed (extra ``rl``) it predicts, as in trainings. Where it is missing, ONNX
Runtime does (extra ``onnx``), from the ONNX files of the networks that ship with coopmap. Its
numbers differ by rounding, by less than 1e-5, and nearly always the same decisions follow. A file
that ends in ``.onnx`` is run by ONNX Runtime in both cases.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from coopmap_agents._backends import has_torch, require_torch
from coopmap_agents.map_config import USUAL_TRAININGS, MapNetworkSettings
from coopmap_agents.map_prediction.images import map_image
from coopmap_agents.map_prediction.library import shipped_path
from coopmap_agents.map_prediction.onnx_network import OnnxMapNetwork
from coopmap_agents.weights import fingerprint_of
from coopmap_env.core.files import brief
from coopmap_env.mapping import OccupancyMap

if TYPE_CHECKING:
    from coopmap_agents.map_prediction.network import MapNetwork

LEVELS = 255
"""Predictions are rounded to this fraction of one, so that the last bits of a processor's
arithmetic hardly ever matter."""


class PredictingNetwork(Protocol):
    """What predicts: a `TorchMapNetwork` or an `OnnxMapNetwork`."""

    @property
    def settings(self) -> MapNetworkSettings:
        """Size of the network."""

    def weights(self) -> list[NDArray[np.float32]]:
        """Weights of the network, in the order of torch."""

    def probability(self, images: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Prediction for each cell of images (n, *shape); see `map_image`."""


class MapPredictor:
    """What lies in the unknown cells of a map, as a network predicts it.

    In 2-D, the probability that a beam that reaches a cell ends there; in 3-D, that a voxel is
    surface. The module says whether torch or ONNX Runtime predicts.

    Parameters
    ----------
    model : MapNetwork or path, optional
        By default the network that ships with coopmap.
    dimension : {2, 3}
        Of the maps.
    seed : int, optional
        Seed of the training, for a network that ships with coopmap; see `shipped_path`.

    Raises
    ------
    ValueError
        If it is none of these, or of another dimension, there is no network of this seed, or a seed
        is given beside a model.
    FileError
        If the file is not of a map network.
    ImportError
        With the pip command, if what the file needs is not installed.
    """

    def __init__(
        self,
        model: MapNetwork | str | os.PathLike[str] | None = None,
        dimension: int = 2,
        seed: int | None = None,
    ) -> None:
        choices = [usual.network.dimension for usual in USUAL_TRAININGS.values()]
        if dimension not in choices:
            raise ValueError(f"dimension must be one of {choices}, got {brief(dimension)}")
        self.network = _predicting_network(model, dimension, seed)
        found = self.network.settings.dimension
        if found != dimension:
            raise ValueError(
                f"a network for maps of {dimension} dimensions is needed, and this one is for "
                f"{found}: {brief(model)}"
            )

    def occupancy(self, map_: OccupancyMap) -> NDArray[np.float32]:
        """Prediction for each cell (n_cells,), flat, a multiple of 1/255.

        Raises
        ------
        ValueError
            If the map is of another dimension than the network's, or the weights are too large to
            compute with.
        """
        needed = self.network.settings.dimension
        if map_.grid.dimension != needed:
            raise ValueError(
                f"this map network predicts maps of {needed} dimensions, and this one has "
                f"{map_.grid.dimension}: choose predictive in 2-D, predictive_surface in 3-D, "
                "or another model"
            )
        probability = self.network.probability(map_image(map_)[None]).ravel()
        if not np.isfinite(probability).all():
            raise ValueError("this map network gives no predictions for this map")
        return (np.round(LEVELS * probability) / LEVELS).astype(np.float32)

    @property
    def n_parameters(self) -> int:
        """Numbers of the network."""
        return sum(values.size for values in self.network.weights())

    @property
    def model_bytes(self) -> int:
        """Bytes of these."""
        return sum(values.nbytes for values in self.network.weights())

    @property
    def fingerprint(self) -> str:
        """Hash of the weights, the same for both formats of a file."""
        return fingerprint_of(values.tobytes() for values in self.network.weights())


def _predicting_network(model: Any, dimension: int, seed: int | None) -> PredictingNetwork:
    """What predicts; see the module."""
    if model is None:
        model = shipped_path(dimension, "safetensors" if has_torch() else "onnx", seed)
    elif seed is not None:
        raise ValueError(
            f"seed={seed!r:.80} selects a network that ships with coopmap; {brief(model)} is a "
            "model of its own"
        )
    is_path = isinstance(model, str | os.PathLike)
    if is_path and Path(model).suffix == ".onnx":
        return OnnxMapNetwork.from_path(model)
    if is_path:
        require_torch(model)
    elif not has_torch():
        raise ValueError(f"model must be a file or a MapNetwork, got {brief(model)}")
    from coopmap_agents.map_prediction.model_file import load_map_network
    from coopmap_agents.map_prediction.network import MapNetwork
    from coopmap_agents.map_prediction.torch_network import TorchMapNetwork

    network = load_map_network(model) if is_path else model
    if not isinstance(network, MapNetwork):
        raise ValueError(f"model must be a file or a MapNetwork, got {brief(model)}")
    return TorchMapNetwork(network)
