"""STL, binary and ASCII: no unit and no axes, so metres and z up."""

import numpy as np

from coopmap_env.core.files import brief
from coopmap_env.geometry.mesh_formats.surface import Surface, floats

_HEADER_SIZE = 84
_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def read_stl(content: bytes) -> Surface:
    """Read either kind; the size decides which, as many binary files begin with "solid" too."""
    n_triangles, size = _stated_size(content)
    if len(content) != size and content.lstrip()[:5].lower() == b"solid" and b"\0" not in content:
        return _read_ascii(content)
    if len(content) < max(size, _HEADER_SIZE):
        raise ValueError(
            f"{n_triangles:,} triangles take {size:,} bytes, and there are {len(content):,}: "
            "the file is cut short or no STL"
        )
    rows = np.frombuffer(content, _TRIANGLE, n_triangles, _HEADER_SIZE)
    return _separate_triangles(rows["corners"].reshape(-1, 3).astype(np.float64))


def is_exact_binary_stl(content: bytes) -> bool:
    """Whether a file is exactly as long as a binary STL whose header it has."""
    return len(content) == _stated_size(content)[1]


def _stated_size(content: bytes) -> tuple[int, int]:
    """Number of triangles in the header of a binary STL, and the bytes of such a file."""
    n_triangles = int.from_bytes(content[_HEADER_SIZE - 4 : _HEADER_SIZE], "little")
    return n_triangles, _HEADER_SIZE + n_triangles * _TRIANGLE.itemsize


def _read_ascii(content: bytes) -> Surface:
    corners: list[list[bytes]] = []
    is_open, n_facets = False, 0
    for number, line in enumerate(content.splitlines(), 1):
        words = line.split()
        keyword = words[0].lower() if words else b""
        if keyword == b"vertex" and len(words) == 4:
            corners.append(words[1:])
        elif keyword == b"endfacet":
            n_facets += 1
            if len(corners) != 3 * n_facets:
                raise ValueError(f"line {number}: a facet must have three vertices")
        elif keyword in (b"solid", b"endsolid"):
            is_open = keyword == b"solid"
        elif keyword not in (b"", b"facet", b"outer", b"endloop"):
            raise ValueError(f"line {number}: expected a line of an ASCII STL, not {brief(line)}")
    if is_open or len(corners) != 3 * n_facets:
        raise ValueError("the last solid has no end: the file is cut short")
    words = [word for corner in corners for word in corner]
    return _separate_triangles(floats(words, len(words), "a vertex").reshape(-1, 3))


def _separate_triangles(vertices: np.ndarray) -> Surface:
    return Surface(vertices, np.arange(len(vertices)).reshape(-1, 3))
