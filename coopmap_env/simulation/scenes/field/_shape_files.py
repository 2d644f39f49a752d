"""Meshes and URDF files as vertices, faces and convex parts."""

import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.extras import import_optional
from coopmap_env.geometry.mesh_files import read_mesh
from coopmap_env.robots import UrdfModel
from coopmap_env.simulation.scenes.factory import SceneError
from coopmap_env.simulation.scenes.field._voxel_truth import is_closed

_CONVEXITY_TOLERANCE = 1e-3
"""A part counts as convex if it fills its hull but for this fraction of the volume."""
_NO_AREA = 1e-12
"""A part whose area is less than this fraction of its extent's square is a line or a point."""


@dataclass(frozen=True, eq=False)
class MeshShape:
    """What a file describes, in its own frame."""

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    parts: tuple[NDArray[np.float64], ...]
    """Points of the convex parts; none if a part of it is not convex."""


def shape_from_mesh(path: Path) -> MeshShape:
    """Read a mesh; see `read_mesh` for formats, units and axes.

    Warns
    -----
    UserWarning
        With the file, if the surface has a border: there is no inside then.

    Raises
    ------
    SceneError
        With the file, if it cannot be read or has no area.
    """
    mesh = read_mesh(path, SceneError)
    return _join_meshes([mesh], path)


def shape_from_urdf(path: Path, package_dirs: Sequence[str] = ()) -> MeshShape:
    """Read all links of a URDF with its joints at 0: its visuals, else its collision shapes.

    Warns
    -----
    UserWarning
        As `shape_from_mesh`.

    Raises
    ------
    FileError
        With the file and the element, if one cannot be read or there is no area.
    """
    trimesh = import_optional("trimesh", "field")
    model = UrdfModel.from_file(path, package_dirs)
    poses = model.link_poses()
    for kind in ("visuals", "collisions"):
        meshes = []
        for name, link in model.links.items():
            R, t = poses[name][:3, :3], poses[name][:3, 3]
            for shape in getattr(link, kind):
                corners = (model.shape_triangles(shape) @ R.T + t).reshape(-1, 3)
                faces = np.arange(len(corners)).reshape(-1, 3)
                meshes.append(trimesh.Trimesh(corners, faces, process=False))
        if any(len(mesh.faces) for mesh in meshes):
            return _join_meshes(meshes, path)
    raise SceneError(f"{path}: none of its links has a shape")


def _join_meshes(meshes: Iterable[Any], path: Path) -> MeshShape:
    """Join meshes of trimesh."""
    trimesh = import_optional("trimesh", "field")
    vertices, faces, parts, n = [], [], [], 0
    n_open = 0
    for surface in meshes:
        mesh = trimesh.Trimesh(surface.vertices, surface.faces, process=False)
        mesh.merge_vertices()
        kept = _faces_with_area(mesh.vertices, mesh.faces)
        if len(kept) == 0:
            continue
        mesh = trimesh.Trimesh(mesh.vertices, kept, process=False)
        vertices.append(np.asarray(mesh.vertices, dtype=np.float64))
        faces.append(kept + n)
        n += len(mesh.vertices)
        if is_closed(kept):
            parts += list(mesh.split(only_watertight=False))
        else:
            n_open += 1
    if not faces:
        raise SceneError(f"{path}: it has no surface with an area")
    if n_open:
        warnings.warn(
            f"{path}: the surface is open or its faces do not all point outwards; voxels inside "
            "of it count as free, only those on the surface as occupied",
            stacklevel=2,
        )
    is_convex = not n_open and all(_is_convex(part) for part in parts)
    hulls = tuple(np.asarray(part.vertices) for part in parts) if is_convex else ()
    return MeshShape(np.concatenate(vertices), np.concatenate(faces), hulls)


def _faces_with_area(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """The faces without those of connected parts that have no area, and without doubled corners.

    Single faces without area stay in a part with one: it may be closed only with them.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components  # a tenth of a second, seldom needed

    faces = np.asarray(faces, dtype=np.int64)
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    if len(faces) == 0:
        return faces
    a, b, c = faces.T
    links = (np.ones(2 * len(faces)), (np.concatenate([a, b]), np.concatenate([b, c])))
    n_parts, part_of_vertex = connected_components(
        coo_array(links, shape=(len(vertices), len(vertices))), directed=False
    )
    part = part_of_vertex[a]
    corners = np.asarray(vertices)[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.bincount(part, np.linalg.norm(normals, axis=1) / 2, n_parts)
    low, high = np.full((n_parts, 3), np.inf), np.full((n_parts, 3), -np.inf)
    np.minimum.at(low, part, corners.min(axis=1))
    np.maximum.at(high, part, corners.max(axis=1))
    extent = np.linalg.norm(np.where(high >= low, high - low, 0.0), axis=1)
    return faces[(area > _NO_AREA * extent**2)[part]]


def _is_convex(mesh: Any) -> bool:
    """Whether a connected mesh is closed and fills its convex hull."""
    from scipy.spatial import QhullError

    if not mesh.is_watertight:
        return False
    try:
        hull_volume = mesh.convex_hull.volume
    except QhullError:  # flat
        return False
    return bool(
        hull_volume > 0.0 and abs(mesh.volume) >= (1.0 - _CONVEXITY_TOLERANCE) * hull_volume
    )
