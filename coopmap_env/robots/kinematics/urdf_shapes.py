"""Triangles of the shapes of a URDF."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.extras import import_optional
from coopmap_env.geometry.mesh_files import read_mesh
from coopmap_env.robots.kinematics.mesh_paths import resolve_mesh
from coopmap_env.robots.kinematics.urdf_elements import UrdfShape
from coopmap_env.robots.kinematics.urdf_xml import UrdfError

SPHERE_SUBDIVISIONS = 3
"""Of an icosahedron: the triangles lie within 0.3 % of the radius from the sphere."""


def shape_triangles(
    shape: UrdfShape, urdf: Path, package_dirs: Sequence[str | Path] = ()
) -> NDArray[np.float64]:
    """Triangles (m, 3, 3) of a shape in its link's frame, metres; those without area are left out.

    Parameters
    ----------
    shape : UrdfShape
    urdf : path
        The URDF, where the search for meshes begins.
    package_dirs : sequence of str, optional
        Folders in which ``package://`` meshes are searched.

    Raises
    ------
    UrdfError
        If a mesh is missing, cannot be read or leaves no finite triangle.
    """
    mesh = _shape_mesh(shape, urdf, package_dirs)
    mesh.apply_transform(shape.origin)
    return np.array(mesh.triangles[mesh.area_faces > 0.0], dtype=np.float64)


def _shape_mesh(shape: UrdfShape, urdf: Path, package_dirs: Sequence[str | Path]) -> Any:
    """A mesh of trimesh in the shape's frame."""
    creation = import_optional("trimesh.creation", "field")
    if shape.kind == "box":
        return creation.box(extents=shape.size)
    if shape.kind == "sphere":
        return creation.icosphere(subdivisions=SPHERE_SUBDIVISIONS, radius=shape.size[0])
    if shape.kind == "cylinder":
        return creation.cylinder(*shape.size)
    if shape.kind == "capsule":
        radius, length = shape.size
        return creation.capsule(height=length, radius=radius)
    path = resolve_mesh(shape.filename, urdf, package_dirs)
    return read_mesh(path, UrdfError, in_urdf=True).apply_scale(shape.scale)
