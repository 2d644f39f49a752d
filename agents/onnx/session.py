"""The outputs of an ONNX file's graph, by ONNX Runtime."""

from __future__ import annotations

import os
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.extras import import_optional
from coopmap_env.core.files import FileError

ERRORS_ONLY = 3
"""Of what ONNX Runtime logs to the standard error."""


class OnnxSession:
    """A session of one thread, so that results do not depend on the number of processors.

    Parameters
    ----------
    content : bytes
        Of the file.
    path : path
        Of the file, for messages.

    Raises
    ------
    FileError
        If ONNX Runtime refuses the file.
    ImportError
        With the pip command, if ONNX Runtime is not installed.
    """

    def __init__(self, content: bytes, path: str | os.PathLike[str]) -> None:
        onnxruntime = import_optional("onnxruntime", "onnx")
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.use_deterministic_compute = True
        options.log_severity_level = ERRORS_ONLY
        providers = ["CPUExecutionProvider"]
        try:
            self._session = onnxruntime.InferenceSession(content, options, providers=providers)
        except Exception as error:  # ONNX Runtime's exceptions have no common type
            raise FileError(f"{path}: ONNX Runtime cannot read it: {error!s:.300}") from error
        self.inputs = {one.name: tuple(one.shape) for one in self._session.get_inputs()}
        """Shape of each input; free dimensions have names."""
        self._outputs = [one.name for one in self._session.get_outputs()]

    def outputs(self, inputs: Mapping[str, NDArray[np.float32]]) -> dict[str, NDArray[np.float32]]:
        """Outputs of the graph by name."""
        values = self._session.run(self._outputs, dict(inputs))
        return dict(zip(self._outputs, values, strict=True))
