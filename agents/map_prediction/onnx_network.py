"""A map network that predicts by ONNX Runtime, without torch."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from coopmap_agents.map_config import MapNetworkSettings
from coopmap_agents.map_prediction.graph import INPUT, OUTPUT
from coopmap_agents.map_prediction.images import cells_of, folded_images
from coopmap_agents.map_prediction.metadata import MAP_NETWORKS, MapMetadata
from coopmap_agents.onnx_model import OnnxModel


class OnnxMapNetwork(OnnxModel[MapMetadata]):
    """A network of a file of `save_map_network`; see `MapPredictor` for what it predicts."""

    KIND = MAP_NETWORKS

    @property
    def settings(self) -> MapNetworkSettings:
        """Size of the network."""
        return self._file.metadata.network

    def probability(self, images: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Prediction for each cell of images (n, *shape); see `map_image`."""
        probability: NDArray[np.float32] = expit(self.logits(images))
        return probability

    def logits(self, images: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Logits of the predictions."""
        stride = self.settings.stride
        blocks = self._session.outputs({INPUT: folded_images(images, stride)})[OUTPUT]
        return cells_of(blocks, stride, images.shape[1:])
