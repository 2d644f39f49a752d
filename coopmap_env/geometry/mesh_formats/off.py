"""OFF: no unit and no axes, so metres and z up."""

import re

import numpy as np

from coopmap_env.geometry.mesh_formats.surface import Surface, check_faces, fan, floats, integers

_KEYWORD = re.compile(rb"(ST)?C?N?OFF$")


def read_off(content: bytes) -> Surface:
    """Read an ASCII OFF, with colours and normals or without; polygons are taken as convex."""
    lines = [line.partition(b"#")[0].split() for line in content.splitlines()]
    lines = [words for words in lines if words]
    if not lines or not _KEYWORD.match(lines[0][0]):
        raise ValueError("the first word must be OFF")
    _, *counts = lines.pop(0)
    if not counts and lines:
        counts = lines.pop(0)
    n_vertices, n_faces = integers(counts[:2], 2, "the numbers of vertices and faces")
    if n_vertices < 0 or n_faces < 0 or len(lines) < n_vertices + n_faces:
        raise ValueError(
            f"expected {n_vertices} vertices and {n_faces} faces, and there are {len(lines)} lines"
        )
    words = [word for line in lines[:n_vertices] for word in line[:3]]
    vertices = floats(words, 3 * n_vertices, "the vertices").reshape(-1, 3)
    faces = [np.zeros((0, 3), np.int64)]
    for line in lines[n_vertices : n_vertices + n_faces]:
        n_corners = int(integers(line[:1], 1, "a face")[0])
        faces.append(fan(integers(line[1 : max(n_corners, 0) + 1], n_corners, "a face")))
    check_faces(np.concatenate(faces), len(vertices))
    return Surface(vertices, np.concatenate(faces))
