"""Predicted occupancy of the cells of a map, and the networks that ship with coopmap."""

from __future__ import annotations

import os
from importlib.resources import files
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from coopmap_agents.map_prediction.examples import map_image
from coopmap_agents.map_prediction.model_file import load_map_network
from coopmap_agents.map_prediction.network import MapNetwork
from coopmap_agents.pretrained.weights import fingerprint_of
from coopmap_agents.trainer import torch_threads
from coopmap_env.core.files import brief
from coopmap_env.mapping import OccupancyMap

MODEL_FILES = {2: "planar.safetensors", 3: "field.safetensors"}
"""The networks that ship with coopmap, by the dimension of their maps."""
LEVELS = 255
"""Predictions are rounded to this fraction of one, so that the last bits of a processor's
arithmetic hardly ever matter."""


class MapPredictor:
    """What lies in the unknown cells of a map, as a network predicts it.

    In 2-D, the probability that a beam that reaches a cell ends there; in 3-D, that a voxel is
    surface.

    Parameters
    ----------
    model : MapNetwork or path, optional
        By default the network that ships with coopmap.
    dimension : {2, 3}
        Of the maps.

    Raises
    ------
    ValueError
        If it is none of these, or of another dimension.
    FileError
        If the file is not of a map network.
    """

    def __init__(
        self, model: MapNetwork | str | os.PathLike[str] | None = None, dimension: int = 2
    ) -> None:
        if model is not None and not isinstance(model, MapNetwork | str | os.PathLike):
            raise ValueError(f"model must be a file or a MapNetwork, got {brief(model)}")
        if dimension not in MODEL_FILES:
            raise ValueError(f"dimension must be one of {[*MODEL_FILES]}, got {brief(dimension)}")
        path = shipped_path(dimension) if model is None else model
        self.network = path if isinstance(path, MapNetwork) else load_map_network(path)
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
        with torch_threads(1), torch.inference_mode():
            logits = self.network(torch.from_numpy(map_image(map_))[None])[0]
            levels = (LEVELS * logits.sigmoid()).round() / LEVELS
        occupancy: NDArray[np.float32] = levels.numpy().ravel()
        if not np.isfinite(occupancy).all():
            raise ValueError("this map network gives no predictions for this map")
        return occupancy

    @property
    def n_parameters(self) -> int:
        """Numbers of the network."""
        return sum(values.numel() for values in self.network.parameters())

    @property
    def model_bytes(self) -> int:
        """Bytes of these."""
        return sum(values.nbytes for values in self.network.parameters())

    @property
    def fingerprint(self) -> str:
        """Hash of the weights."""
        weights = self.network.state_dict().values()
        return fingerprint_of(values.numpy().tobytes() for values in weights)


def shipped_path(dimension: int = 2) -> Path:
    """File of the network that ships with coopmap for maps of 2 or 3 dimensions."""
    return Path(str(files("coopmap_agents.map_prediction") / "models" / MODEL_FILES[dimension]))
