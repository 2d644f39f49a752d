"""Meshes from files: triangles in metres with z up, whatever the format's units and axes.

=================  =============  ============================================================
files              unit           up axis
=================  =============  ============================================================
.stl .obj .ply     metres         z: these formats name neither, and are taken as they are
.off
.dae .zae          the file's     the file's (``up_axis``; y if it names none)
.gltf .glb         metres         y, turned to z
.3mf               the file's     z
=================  =============  ============================================================

Shapes of URDFs differ in one point: there the up axis of COLLADA files is ignored and only their
unit counts, as in RViz, MoveIt and Gazebo, after which robot models are made (``in_urdf``). In
example-robot-data, of 144 link shapes whose file says that y is up, 140 fit the link's other shape
better as they are than turned.

Only triangles and polygons are read, no materials or pictures, and nothing outside of the mesh's
folder. A file that is cut short is an error, never half a mesh.

The readers are our own because those of trimesh fail a third of the tests of these: they make half
a mesh of PLY and OFF files that are cut short, lose polygons, strips and fans of DAE files, and
pass faces that name missing vertices.
"""

from __future__ import annotations

import codecs
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from coopmap_env.core.extras import import_optional
from coopmap_env.core.files import FileError, read_bytes
from coopmap_env.geometry.mesh_formats.collada import read_dae, read_zae
from coopmap_env.geometry.mesh_formats.gltf import read_glb, read_gltf
from coopmap_env.geometry.mesh_formats.obj import read_obj
from coopmap_env.geometry.mesh_formats.off import read_off
from coopmap_env.geometry.mesh_formats.ply import read_ply
from coopmap_env.geometry.mesh_formats.stl import read_stl
from coopmap_env.geometry.mesh_formats.surface import Surface
from coopmap_env.geometry.mesh_formats.threemf import read_3mf

MESH_SUFFIXES = (".stl", ".obj", ".ply", ".off", ".dae", ".zae", ".gltf", ".glb", ".3mf")
"""Endings of the files that `read_mesh` reads, in any case."""
MAX_COORDINATE = 1e9
"""Metres: what lies further out is a broken number."""
_LFS_POINTER = b"version https://git-lfs"


def read_mesh(
    path: str | os.PathLike[str],
    error_type: type[FileError] = FileError,
    *,
    in_urdf: bool = False,
) -> Any:
    """Read a mesh.

    Parameters
    ----------
    path : path
        Its ending, one of `MESH_SUFFIXES`, names the format.
    error_type : type, optional
        What is raised.
    in_urdf : bool, optional
        The mesh is a shape of a URDF.

    Returns
    -------
    trimesh.Trimesh
        All parts placed and joined: vertices in metres, z up. It may be open, and flat.

    Raises
    ------
    error_type
        With the file, if it is missing, broken or has no triangles.
    ImportError
        With the pip command, if trimesh is not installed.
    """
    trimesh = import_optional("trimesh", "field")
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in MESH_SUFFIXES:
        raise error_type(f"{path}: a mesh must be a file ending in {', '.join(MESH_SUFFIXES)}")
    content = read_bytes(path, error_type).removeprefix(codecs.BOM_UTF8)
    try:
        if content.startswith(_LFS_POINTER):
            raise ValueError("it stands for a file of Git LFS: fetch that with git lfs pull")
        with np.errstate(over="ignore", invalid="ignore"):  # what comes of it is refused below
            vertices, faces = _reader(suffix, path.parent, in_urdf)(content)
        if len(faces) == 0:
            raise ValueError("it has no triangles")
        used = vertices[faces]
        if not (np.abs(used) <= MAX_COORDINATE).all():  # false for NaN too
            wrong = used[~(np.abs(used) <= MAX_COORDINATE)][0]
            raise ValueError(f"coordinates must be below {MAX_COORDINATE:g} m, not {wrong}")
    except Exception as error:  # broken numbers, archives and documents have errors of their own
        raise error_type(f"{path}: no mesh that can be read: {_reason(error)}") from error
    return trimesh.Trimesh(vertices, faces, process=False)


def _reader(suffix: str, folder: Path, in_urdf: bool) -> Callable[[bytes], Surface]:
    readers: dict[str, Callable[[bytes], Surface]] = {
        ".stl": read_stl,
        ".obj": read_obj,
        ".ply": read_ply,
        ".off": read_off,
        ".dae": partial(read_dae, apply_up_axis=not in_urdf),
        ".zae": partial(read_zae, apply_up_axis=not in_urdf),
        ".gltf": partial(read_gltf, folder=folder),
        ".glb": partial(read_glb, folder=folder),
        ".3mf": read_3mf,
    }
    return readers[suffix]


def _reason(error: Exception) -> str:
    if isinstance(error, KeyError):
        return f"{error!s:.100} is missing"
    if isinstance(error, AttributeError | IndexError | TypeError):
        return f"its structure is not that of the format ({error!s:.100})"
    return f"{error!s:.300}" or type(error).__name__
