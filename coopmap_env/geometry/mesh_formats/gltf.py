"""glTF 2.0 and its binary form GLB: metres and y up, turned here to z up.

Only triangles are read: no materials, pictures or animations. What would move vertices in a way
that is not done here (compression, skins, instancing) is refused by name.
"""

import base64
import binascii
import json
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.files import brief, read_bytes
from coopmap_env.core.limits import check_bytes
from coopmap_env.core.linear_algebra import product
from coopmap_env.geometry.mesh_formats.surface import (
    Surface,
    SurfaceBuilder,
    check_faces,
    fan,
    strip,
)
from coopmap_env.geometry.mesh_formats.transforms import Z_UP_FROM_Y_UP, quaternion_transform

_COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_HARMLESS = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_lights_", "MSFT_texture_")
_CHUNK_JSON, _CHUNK_BINARY = b"JSON", b"BIN\0"


def read_glb(content: bytes, folder: Path) -> Surface:
    """Read a GLB; buffers in other files must lie in `folder`."""
    length = int.from_bytes(content[8:12], "little")
    if content[:4] != b"glTF" or len(content) < max(length, 20):
        raise ValueError("it must begin with glTF and have as many bytes as it says: is it cut?")
    chunks: dict[bytes, bytes] = {}
    at = 12
    while at + 8 <= length:
        size, kind = int.from_bytes(content[at : at + 4], "little"), content[at + 4 : at + 8]
        if at + 8 + size > length:
            raise ValueError("a chunk is longer than the file")
        chunks.setdefault(kind, content[at + 8 : at + 8 + size])
        at += 8 + size
    return _read(chunks.get(_CHUNK_JSON, b""), folder, chunks.get(_CHUNK_BINARY))


def read_gltf(content: bytes, folder: Path) -> Surface:
    """Read a glTF; its buffers must lie in `folder`."""
    return _read(content, folder, None)


def _read(text: bytes, folder: Path, binary: bytes | None) -> Surface:
    header = json.loads(text.decode("utf-8-sig"))
    version = _item(header, "asset", {}).get("version", "")
    if not str(version).startswith("2."):
        raise ValueError(f"its asset version must be 2.0, not {brief(version)}")
    for name in header.get("extensionsRequired", []):
        if not str(name).startswith((*_HARMLESS, "KHR_mesh_quantization")):
            raise ValueError(f"the extension {brief(name)} cannot be read: export it without")
    document = _Document(header, folder, binary)
    builder = SurfaceBuilder()
    pending = [(node, np.eye(4)) for node in document.roots()]
    visited = set()
    while pending:
        number, T = pending.pop()
        if number in visited:
            raise ValueError(f"its nodes are no tree: node {number} is met twice")
        visited.add(number)
        builder.visit()
        node = document.entry("nodes", number)
        for name in ("skin", "weights"):
            if name in node:
                raise ValueError(f"node {number} has {name}, which cannot be read: apply it first")
        if "EXT_mesh_gpu_instancing" in node.get("extensions", {}):
            raise ValueError("the extension EXT_mesh_gpu_instancing cannot be read")
        T = product(T, _node_transform(node))
        if "mesh" in node:
            for surface in document.mesh(node["mesh"]):
                builder.add(surface, T)
        pending += [(child, T) for child in node.get("children", [])]
    vertices, faces = builder.surface()
    return Surface(product(vertices, Z_UP_FROM_Y_UP.T), faces)


def _item(mapping: Any, name: str, default: Any = None) -> Any:
    """An entry of a JSON object."""
    if not isinstance(mapping, dict):
        raise ValueError(f"expected an object with {name}, not {brief(mapping)}")
    return mapping.get(name, default)


def _node_transform(node: dict[str, Any]) -> NDArray[np.float64]:
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    T = quaternion_transform(np.array(node.get("rotation", [0, 0, 0, 1]), np.float64).reshape(4))
    T[:3, :3] *= np.array(node.get("scale", [1, 1, 1]), np.float64).reshape(3)
    T[:3, 3] = np.array(node.get("translation", [0, 0, 0]), np.float64).reshape(3)
    return T


