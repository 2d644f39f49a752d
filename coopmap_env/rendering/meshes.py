"""Triangles for pictures of field episodes: simplified robots, and voxels as cubes."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.caches import freeze
from coopmap_env.mapping import VoxelGrid
from coopmap_env.robots import Chain, Vehicle

MESH_DETAIL = 0.02
"""Metres: smaller details of a robot are not drawn. A Husky with a Panda has 139,000 triangles."""

_SIDES = tuple(
    (axis, step, np.array(corners))
    for axis, step, corners in (
        (0, -1, [[0, 0, 0], [0, 0, 1], [0, 1, 1], [0, 1, 0]]),
        (0, 1, [[1, 0, 0], [1, 1, 0], [1, 1, 1], [1, 0, 1]]),
        (1, -1, [[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]]),
        (1, 1, [[0, 1, 0], [0, 1, 1], [1, 1, 1], [1, 1, 0]]),
        (2, -1, [[0, 0, 0], [0, 1, 0], [1, 1, 0], [1, 0, 0]]),
        (2, 1, [[0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]]),
    )
)
"""Axis, direction and corners of each side of a cube, anticlockwise as seen from outside."""


def exposed_faces(
    filled: NDArray[np.bool_], grid: VoxelGrid
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Triangles (m, 3, 3) of the sides between filled voxels and others, and their voxels (m,).

    Two triangles a side, anticlockwise as seen from outside; voxels are flat indices.
    """
    around = np.pad(filled, 1)
    triangles, voxels = [], []
    for axis, step, corners in _SIDES:
        beyond = np.roll(around, -step, axis=axis)[1:-1, 1:-1, 1:-1]
        index = np.argwhere(filled & ~beyond)
        quads = grid.origin + (index[:, None] + corners) * grid.resolution
        triangles.append(quads[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3, 3))
        voxels.append(np.repeat(grid.flat_index(index), 2))
    return np.concatenate(triangles), np.concatenate(voxels)


def cluster_vertices(
    triangles: ArrayLike, cell: float
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Vertices (v, 3) and faces (f, 3) after all corners in a cubic cell have become their mean.

    No corner moves further than the cell's diagonal; triangles that collapse are left out.
    """
    corners = np.asarray(triangles, dtype=np.float64).reshape(-1, 3)
    cells, member = np.unique(
        np.floor(corners / cell).astype(np.int64), axis=0, return_inverse=True
    )
    member = member.ravel()
    count = np.bincount(member, minlength=len(cells))[:, None]
    sums = [np.bincount(member, corners[:, axis], len(cells)) for axis in range(3)]
    vertices = np.stack(sums, axis=1) / count
    faces = member.reshape(-1, 3)
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    return vertices, faces[np.sort(first)]


@lru_cache(maxsize=8)
def simplified_links(chain: Chain) -> tuple[tuple[int, NDArray[np.float64]], ...]:
    """The rigid parts of a robot: for each a link, and triangles (m, 3, 3) in that link's frame."""
    parts = []
    for body in np.unique(chain.link_body):
        links = [
            link for link in np.flatnonzero(chain.link_body == body) if len(chain.meshes[link])
        ]
        if not links:
            continue
        R0, t0 = chain.link_rotations[links[0]], chain.link_translations[links[0]]
        placed = [
            ((chain.meshes[link] @ chain.link_rotations[link].T + chain.link_translations[link])
             - t0) @ R0
            for link in links
        ]  # fmt: skip
        vertices, faces = cluster_vertices(np.concatenate(placed), MESH_DETAIL)
        parts.append((int(links[0]), vertices[faces]))
    return freeze(tuple(parts))


def robot_triangles(vehicle: Vehicle, q: ArrayLike) -> NDArray[np.float64]:
    """Triangles (m, 3, 3) of a vehicle with its mount at q (n,), in the world frame."""
    rotations, translations = vehicle.link_poses(q)
    return np.concatenate(
        [
            triangles @ rotations[link].T + translations[link]
            for link, triangles in simplified_links(vehicle.chain)
        ]
    )
