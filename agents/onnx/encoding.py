"""The encoding of ONNX files, as far as our graphs need it: messages of `onnx.proto`.

A message is a sequence of fields, each a number and a value. Equal models have equal bytes here,
which protocol buffers do not promise in general. Numbers are those of the specification,
https://github.com/onnx/onnx/blob/main/onnx/onnx.proto.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_agents.onnx.graph import FLOAT, Graph, Node, Shape

IR_VERSION, OPERATIONS_VERSION = 8, 18
"""Versions of the format and of its operations; ONNX Runtime reads them since 1.14 (2023)."""
PRODUCER = "coopmap"
INT64 = 7
"""Number of the type of tensors, beside `FLOAT`."""
INT_ATTRIBUTE, INTS_ATTRIBUTE = 2, 7
"""Numbers of the types of attributes."""
VARINT, BYTES = 0, 2
"""Types of fields: an integer in groups of 7 bits, and bytes after their number."""
MAX_VARINT_BYTES = 10
MAX_FIELDS = 16
"""Fields of a model, of its metadata and of a tensor; our files have fewer."""

Message = Sequence[tuple[int, Any]]
"""Fields, whose values are integers, texts, bytes or messages."""


def encode_model(
    graph: Graph, weights: Mapping[str, NDArray[np.float32]], metadata_key: str, metadata: str
) -> bytes:
    """Content of the file of a graph with weights of its names and shapes, and with metadata."""
    tensors = {name: weights[name] for name in graph.weights} | graph.constants
    body = [
        *((1, _node(node)) for node in graph.nodes),
        (2, PRODUCER),
        *((5, _tensor(name, values)) for name, values in tensors.items()),
        *((11, _value_info(name, shape)) for name, shape in graph.inputs.items()),
        *((12, _value_info(name, shape)) for name, shape in graph.outputs.items()),
    ]
    return _encode(
        [
            (1, IR_VERSION),
            (2, PRODUCER),
            (7, body),
            (8, [(1, ""), (2, OPERATIONS_VERSION)]),
            (14, [(1, metadata_key), (2, metadata)]),
        ]
    )


def split_model(content: bytes, metadata_key: str) -> tuple[str, memoryview]:
    """Metadata of a file under their key, and its graph, which is not looked at yet.

    Raises
    ------
    ValueError, LookupError
        If the content has not the form of `encode_model`.
    """
    model = _decode(memoryview(content), MAX_FIELDS)
    entry = _decode(model[14], MAX_FIELDS)
    if bytes(entry[1]) != metadata_key.encode():
        raise ValueError(f"its metadata have no entry {metadata_key}")
    return bytes(entry[2]).decode(), model[7]


def decode_tensors(graph: memoryview, max_fields: int) -> dict[str, NDArray[Any]]:
    """Constants and weights of a graph by name, among as many fields as it may have.

    Raises
    ------
    ValueError, LookupError
        If one is not of the types of `encode_model`.
    """
    fields = islice(_fields(graph), max_fields)
    return dict(_decode_tensor(value) for number, value in fields if number == 5)


def _node(node: Node) -> Message:
    return [
        *((1, name) for name in node.inputs),
        (2, node.output),
        (4, node.operation),
        *((5, _attribute(name, value)) for name, value in node.attributes.items()),
    ]


def _attribute(name: str, value: int | tuple[int, ...]) -> Message:
    if isinstance(value, int):
        return [(1, name), (3, value), (20, INT_ATTRIBUTE)]
    return [(1, name), *((8, one) for one in value), (20, INTS_ATTRIBUTE)]


def _tensor(name: str, values: NDArray[Any]) -> Message:
    kind = INT64 if values.dtype == np.int64 else FLOAT
    content = values.astype(values.dtype.newbyteorder("<")).tobytes()
    return [*((1, size) for size in values.shape), (2, kind), (8, name), (9, content)]


def _value_info(name: str, shape: Shape) -> Message:
    """Name, type and shape of an input or output; free dimensions have names."""
    dimensions = [(1, [(2 if isinstance(size, str) else 1, size)]) for size in shape]
    return [(1, name), (2, [(1, [(1, FLOAT), (2, dimensions)])])]


def _decode_tensor(message: memoryview) -> tuple[str, NDArray[Any]]:
    fields = list(islice(_fields(message), MAX_FIELDS))
    last = dict(fields)
    name = bytes(last[8]).decode()
    if last[2] not in (FLOAT, INT64):
        raise ValueError(f"the weights {name:.80} must be of type float32, not of number {last[2]}")
    values = np.frombuffer(last[9], "<f4" if last[2] == FLOAT else "<i8")
    return name, values.reshape([value for number, value in fields if number == 1])


def _encode(message: Message) -> bytes:
    return b"".join(_encode_field(number, value) for number, value in message)


def _encode_field(number: int, value: int | str | bytes | Message) -> bytes:
    if isinstance(value, int):
        return _varint(number << 3 | VARINT) + _varint(value)
    if isinstance(value, str):
        value = value.encode()
    content = value if isinstance(value, bytes) else _encode(value)
    return _varint(number << 3 | BYTES) + _varint(len(content)) + content


def _varint(value: int) -> bytes:
    groups = bytearray()
    while value > 0x7F:
        groups.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*groups, value])


def _decode(message: memoryview, max_fields: int) -> dict[int, Any]:
    """Fields by number, of repeated ones the last."""
    return dict(islice(_fields(message), max_fields))


def _fields(message: memoryview) -> Iterator[tuple[int, Any]]:
    """Number and value of each field: an integer, or bytes."""
    at = 0
    while at < len(message):
        key, at = _read_varint(message, at)
        value, at = _read_varint(message, at)
        if key & 7 == BYTES:
            start, at = at, at + value
            if at > len(message):
                raise ValueError(f"a field of {value} bytes ends after the file")
            yield key >> 3, message[start:at]
        elif key & 7 == VARINT:
            yield key >> 3, value
        else:
            raise ValueError(f"a field of the unknown type {key & 7}")


def _read_varint(message: memoryview, at: int) -> tuple[int, int]:
    """An integer, and where it ends."""
    value = 0
    for k, group in enumerate(message[at : at + MAX_VARINT_BYTES]):
        value |= (group & 0x7F) << 7 * k
        if group < 0x80:
            return value, at + k + 1
    raise ValueError("it ends within an integer, or has one that is too long")
