"""What every reader of a mesh format makes, and what several of them need."""

import io
import zipfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.limits import check_bytes
from coopmap_env.core.linear_algebra import product

MAX_PARTS = 20_000
"""Nodes of a scene that are visited, copies included: a few lines can name 2**40 of them."""
_PARSED_SIZE = 16
"""Bytes of memory that a byte of XML takes once it is parsed, about."""
_BYTES_PER_FACE = 200
"""Of a face with its vertices, here and where the mesh is used."""


class Surface(NamedTuple):
    """Triangles of one mesh."""

    vertices: NDArray[np.float64]
    """Shape (v, 3), metres, z up."""
    faces: NDArray[np.int64]
    """Shape (f, 3): vertices of each triangle."""


@dataclass
class SurfaceBuilder:
    """Placed copies of meshes, joined; their number and their triangles are bounded."""

    vertices: list[NDArray[np.float64]] = field(default_factory=list)
    faces: list[NDArray[np.int64]] = field(default_factory=list)
    n_vertices: int = 0
    n_faces: int = 0
    n_parts: int = 0

    def visit(self) -> None:
        """Count a node of a scene; ValueError if there are more than `MAX_PARTS`."""
        self.n_parts += 1
        if self.n_parts > MAX_PARTS:
            raise ValueError(f"its scene has more than {MAX_PARTS:,} nodes, copies included")

    def add(self, surface: Surface, T: NDArray[np.float64]) -> None:
        """Add a copy placed by T (4, 4).

        Raises
        ------
        ValueError
            If the copies are more than the limit on bytes allows, or T is not finite.
        """
        if not np.isfinite(T).all():
            raise ValueError(f"a transform is not finite: {T[~np.isfinite(T)][0]}")
        self.n_faces += len(surface.faces)
        check_bytes(self.n_faces * _BYTES_PER_FACE, "the mesh with all its copies")
        check_faces(surface.faces, len(surface.vertices))
        self.vertices.append(product(surface.vertices, T[:3, :3].T) + T[:3, 3])
        mirrored = np.linalg.det(T[:3, :3]) < 0.0
        self.faces.append(surface.faces[:, :: -1 if mirrored else 1] + self.n_vertices)
        self.n_vertices += len(surface.vertices)

    def surface(self) -> Surface:
        """All copies as one."""
        return Surface(
            np.concatenate([np.zeros((0, 3)), *self.vertices]),
            np.concatenate([np.zeros((0, 3), np.int64), *self.faces]),
        )


def check_faces(faces: NDArray[np.int64], n_vertices: int) -> None:
    """Raise ValueError unless all faces name vertices that exist."""
    if len(faces) and not 0 <= faces.min() <= faces.max() < n_vertices:
        wrong = faces.min() if faces.min() < 0 else faces.max()
        raise ValueError(f"a face names vertex {wrong} (from 0), and there are {n_vertices}")


def floats(words: Iterable[str | bytes], n: int, what: str) -> NDArray[np.float64]:
    """`n` numbers.

    Raises
    ------
    ValueError
        With `what`, if one is no number or there are more or fewer.
    """
    return _numbers(words, n, what, float)


def integers(words: Iterable[str | bytes], n: int, what: str) -> NDArray[np.int64]:
    """`n` integers that fit in 64 bits; see `floats`."""
    return _numbers(words, n, what, int)


def _numbers(
    words: Iterable[str | bytes], n: int, what: str, number: Callable[[str | bytes], float]
) -> NDArray:
    words = list(words)
    if len(words) != n:
        raise ValueError(f"{what}: expected {n} numbers, not {len(words)}")
    try:
        return np.array([number(word) for word in words], np.float64 if number is float else int)
    except (ValueError, OverflowError) as error:
        raise ValueError(f"{what}: {str(error)[:100]}") from error


def fan(corners: ArrayLike) -> NDArray[np.int64]:
    """Triangles (n - 2, 3) of a convex polygon (n,)."""
    corners = np.asarray(corners, dtype=np.int64)
    if len(corners) < 3:
        return np.zeros((0, 3), np.int64)
    first = np.full(len(corners) - 2, corners[0])
    return np.stack([first, corners[1:-1], corners[2:]], axis=1)


def strip(corners: ArrayLike) -> NDArray[np.int64]:
    """Triangles (n - 2, 3) of a strip (n,): every second one is turned over."""
    corners = np.asarray(corners, dtype=np.int64)
    if len(corners) < 3:
        return np.zeros((0, 3), np.int64)
    triangles = np.stack([corners[:-2], corners[1:-1], corners[2:]], axis=1)
    triangles[1::2] = triangles[1::2, ::-1]
    return triangles


def polygons_to_triangles(
    counts: NDArray[np.int64], corners: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Triangles of convex polygons of `counts` corners (n,) that follow each other in `corners`."""
    if len(counts) and (counts == counts[0]).all() and counts[0] >= 3:
        polygons = corners.reshape(len(counts), counts[0])
        first = np.repeat(polygons[:, :1], counts[0] - 2, axis=1)
        return np.stack([first, polygons[:, 1:-1], polygons[:, 2:]], axis=2).reshape(-1, 3)
    ends = np.cumsum(counts)
    triangles = [fan(corners[end - n : end]) for n, end in zip(counts, ends, strict=True)]
    return np.concatenate([np.zeros((0, 3), np.int64), *triangles])


def open_archive(content: bytes) -> zipfile.ZipFile:
    """A zip archive of XML that fits into the limit on bytes when it is unpacked and parsed.

    Raises
    ------
    ValueError, zipfile.BadZipFile
        If it does not, or is none.
    """
    archive = zipfile.ZipFile(io.BytesIO(content))
    size = sum(member.file_size for member in archive.infolist())
    check_bytes(size * _PARSED_SIZE, "the unpacked archive as parsed XML")
    return archive
