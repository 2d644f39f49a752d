"""Networks as files: weights by name and JSON metadata, in two formats; no code inside.

================  ==============================================================================
suffix            content
================  ==============================================================================
``.safetensors``  the weights: what training continues from, and what torch computes with
``.onnx``         the weights and the operations of the network, for ONNX Runtime alone
================  ==============================================================================

The metadata say how to make the network, and how it was trained. Files of others can be read:
nothing in them is executed, they name no other file, and no network is made before its size is
compared with the weights in the file.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from math import prod
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from coopmap_agents.onnx.encoding import decode_tensors, encode_model, split_model
from coopmap_agents.onnx.graph import Graph
from coopmap_agents.weights import check_shapes, check_values
from coopmap_env.core.extras import import_optional
from coopmap_env.core.files import FileError, brief, read_bytes, write_atomically
from coopmap_env.core.limits import check_bytes
from coopmap_env.core.settings import Settings, settings_from_dict
from coopmap_env.core.version import __version__

BYTES_PER_WEIGHT = 4

MetadataT = TypeVar("MetadataT", bound=Settings)
T = TypeVar("T")
Weights = dict[str, NDArray[np.float32]]


@dataclass(frozen=True)
class ModelKind(Generic[MetadataT]):
    """What the files of one kind of network have in common."""

    name: str
    """Of such a network, in messages."""
    metadata_type: type[MetadataT]
    """Has the fields ``format`` and ``version``."""
    metadata_key: str
    """Key of the JSON text in the file."""
    format: int
    """The one that is read; files of others are refused."""
    graph: Callable[[MetadataT], Graph]
    """Raises ValueError if there is no network of these metadata."""
    command: str
    """The command that trains such networks."""
    function: str
    """The function that writes them."""


@dataclass(frozen=True)
class OnnxFile(Generic[MetadataT]):
    """What an ONNX file holds, checked."""

    path: str
    metadata: MetadataT
    weights: Weights
    content: bytes
    """All of the file."""


def write_model(
    path: str | os.PathLike[str],
    kind: ModelKind[MetadataT],
    metadata: MetadataT,
    weights: Mapping[str, NDArray[np.float32]],
) -> None:
    """Write a network to a file, atomically.

    Raises
    ------
    ValueError
        If the path has another suffix, or the metadata have no graph of these weights.
    ImportError
        With the pip command, if safetensors is needed and not installed.
    """
    suffix, text = Path(path).suffix, json.dumps(asdict(metadata))
    if suffix == ".safetensors":
        save = import_optional("safetensors.numpy", "rl").save
        content: bytes = save(dict(weights), {kind.metadata_key: text})
    elif suffix == ".onnx":
        graph = kind.graph(metadata)
        check_shapes(weights, graph.weights)
        content = encode_model(graph, weights, kind.metadata_key, text)
    else:
        raise ValueError(
            f"the suffix of the file of a {kind.name} must be .safetensors or .onnx, got {path}"
        )
    write_atomically(Path(path), content)


def read_model(
    path: str | os.PathLike[str], kind: ModelKind[MetadataT]
) -> tuple[MetadataT, Weights]:
    """Metadata and weights of a file; those of safetensors are not checked yet.

    Raises
    ------
    FileError
        If it is no file of this kind, or one of another format; for ONNX as `read_onnx`.
    ImportError
        With the pip command, if safetensors is needed and not installed.
    """
    if Path(path).suffix == ".onnx":
        file = read_onnx(path, kind)
        return file.metadata, file.weights
    import_optional("safetensors.numpy", "rl")
    metadata, _, weights = _read_with_metadata(path, kind, _split_safetensors)
    return metadata, weights


def read_onnx(path: str | os.PathLike[str], kind: ModelKind[MetadataT]) -> OnnxFile[MetadataT]:
    """Read an ONNX file.

    Raises
    ------
    FileError
        If it is no file of this kind, one of another format, its weights do not belong to its
        metadata or are not finite, or its graph is another than that of its metadata.
    """
    metadata, text, (content, body) = _read_with_metadata(path, kind, _split_onnx)
    try:
        graph = kind.graph(metadata)
        weights = _read_weights(graph, body)
        if encode_model(graph, weights, kind.metadata_key, text) != content:
            raise ValueError(
                f"its graph is not the one of its metadata: write it by `{kind.function}`"
            )
    except Exception as error:  # a broken field may be of any type
        raise FileError(f"{path}: {error!s:.300}") from error
    return OnnxFile(str(path), metadata, weights, content)


def _read_with_metadata(
    path: str | os.PathLike[str],
    kind: ModelKind[MetadataT],
    split: Callable[[bytes, str], tuple[str, T]],
) -> tuple[MetadataT, str, T]:
    """Metadata of a file, their JSON text, and the rest of the content."""
    content = read_bytes(path)
    try:
        text, rest = split(content, kind.metadata_key)
        values = json.loads(text)
        if values["format"] == kind.format:
            return settings_from_dict(values, kind.metadata_type), text, rest
        version = f"{values.get('version')!s:.40}"
    except Exception as error:  # `split` raises many types of exceptions for a broken file
        raise FileError(
            f"{path} was not written by `{kind.command}` or `{kind.function}`: {_reason(error)}"
        ) from error
    raise FileError(
        f"{path} was written by coopmap {version} in format {brief(values['format'])}, "
        f"this is {__version__} and reads format {kind.format}: train the {kind.name} again, "
        "or install the version that wrote it"
    )


def _reason(error: Exception) -> str:
    return f"missing or unknown {error}" if isinstance(error, KeyError) else f"{error!s:.300}"


def _split_safetensors(content: bytes, metadata_key: str) -> tuple[str, Weights]:
    weights: Weights = import_optional("safetensors.numpy", "rl").load(content)
    header_length = int.from_bytes(content[:8], "little")
    header: Any = json.loads(content[8 : 8 + header_length])
    return header["__metadata__"][metadata_key], weights


def _split_onnx(content: bytes, metadata_key: str) -> tuple[str, tuple[bytes, memoryview]]:
    text, body = split_model(content, metadata_key)
    return text, (content, body)


def _read_weights(graph: Graph, body: memoryview) -> Weights:
    check_bytes(BYTES_PER_WEIGHT * sum(map(prod, graph.weights.values())), "the network")
    n_fields = 1 + sum(
        map(len, (graph.nodes, graph.weights, graph.constants, graph.inputs, graph.outputs))
    )
    tensors = decode_tensors(body, n_fields)
    weights = {name: values for name, values in tensors.items() if name not in graph.constants}
    check_shapes(weights, graph.weights)
    check_values(weights)
    return weights
