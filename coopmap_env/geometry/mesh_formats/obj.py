"""Wavefront OBJ: no unit and no axes, so metres and z up; materials are not read."""

import numpy as np

from coopmap_env.geometry.mesh_formats.surface import Surface, check_faces, fan, floats


def read_obj(content: bytes) -> Surface:
    """Read vertices and faces; polygons are taken as convex."""
    content = content.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ")  # lines that go on
    points: list[bytes] = []
    faces: list[np.ndarray] = []
    for number, line in enumerate(content.splitlines(), 1):
        keyword, *words = line.partition(b"#")[0].split() or [b""]
        if keyword == b"v":
            if len(words) < 3:
                raise ValueError(f"line {number}: a vertex must have three coordinates")
            points += words[:3]
        elif keyword == b"f":
            faces.append(fan(_corners(words, len(points) // 3, number)))
    vertices = floats(points, len(points), "a vertex").reshape(-1, 3)
    triangles = np.concatenate([np.zeros((0, 3), np.int64), *faces])
    check_faces(triangles, len(vertices))
    return Surface(vertices, triangles)


def _corners(words: list[bytes], n_vertices: int, number: int) -> list[int]:
    """Vertices of a face, from 0: the file counts from 1, or backwards from the last one, -1."""
    try:
        indices = [int(word.partition(b"/")[0]) for word in words]
        if not all(-n_vertices <= index < 2**62 for index in indices):
            raise ValueError("a face names a vertex that does not exist")
        if 0 in indices:
            raise ValueError("vertices are counted from 1")
    except ValueError as error:
        raise ValueError(f"line {number}: {str(error)[:100]}") from error
    return [index - 1 if index > 0 else n_vertices + index for index in indices]
