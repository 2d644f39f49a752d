"""Policies as ONNX files: the graph, weights by name, and JSON metadata.

Files of others can be read: see `coopmap_agents.pretrained.onnx`.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from math import prod

import numpy as np
from numpy.typing import NDArray

from coopmap_agents.pretrained.metadata import PolicyMetadata, read_with_metadata
from coopmap_agents.pretrained.onnx.encoding import decode_tensors, encode_model, split_model
from coopmap_agents.pretrained.onnx.graph import Graph, policy_graph
from coopmap_agents.pretrained.weights import check_shapes, check_values
from coopmap_env.core.files import FileError
from coopmap_env.core.limits import check_bytes

BYTES_PER_WEIGHT = 4

Weights = dict[str, NDArray[np.float32]]


@dataclass(frozen=True)
class OnnxFile:
    """What a file holds, checked."""

    metadata: PolicyMetadata
    weights: Weights
    content: bytes
    """All of the file."""


def onnx_content(metadata: PolicyMetadata, weights: Mapping[str, NDArray[np.float32]]) -> bytes:
    """Content of the ONNX file of a policy.

    Parameters
    ----------
    metadata : PolicyMetadata
    weights : mapping
        The actor's, by name.

    Raises
    ------
    ValueError
        If the weights do not belong to the metadata.
    """
    graph = policy_graph(metadata)
    check_shapes(weights, graph.weights)
    return encode_model(graph, weights, json.dumps(asdict(metadata)))


def read_onnx(path: str | os.PathLike[str]) -> OnnxFile:
    """Read an ONNX file of `save_policy`.

    Raises
    ------
    FileError
        If it is not a policy's file, one of another format, its weights do not belong to its
        metadata or are not finite, or its graph is another than that of its metadata.
    """
    metadata, text, (content, body) = read_with_metadata(path, _split)
    try:
        graph = policy_graph(metadata)
        weights = _read_weights(graph, body)
        if encode_model(graph, weights, text) != content:
            raise ValueError("its graph is not the one of its metadata: write it by `save_policy`")
    except Exception as error:  # a broken field may be of any type
        raise FileError(f"{path}: {error!s:.300}") from error
    return OnnxFile(metadata, weights, content)


def _split(content: bytes) -> tuple[str, tuple[bytes, memoryview]]:
    text, body = split_model(content)
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
