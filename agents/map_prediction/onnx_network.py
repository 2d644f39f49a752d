"""A map network that predicts by ONNX Runtime, without torch."""

from __future__ import annotations

import os

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from coopmap_agents.map_config import MapNetworkSettings
from coopmap_agents.map_prediction.graph import INPUT, OUTPUT
from coopmap_agents.map_prediction.images import cells_of, folded_images
from coopmap_agents.map_prediction.metadata import MAP_NETWORKS, MapMetadata
from coopmap_agents.model_files import OnnxFile, read_onnx
from coopmap_agents.onnx.session import OnnxSession

MapFile = OnnxFile[MapMetadata]


class OnnxMapNetwork:
    """A network of an ONNX file; see `MapPredictor` for what it predicts.

    Parameters
    ----------
    file : OnnxFile
        From `read_onnx`.

    Raises
    ------
    ImportError
        With the pip command, if ONNX Runtime is not installed.
    """

    def __init__(self, file: MapFile) -> None:
        self._file = file
        self._session = OnnxSession(file.content, file.path)

    @classmethod
    def from_path(cls, path: str | os.PathLike[str]) -> OnnxMapNetwork:
        """The network of a file of `save_map_network`.

        Raises
        ------
        FileError
            As `read_onnx`, or if ONNX Runtime refuses the file.
        """
        return cls(read_onnx(path, MAP_NETWORKS))

    def __reduce__(self) -> tuple[type[OnnxMapNetwork], tuple[MapFile]]:
        """A session cannot be sent to another process, its file can."""
        return OnnxMapNetwork, (self._file,)

    @property
    def settings(self) -> MapNetworkSettings:
        """Size of the network."""
        return self._file.metadata.network

    def weights(self) -> list[NDArray[np.float32]]:
        """Weights of the network, in the order of torch."""
        return list(self._file.weights.values())

    def probability(self, images: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Prediction for each cell of images (n, *shape); see `map_image`."""
        probability: NDArray[np.float32] = expit(self.logits(images))
        return probability

    def logits(self, images: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Logits of the predictions."""
        stride = self.settings.stride
        blocks = self._session.outputs({INPUT: folded_images(images, stride)})[OUTPUT]
        return cells_of(blocks, stride, images.shape[1:])
