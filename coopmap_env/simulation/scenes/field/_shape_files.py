"""Meshes and URDF files as vertices, faces and convex parts."""

import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.extras import import_optional
from coopmap_env.core.linear_algebra import product
from coopmap_env.geometry.mesh_files import read_mesh
from coopmap_env.robots import UrdfModel, resolve_mesh
from coopmap_env.simulation.scenes.factory import SceneError
from coopmap_env.simulation.scenes.field._voxel_truth import is_closed

_CONVEXITY_TOLERANCE = 1e-3
"""A part counts as convex if it fills its hull but for this fraction of the volume."""
_MAX_PARTS = 1000
"""Convex parts of one solid: each is a body of the physics."""
_NO_AREA = 1e-12
"""A part whose area is less than this fraction of its extent's square is a line or a point."""

MAX_VERTICES, MAX_FACES = 130_000, 170_000
"""Of one solid: PyBullet takes 131,072 vertices and 524,288 indices for a shape."""


@dataclass(frozen=True, eq=False)
class MeshShape:
    """What a file describes, in its own frame."""

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    parts: tuple[NDArray[np.float64], ...]
    """Points of the convex parts; none if a part of it is not convex."""


class ShapeFiles:
    """The meshes and URDFs that one scene names; each is read once.

    Parameters
    ----------
    scene : Path
        The scene's file: relative paths start at its folder.
    package_dirs : tuple of str
        Folders in which ``package://name/...`` is searched.
    """

    def __init__(self, scene: Path, package_dirs: tuple[str, ...]) -> None:
        self._scene = scene
        self._package_dirs = package_dirs
        self._shapes: dict[tuple[str, str], MeshShape] = {}

    def read(self, kind: str, name: str) -> MeshShape:
        """Read a "mesh" or "urdf" by the name that the scene gives it.

        Raises
        ------
        FileError
            With the file, if it cannot be read.
        """
        if (kind, name) not in self._shapes:
            path = self._scene.parent / name
            if "://" in name:
                path = resolve_mesh(name, self._scene, self._package_dirs)
            self._shapes[kind, name] = (
                shape_from_mesh(path)
                if kind == "mesh"
                else shape_from_urdf(path, self._package_dirs)
            )
        return self._shapes[kind, name]


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
                corners = (product(model.shape_triangles(shape), R.T) + t).reshape(-1, 3)
                faces = np.arange(len(corners)).reshape(-1, 3)
                meshes.append(trimesh.Trimesh(corners, faces, process=False))
        if any(len(mesh.faces) for mesh in meshes):
            return _join_meshes(meshes, path)
    raise SceneError(f"{path}: none of its links has a shape")


def _join_meshes(meshes: Iterable[Any], path: Path) -> MeshShape:
    """Join meshes of trimesh."""
    joined, vertices, faces, n = [], [], [], 0
    is_open = False
    for mesh in map(_merged, meshes):
        if len(mesh.faces) == 0:
            continue
        vertices.append(np.asarray(mesh.vertices, dtype=np.float64))
        faces.append(np.asarray(mesh.faces, dtype=np.int64) + n)
        n += len(mesh.vertices)
        is_open = is_open or not is_closed(mesh.faces)
        joined.append(mesh)
    if not faces:
        raise SceneError(f"{path}: it has no surface with an area")
    if is_open:
        warnings.warn(
            f"{path}: the surface is open or its faces do not all point outwards; voxels inside "
            "of it count as free, only those on the surface as occupied",
            stacklevel=2,
        )
    parts = () if is_open else _convex_parts(joined)
    if parts:
        _check_size(max(map(len, parts)), 0, path)
    else:
        _check_size(n, sum(map(len, faces)), path)
    return MeshShape(np.concatenate(vertices), np.concatenate(faces), parts)


def _convex_parts(meshes: Sequence[Any]) -> tuple[NDArray[np.float64], ...]:
    """Points of the connected parts of closed meshes; none if one is not convex."""
    if sum(mesh.body_count for mesh in meshes) > _MAX_PARTS:
        return ()
    parts = [part for mesh in meshes for part in mesh.split(only_watertight=False)]
    if not all(map(_is_convex, parts)):
        return ()
    return tuple(np.asarray(part.vertices) for part in parts)


def _check_size(n_vertices: int, n_faces: int, path: Path) -> None:
    for size, limit, what in (
        (n_vertices, MAX_VERTICES, "vertices"),
        (n_faces, MAX_FACES, "triangles"),
    ):
        if size > limit:
            raise SceneError(
                f"{path} has {size:,} {what}, more than the physics takes for one solid "
                f"({limit:,}): simplify it, or divide it into several objects"
            )


def _merged(mesh: Any) -> Any:
    """A mesh of trimesh without the parts, the copies of faces and the vertices that are nothing.

    Equal vertices are one.
    """
    trimesh = import_optional("trimesh", "field")
    used, faces = np.unique(np.asarray(mesh.faces, dtype=np.int64), return_inverse=True)
    merged = trimesh.Trimesh(mesh.vertices[used], faces.reshape(-1, 3), process=False)
    merged.merge_vertices()
    kept = _faces_with_area(merged.vertices, merged.faces)
    once = _without_copies(kept)
    if len(kept) and (is_closed(once) or not is_closed(kept)):
        kept = once
    used, faces = np.unique(kept, return_inverse=True)
    return trimesh.Trimesh(merged.vertices[used], faces.reshape(-1, 3), process=False)


def _without_copies(faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """The faces without repetitions: double-sided surfaces have each of them turned over, too."""
    _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    return faces[np.sort(first)]


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
    from scipy.spatial import ConvexHull, QhullError

    if not mesh.is_watertight:
        return False
    points = mesh.vertices - mesh.vertices.mean(axis=0)
    try:
        hull_volume = ConvexHull(points).volume
    except QhullError:  # flat
        return False
    a, b, c = np.moveaxis(points[mesh.faces], 1, 0)
    volume = abs(np.einsum("fk,fk->", a, np.cross(b, c)) / 6.0)
    return bool(volume >= (1.0 - _CONVEXITY_TOLERANCE) * hull_volume > 0.0)
