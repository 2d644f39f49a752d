"""A policy's network that decides by ONNX Runtime, without torch."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_agents.pretrained.onnx.file import OnnxFile, read_onnx
from coopmap_env.core.extras import import_optional
from coopmap_env.core.files import FileError

ERRORS_ONLY = 3
"""Of what ONNX Runtime logs to the standard error."""


class OnnxNetwork:
    """A network of an ONNX file; see `LearnedPolicy` for what it decides.

    Parameters
    ----------
    file : OnnxFile

    Raises
    ------
    ImportError
        With the pip command, if ONNX Runtime is not installed.
    """

    def __init__(self, file: OnnxFile) -> None:
        self._file = file
        self._session = _session(file.content)
        self._inputs = {one.name: one.shape for one in self._session.get_inputs()}

    @classmethod
    def from_path(cls, path: str | os.PathLike[str]) -> OnnxNetwork:
        """The network of a file of `save_policy`.

        Raises
        ------
        FileError
            As `read_onnx`, or if ONNX Runtime refuses the file.
        """
        file = read_onnx(path)
        try:
            return cls(file)
        except ImportError:
            raise
        except Exception as error:  # ONNX Runtime's exceptions have no common type
            raise FileError(f"{path}: ONNX Runtime cannot read it: {error!s:.300}") from error

    def __reduce__(self) -> tuple[type[OnnxNetwork], tuple[OnnxFile]]:
        """A session cannot be sent to another process, its file can."""
        return OnnxNetwork, (self._file,)

    @property
    def observation_shapes(self) -> dict[str, tuple[int, ...]]:
        """Shape of each entry of the observations in training."""
        return self._file.metadata.shapes()

    def weights(self) -> list[NDArray[np.float32]]:
        """Weights of the actor, in the order of torch."""
        return list(self._file.weights.values())

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
            for name, shape in self._inputs.items()
        }
        names = [one.name for one in self._session.get_outputs()]
        return dict(zip(names, self._session.run(names, inputs), strict=True))


def _session(content: bytes) -> Any:
    """A session of one thread, so that results do not depend on the number of processors."""
    onnxruntime = import_optional("onnxruntime", "onnx")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.use_deterministic_compute = True
    options.log_severity_level = ERRORS_ONLY
    return onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
