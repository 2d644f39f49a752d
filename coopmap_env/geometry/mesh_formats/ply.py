"""PLY, ASCII and binary of either byte order: no unit and no axes, so metres and z up."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.files import brief
from coopmap_env.core.limits import check_bytes
from coopmap_env.geometry.mesh_formats.ply_header import PLY_TYPES, split_header
from coopmap_env.geometry.mesh_formats.surface import (
    Surface,
    check_faces,
    floats,
    integers,
    polygons_to_triangles,
    strip,
)

_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_CORNERS = ("vertex_indices", "vertex_index")


@dataclass
class _Element:
    name: str
    length: int
    properties: list[tuple[str, np.dtype, np.dtype | None]] = field(default_factory=list)
    """Name, type, and for lists the type of their length."""

    @property
    def has_lists(self) -> bool:
        return any(length is not None for _, _, length in self.properties)


def read_ply(content: bytes) -> Surface:
    """Read vertices and the polygons of `face`, taken as convex, or the strips of `tristrips`."""
    order, elements, body = _read_header(content)
    rows = _AsciiRows(body) if order == "ascii" else _BinaryRows(body)
    values: dict[str, Any] = {}
    for element in elements:
        values[element.name] = rows.read(element)
    vertex = values.get("vertex", {})
    if not all(axis in vertex for axis in "xyz"):
        raise ValueError("it must have an element vertex with x, y and z")
    vertices = np.stack([np.asarray(vertex[axis], np.float64) for axis in "xyz"], axis=1)
    faces = np.zeros((0, 3), np.int64)
    for name in _CORNERS:
        if name in values.get("face", {}):
            faces = polygons_to_triangles(*values["face"][name])
            break
        if name in values.get("tristrips", {}):
            faces = _strips(values["tristrips"][name][1])
            break
    check_faces(faces, len(vertices))
    return Surface(vertices, faces)


def _strips(corners: NDArray[np.int64]) -> NDArray[np.int64]:
    """Triangles of strips that -1 divides."""
    strips = np.split(corners, np.flatnonzero(corners == -1))
    return np.concatenate([strip(corners[corners != -1]) for corners in strips])


def _read_header(content: bytes) -> tuple[str, list[_Element], bytes]:
    """The format, the elements and what follows the header."""
    lines, body = split_header(content)
    order = ""
    elements: list[_Element] = []
    for line in lines[1:]:
        match line.split():
            case ["format", order, *_]:
                pass
            case ["element", name, length] if length.isdecimal() and len(length) < 19:
                elements.append(_Element(name, int(length)))
            case ["property", "list", length, kind, name] if elements:
                elements[-1].properties.append((name, _dtype(kind, order), _dtype(length, order)))
            case ["property", kind, name] if elements:
                elements[-1].properties.append((name, _dtype(kind, order), None))
            case [] | ["comment" | "obj_info", *_]:
                pass
            case _:
                raise ValueError(f"expected a line of a header, not {brief(line)}")
    if order not in _ORDERS:
        raise ValueError(f"its format must be one of {', '.join(_ORDERS)}, not {brief(order)}")
    for element in elements:
        check_bytes(element.length * len(element.properties) * 8, f"the element {element.name}")
    return order, elements, body


def _dtype(name: str, order: str) -> np.dtype:
    if name not in PLY_TYPES:
        raise ValueError(f"expected one of the types {', '.join(PLY_TYPES)}, not {brief(name)}")
    return np.dtype(_ORDERS.get(order, "") + PLY_TYPES[name])


class _AsciiRows:
    """Reads elements of words, one after the other."""

    def __init__(self, body: bytes) -> None:
        self._words = body.split()
        self._at = 0

    def read(self, element: _Element) -> dict[str, Any]:
        """Values (n,) of each property; of a list its lengths (n,) and all entries."""
        if not element.has_lists:
            width = len(element.properties)
            rows = floats(self._take(width * element.length), width * element.length, element.name)
            names = [name for name, _, _ in element.properties]
            return dict(zip(names, rows.reshape(element.length, width).T, strict=True))
        columns: dict[str, Any] = {name: ([], []) for name, _, _ in element.properties}
        for _ in range(element.length):
            for name, _, length in element.properties:
                n = 1
                if length is not None:
                    n = int(integers(self._take(1), 1, element.name)[0])
                    columns[name][0].append(n)
                columns[name][1].extend(self._take(n))
        return {
            name: (
                np.array(columns[name][0], np.int64),
                integers(columns[name][1], len(columns[name][1]), element.name),
            )
            for name, kind, length in element.properties
            if length is not None and kind.kind in "iu"
        }

    def _take(self, n: int) -> list[bytes]:
        words = self._words[self._at : self._at + n]
        if n < 0 or len(words) < n:
            raise ValueError("it has fewer numbers than its header says: the file is cut short")
        self._at += n
        return words


class _BinaryRows:
    """Reads elements of bytes, one after the other."""

    def __init__(self, body: bytes) -> None:
        self._body = body
        self._at = 0

    def read(self, element: _Element) -> dict[str, Any]:
        """As `_AsciiRows.read`."""
        if not element.properties:
            return {}
        if not element.has_lists:
            row = np.dtype([(name, kind) for name, kind, _ in element.properties])
            rows = self._take(row, element.length)
            return {name: rows[name] for name, _, _ in element.properties}
        return self._read_equal_lists(element) or self._read_lists(element)

    def _read_equal_lists(self, element: _Element) -> dict[str, Any]:
        """The lists of an element, at once, if each has the same length in all rows."""
        start = self._at
        lengths = {name: int(values[0]) for name, values in self._one_row(element).items()}
        self._at = start
        fields: list[Any] = []
        for name, kind, length in element.properties:
            if length is not None:
                fields += [(f"{name} length", length), (name, kind, (lengths[name],))]
            else:
                fields.append((name, kind))
        row = np.dtype(fields)
        if start + row.itemsize * element.length > len(self._body):
            return {}
        rows = self._take(row, element.length)
        if any((rows[f"{name} length"] != n).any() for name, n in lengths.items()):
            self._at = start
            return {}
        return {
            name: (np.full(element.length, n), rows[name].astype(np.int64).ravel())
            for name, n in lengths.items()
        }

    def _read_lists(self, element: _Element) -> dict[str, Any]:
        rows = [self._one_row(element) for _ in range(element.length)]
        return {
            name: (
                np.array([len(row[name]) for row in rows]),
                np.concatenate([row[name] for row in rows]).astype(np.int64),
            )
            for name in (rows[0] if rows else {})
        }

    def _one_row(self, element: _Element) -> dict[str, NDArray[Any]]:
        """The lists of the next row."""
        lists = {}
        for name, kind, length in element.properties:
            n = 1 if length is None else int(self._take(length, 1)[0])
            values = self._take(kind, n)
            if length is not None:
                lists[name] = values
        return lists

    def _take(self, kind: np.dtype, n: int) -> NDArray[Any]:
        end = self._at + kind.itemsize * n
        if n < 0 or end > len(self._body):
            raise ValueError("it has fewer bytes than its header says: the file is cut short")
        values = np.frombuffer(self._body, kind, n, self._at) if n else np.zeros(0, kind)
        self._at = end
        return values
