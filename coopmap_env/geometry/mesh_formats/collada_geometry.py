"""The triangles of one geometry of a COLLADA document."""

from collections.abc import Callable
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.files import brief
from coopmap_env.geometry.mesh_formats.surface import (
    Surface,
    SurfaceBuilder,
    check_faces,
    fan,
    floats,
    integers,
    polygons_to_triangles,
    strip,
)


def read_geometry(geometry: Element) -> Surface:
    """Read the triangles, polygons, strips and fans of a geometry; polygons are taken as convex.

    Sources are those of this geometry: several writers give each geometry the same ids.
    """
    builder = SurfaceBuilder()
    for primitive in geometry.iterfind("{*}mesh/*"):
        read = _PRIMITIVES.get(primitive.tag.rpartition("}")[2])
        if read is None or primitive.find("{*}p") is None:
            continue
        source, offset, stride = _vertex_input(primitive)
        vertices = _positions(geometry, source)
        faces = read(primitive, offset, stride)
        check_faces(faces, len(vertices))
        builder.add(Surface(vertices, faces), np.eye(4))
    return builder.surface()


def _vertex_input(primitive: Element) -> tuple[str, int, int]:
    """The reference to the vertices, and their place among how many indices of a corner."""
    inputs = primitive.findall("{*}input")
    offsets = [int(integers([entry.get("offset", "0")], 1, "an offset")[0]) for entry in inputs]
    if min(offsets, default=0) < 0 or max(offsets, default=0) > 1000:
        raise ValueError(f"offsets of inputs must be small numbers, not {offsets}")
    for entry, offset in zip(inputs, offsets, strict=True):
        if entry.get("semantic") == "VERTEX":
            return entry.get("source", ""), offset, max(offsets) + 1
    raise ValueError(f"{primitive.tag[-60:]!r} has no input of vertices")


def _named(geometry: Element, tag: str, reference: str) -> Element:
    """The element of a geometry that a reference names."""
    found = [
        entry
        for entry in geometry.iterfind(f"{{*}}mesh/{{*}}{tag}")
        if f"#{entry.get('id')}" == reference
    ]
    if len(found) != 1:
        raise ValueError(f"a geometry has {len(found)} elements {tag} named {brief(reference)}")
    return found[0]


def _positions(geometry: Element, reference: str) -> NDArray[np.float64]:
    """Coordinates (v, 3) of the vertices that a reference names."""
    for entry in _named(geometry, "vertices", reference).iterfind("{*}input"):
        if entry.get("semantic") == "POSITION":
            source = _named(geometry, "source", entry.get("source", ""))
            break
    else:
        raise ValueError("its vertices have no input of positions")
    array = source.find("{*}float_array")
    if array is None:
        raise ValueError(f"the source {brief(source.get('id'))} has no float_array")
    words = (array.text or "").split()
    accessor = source.find("{*}technique_common/{*}accessor")
    stride, offset, count = 3, 0, len(words) // 3
    if accessor is not None:
        stride, offset, count = integers(
            (accessor.get("stride", "1"), accessor.get("offset", "0"), accessor.get("count", "")),
            3, "an accessor",
        )  # fmt: skip
    if stride < 3 or offset < 0 or not 0 <= count <= (len(words) - offset) // stride:
        raise ValueError(
            f"the source {brief(source.get('id'))} has {len(words)} numbers, which are not {count} "
            f"rows of {stride}"
        )
    rows = words[offset : offset + count * stride]
    return floats(rows, len(rows), "a source").reshape(count, stride)[:, :3]


def _corners(text: str | None, offset: int, stride: int) -> NDArray[np.int64]:
    """The vertices (n,) that a list of indices names."""
    words = (text or "").split()
    if len(words) % stride:
        raise ValueError(f"{len(words)} indices are no multiple of {stride}")
    return integers(words, len(words), "an index")[offset::stride]


def _read_triangles(primitive: Element, offset: int, stride: int) -> NDArray[np.int64]:
    corners = [_corners(p.text, offset, stride) for p in primitive.iterfind("{*}p")]
    return np.concatenate(corners).reshape(-1, 3)


def _read_polylist(primitive: Element, offset: int, stride: int) -> NDArray[np.int64]:
    words = (primitive.findtext("{*}vcount") or "").split()
    counts = integers(words, len(words), "vcount")
    corners = _corners(primitive.findtext("{*}p"), offset, stride)
    if (counts < 0).any() or counts.sum() != len(corners):
        raise ValueError(f"vcount names {counts.sum()} corners, and there are {len(corners)}")
    return polygons_to_triangles(counts, corners)


def _read_polygons(primitive: Element, offset: int, stride: int) -> NDArray[np.int64]:
    if primitive.find("{*}ph") is not None:
        raise ValueError("polygons with holes cannot be read: triangulate them first")
    return _read_each(primitive, offset, stride, fan)


def _read_fans(primitive: Element, offset: int, stride: int) -> NDArray[np.int64]:
    return _read_each(primitive, offset, stride, fan)


def _read_strips(primitive: Element, offset: int, stride: int) -> NDArray[np.int64]:
    return _read_each(primitive, offset, stride, strip)


def _read_each(
    primitive: Element,
    offset: int,
    stride: int,
    triangles: Callable[[NDArray[np.int64]], NDArray[np.int64]],
) -> NDArray[np.int64]:
    parts = [triangles(_corners(p.text, offset, stride)) for p in primitive.iterfind("{*}p")]
    return np.concatenate(parts)


_PRIMITIVES: dict[str, Callable[[Element, int, int], NDArray[np.int64]]] = {
    "triangles": _read_triangles,
    "polylist": _read_polylist,
    "polygons": _read_polygons,
    "trifans": _read_fans,
    "tristrips": _read_strips,
}