class _Document:
    """The parsed JSON with its buffers."""

    def __init__(self, header: dict[str, Any], folder: Path, binary: bytes | None) -> None:
        self.header = header
        self._folder = folder
        self._binary = binary
        self._buffers: dict[int, bytes] = {}
        self._meshes: dict[int, list[Surface]] = {}

    def entry(self, kind: str, number: Any) -> dict[str, Any]:
        """One entry of a list of the document."""
        entries = self.header.get(kind, [])
        is_index = isinstance(number, int) and not isinstance(number, bool)
        if not is_index or not isinstance(entries, list) or not 0 <= number < len(entries):
            raise ValueError(f"there is no entry {brief(number)} in {kind}")
        if not isinstance(entries[number], dict):
            raise ValueError(f"{kind}[{number}] must be an object, not {brief(entries[number])}")
        return entries[number]

    def roots(self) -> list[int]:
        """Nodes of the scene, or without a scene all that are no node's child."""
        if self.header.get("scenes"):
            return self.entry("scenes", self.header.get("scene", 0)).get("nodes", [])
        nodes = range(len(self.header.get("nodes", [])))
        children = {
            child for node in nodes for child in self.entry("nodes", node).get("children", [])
        }
        return [node for node in nodes if node not in children]

    def mesh(self, number: int) -> list[Surface]:
        """The triangles of a mesh, one surface a primitive."""
        if number not in self._meshes:
            mesh = self.entry("meshes", number)
            if any(mesh.get("weights", [])):
                raise ValueError(f"mesh {number} has morph weights: apply them first")
            self._meshes[number] = [
                self._primitive(primitive)
                for primitive in mesh["primitives"]
                if primitive.get("mode", _TRIANGLES) in (_TRIANGLES, _STRIP, _FAN)
            ]
        return self._meshes[number]

    def _primitive(self, primitive: dict[str, Any]) -> Surface:
        vertices = self._accessor(primitive["attributes"]["POSITION"], 3).astype(np.float64)
        if "indices" in primitive:
            corners = self._accessor(primitive["indices"], 1).ravel().astype(np.int64)
        else:
            corners = np.arange(len(vertices))
        mode = primitive.get("mode", _TRIANGLES)
        if mode == _TRIANGLES:
            faces = corners.reshape(-1, 3)
        else:
            faces = strip(corners) if mode == _STRIP else fan(corners)
        check_faces(faces, len(vertices))
        return Surface(vertices, faces)

    def _accessor(self, number: int, width: int) -> NDArray[Any]:
        """Values (n, width)."""
        accessor = self.entry("accessors", number)
        if _WIDTHS.get(accessor["type"]) != width:
            raise ValueError(
                f"accessor {number} must have {width} numbers, not {brief(accessor['type'])}"
            )
        count = accessor["count"]
        check_bytes(count * width * 8, f"accessor {number}")
        kind = np.dtype(_COMPONENTS[accessor["componentType"]])
        if "bufferView" in accessor:
            offset = accessor.get("byteOffset", 0)
            values = self._view(accessor["bufferView"], offset, count, width, kind)
        elif "sparse" in accessor:
            values = np.zeros((count, width), kind)
        else:
            raise ValueError(f"accessor {number} has no data")
        if "sparse" in accessor:
            values = self._with_changes(values, accessor["sparse"], width, kind)
        if accessor.get("normalized", False) and kind.kind in "iu":
            return np.maximum(values / np.iinfo(kind).max, -1.0)
        return values

    def _with_changes(
        self, values: NDArray[Any], sparse: dict[str, Any], width: int, kind: np.dtype
    ) -> NDArray[Any]:
        where, new = sparse["indices"], sparse["values"]
        rows = self._view(
            where["bufferView"], where.get("byteOffset", 0), sparse["count"], 1,
            np.dtype(_COMPONENTS[where["componentType"]]),
        ).ravel()  # fmt: skip
        changed = values.copy()
        changed[rows] = self._view(
            new["bufferView"], new.get("byteOffset", 0), sparse["count"], width, kind
        )
        return changed

    def _view(
        self, number: int, offset: int, count: int, width: int, kind: np.dtype
    ) -> NDArray[Any]:
        """Rows (count, width) of a buffer view, `offset` bytes after its start."""
        view = self.entry("bufferViews", number)
        if "EXT_meshopt_compression" in view.get("extensions", {}):
            raise ValueError("the extension EXT_meshopt_compression cannot be read")
        start, size = view.get("byteOffset", 0), view["byteLength"]
        row_size = kind.itemsize * width
        stride = view.get("byteStride", row_size)
        numbers = (start, size, offset, count, stride)
        if not all(isinstance(n, int) and n >= 0 for n in numbers) or stride < row_size:
            raise ValueError(f"bufferViews[{number}] has a wrong size or offset")
        data = self._buffer(view["buffer"])[start : start + size]
        if count and offset + (count - 1) * stride + row_size > len(data):
            raise ValueError(f"bufferViews[{number}] is too short for {count} entries")
        if not count:
            return np.zeros((0, width), kind)
        return np.ndarray((count, width), kind, data, offset, (stride, kind.itemsize))

    def _buffer(self, number: int) -> bytes:
        if number not in self._buffers:
            buffer = self.entry("buffers", number)
            uri = buffer.get("uri")
            if uri is None and self._binary is not None and number == 0:
                data = self._binary
            elif isinstance(uri, str) and uri.startswith("data:"):
                data = _decode_data(uri)
            else:
                data = read_bytes(_path_inside(self._folder, uri))
            if len(data) < buffer["byteLength"]:
                raise ValueError(f"buffer {number} has {len(data)} bytes, fewer than it says")
            self._buffers[number] = data[: buffer["byteLength"]]
        return self._buffers[number]


def _decode_data(uri: str) -> bytes:
    head, _, text = uri.partition(",")
    if not head.endswith(";base64"):
        raise ValueError(f"expected base64 data, not {brief(head)}")
    try:
        return base64.b64decode(text, validate=True)
    except binascii.Error as error:
        raise ValueError(f"expected base64 data: {error}") from error


def _path_inside(folder: Path, uri: Any) -> Path:
    """Path of a buffer beside the file; any other place is refused."""
    path = Path(unquote(uri)) if isinstance(uri, str) else Path("..")
    if path.is_absolute() or ".." in path.parts or ":" in str(path):
        raise ValueError(f"a buffer must be a file in the folder of the mesh, not {brief(uri)}")
    return folder / path
