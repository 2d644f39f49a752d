"""Meshes and URDF files as vertices, faces and convex parts."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.extras import import_optional

_CONVEXITY_TOLERANCE = 1e-3
"""A part counts as convex if it fills its hull but for this fraction of the volume."""


@dataclass(frozen=True, eq=False)
class MeshShape:
    """What a file describes, in its own frame."""

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    parts: tuple[NDArray[np.float64], ...]
    """Points of the convex parts; none if a part of it is not convex."""


def read_mesh(path: Path) -> MeshShape:
    """Read a mesh in any format of trimesh.

    Raises
    ------
    ValueError
        If the file cannot be read or has no triangles.
    """
    trimesh = import_optional("trimesh", "field")
    if not path.is_file():
        raise ValueError("there is no such file")
    try:
        # unprocessed: trimesh would drop vertices that are not finite, silently
        mesh = trimesh.load(path, force="mesh", process=False)
    except Exception as error:  # each format of trimesh has errors of its own
        raise ValueError(f"trimesh cannot read it: {error}") from error
    return _join_meshes([mesh])


def read_urdf(path: Path) -> MeshShape:
    """Read all links of a URDF with its joints at 0: its visuals, else its collision shapes.

    Raises
    ------
    ValueError
        If a file cannot be read or there are no triangles.
    """
    yourdfpy = import_optional("yourdfpy", "field")
    if not path.is_file():
        raise ValueError("there is no such file")
    missing: list[str] = []

    def find(fname: str) -> str:
        file = path.parent / fname.removeprefix("package://").removeprefix("file://")
        if not file.is_file():
            missing.append(str(file))
        return str(file)

    try:
        urdf = yourdfpy.URDF.load(
            str(path),
            filename_handler=find,
            build_collision_scene_graph=True,
            load_collision_meshes=True,
        )
    except Exception as error:  # XML, numbers and each format of mesh have errors of their own
        raise ValueError(f"yourdfpy cannot read it: {error}") from error
    if missing:
        raise ValueError(f"it names files that are missing: {', '.join(sorted({*missing}))}")
    for scene in (urdf.scene, urdf.collision_scene):
        meshes = [] if scene is None else scene.dump(concatenate=False)
        if meshes:
            return _join_meshes(list(meshes))
    raise ValueError("none of its links has a shape")


def _join_meshes(meshes: list[Any]) -> MeshShape:
    """Join meshes of trimesh."""
    trimesh = import_optional("trimesh", "field")
    vertices, faces, parts, n = [], [], [], 0
    for surface in meshes:
        if len(getattr(surface, "faces", ())) == 0:
            continue
        mesh = trimesh.Trimesh(surface.vertices, surface.faces, process=False)
        if not np.isfinite(mesh.vertices).all():
            raise ValueError("a vertex is not finite")
        mesh.merge_vertices()
        vertices.append(np.asarray(mesh.vertices, dtype=np.float64))
        faces.append(np.asarray(mesh.faces, dtype=np.int64) + n)
        n += len(mesh.vertices)
        parts += list(mesh.split(only_watertight=False))
    if not faces:
        raise ValueError("it has no triangles")
    is_convex = all(_is_convex(part) for part in parts)
    hulls = tuple(np.asarray(part.vertices) for part in parts) if is_convex else ()
    return MeshShape(np.concatenate(vertices), np.concatenate(faces), hulls)


def _is_convex(mesh: Any) -> bool:
    """Whether a connected mesh is closed and fills its convex hull."""
    return bool(
        mesh.is_watertight and mesh.volume >= (1.0 - _CONVEXITY_TOLERANCE) * mesh.convex_hull.volume
    )
