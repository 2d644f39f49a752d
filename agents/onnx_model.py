"""A network of an ONNX file, which ONNX Runtime computes without torch."""

from __future__ import annotations

import os
from typing import Any, ClassVar, Generic, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from coopmap_agents.model_files import ModelKind, OnnxFile, read_onnx
from coopmap_agents.onnx.session import OnnxSession
from coopmap_env.core.settings import Settings

MetadataT = TypeVar("MetadataT", bound=Settings)


class OnnxModel(Generic[MetadataT]):
    """A network of an ONNX file; a subclass says what it computes.

    Parameters
    ----------
    file : OnnxFile
        From `read_onnx`.

    Raises
    ------
    ImportError
        With the pip command, if ONNX Runtime is not installed.
    """

    KIND: ClassVar[ModelKind[Any]]
    """Of the files; set by each subclass."""

    def __init__(self, file: OnnxFile[MetadataT]) -> None:
        self._file = file
        self._session = OnnxSession(file.content, file.path)

    @classmethod
    def from_path(cls, path: str | os.PathLike[str]) -> Self:
        """The network of a file.

        Raises
        ------
        FileError
            As `read_onnx`, or if ONNX Runtime refuses the file.
        """
        return cls(read_onnx(path, cls.KIND))

    def __reduce__(self) -> tuple[type[Self], tuple[OnnxFile[MetadataT]]]:
        """A session cannot be sent to another process, its file can."""
        return type(self), (self._file,)

    def weights(self) -> list[NDArray[np.float32]]:
        """Weights of the network (of a policy, of its actor), in the order of torch."""
        return list(self._file.weights.values())
