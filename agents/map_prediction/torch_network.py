"""A map network that predicts by torch."""

from __future__ import annotations

import coopmap_agents._require_rl  # noqa: F401

# isort: split
import numpy as np
import torch
from numpy.typing import NDArray

from coopmap_agents.map_config import MapNetworkSettings
from coopmap_agents.map_prediction.network import MapNetwork
from coopmap_agents.trainer import torch_threads


class TorchMapNetwork:
    """A `MapNetwork`; see `MapPredictor` for what it predicts."""

    def __init__(self, network: MapNetwork) -> None:
        self._network = network

    @property
    def settings(self) -> MapNetworkSettings:
        """Size of the network."""
        return self._network.settings

    def weights(self) -> list[NDArray[np.float32]]:
        """Weights of the network."""
        return [values.detach().cpu().numpy() for values in self._network.state_dict().values()]

    def probability(self, images: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Prediction for each cell of images (n, *shape); see `map_image`."""
        with torch_threads(1), torch.inference_mode():
            predicted = self._network(torch.from_numpy(images)).sigmoid()
        probability: NDArray[np.float32] = predicted.numpy()
        return probability
