"""A policy's network that decides by ONNX Runtime, without torch."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_agents.onnx_model import OnnxModel
from coopmap_agents.pretrained.metadata import PolicyMetadata
from coopmap_agents.pretrained.onnx.file_kind import POLICIES


class OnnxNetwork(OnnxModel[PolicyMetadata]):
    """A network of a file of `save_policy`; see `LearnedPolicy` for what it decides."""

    KIND = POLICIES

    @property
    def observation_shapes(self) -> dict[str, tuple[int, ...]]:
        """Shape of each entry of the observations in training."""
        return self._file.metadata.shapes()

    def decide(self, rows: Mapping[str, NDArray[Any]]) -> NDArray[Any]:
        """The most probable actions for the observations of n robots.

        Raises
        ------
        ValueError
            If the weights are too large to compute with.
        """
        values = self.outputs(rows)
        decisive = values["logits"] if "logits" in values else values["action_mean"]
        if not np.isfinite(decisive).all():
            raise ValueError("this policy's network gives no actions for these observations")
        if "logits" in values:
            actions: NDArray[Any] = decisive.argmax(axis=1)
            return actions
        return decisive.clip(-1.0, 1.0)

    def outputs(self, rows: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[np.float32]]:
        """Outputs of the graph by name, for the observations of n robots; see `policy_graph`."""
        n_robots = len(next(iter(rows.values())))
        inputs = {
            name: rows[name].astype(np.float32)
            if name in rows  # without teammates, the entry is missing
            else np.zeros((n_robots, 0, shape[-1]), np.float32)
            for name, shape in self._session.inputs.items()
        }
        return self._session.outputs(inputs)
