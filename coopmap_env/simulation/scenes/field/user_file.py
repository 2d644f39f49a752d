"""User scenes, from a YAML file.

.. code-block:: yaml

    ground: true                  # default: flat ground at z = 0
    grid:                         # default: 12.8 x 12.8 x 4 m in voxels of 0.1 m
      shape: [128, 128, 40]
      resolution: 0.1
      origin: [-6.4, -6.4, -0.35]
    objects:                      # each is one of box, mesh and urdf
      - box: [1.0, 0.6, 0.8]      # sides in metres, about its middle
        position: [0, 0, 0.4]     # metres
        rpy: [0, 0, 30]           # degrees about the fixed axes x, y, z, in this order
        target: true
      - mesh: meshes/rock.obj     # paths are relative to this file
        name: rock
        scale: 0.5                # or one factor an axis
        position: [2, 1, 0]
      - urdf: shelf.urdf          # all links, joints at 0
    package_dirs: [descriptions]  # folders of ROS packages, for package://name/...
    bases:                        # default: drawn; x, y in metres and yaw in degrees
      - [3, 0, 180]

Positions are in the world frame, which is that of the target. Meshes may be STL, OBJ, PLY, OFF,
DAE, glTF, GLB or 3MF; their units and axes are those of the format (see
`coopmap_env.geometry.mesh_files`). A ROS package is also found in the folders above the file that
names it. A mesh whose connected parts are all convex collides as these, any other one as its
triangles; parts without an area are ignored, and an open mesh has no inside.
"""

import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from coopmap_env.core.files import brief
from coopmap_env.core.linear_algebra import product
from coopmap_env.core.yaml_files import read_yaml_mapping, read_yaml_number
from coopmap_env.geometry import rotation_from_rpy
from coopmap_env.mapping import VoxelGrid
from coopmap_env.simulation.scenes.factory import SceneError
from coopmap_env.simulation.scenes.field._fields import MAX_NUMBER, Fields
from coopmap_env.simulation.scenes.field._shape_files import ShapeFiles
from coopmap_env.simulation.scenes.field.solid import Solid, box_corners, solid_from_boxes
from coopmap_env.simulation.scenes.field.user_scene import UserScene
from coopmap_env.simulation.scenes.field.world import FIELD_GRID, make_ground

MAX_OBJECTS, MAX_FACES = 10_000, 2_000_000
"""Of one scene: more are a mistake, or should be simplified."""
_MAX_NAME_LENGTH = 100
_EXTENTS = (1e-4, 1e6)
"""Metres: the smallest solid and the largest one; others come of a wrong unit or scale."""
_RESOLUTIONS = (1e-4, 1e3)
"""Metres: the smallest and the largest edge of a voxel."""
_KINDS = ("box", "mesh", "urdf")
_OBJECT = (*_KINDS, "name", "position", "rpy", "scale", "target")


def read_user_scene(path: str | os.PathLike[str]) -> UserScene:
    """Read a scene; it is named after the file.

    Raises
    ------
    SceneError
        With file, entry, value and what was expected, if there is no usable scene.
    ImportError
        With the pip command, if PyYAML is not installed, or for meshes and URDFs the extra
        ``field``.
    """
    path = Path(path)
    top = Fields(str(path), read_yaml_mapping(path, SceneError))
    top.check_keys("grid", "ground", "objects", "bases", "package_dirs")
    grid = _grid(top)
    files = ShapeFiles(path, _package_dirs(top, path.parent))
    entries = top.content.get("objects")
    if not isinstance(entries, list) or not entries:
        raise top.error("objects", "a list of at least one object")
    if len(entries) > MAX_OBJECTS:
        raise top.error("objects", f"a list of at most {MAX_OBJECTS:,} objects")
    solids = [make_ground(grid)] if top.boolean("ground", True) else []
    names = {solid.name for solid in solids}
    n_faces = 0
    for k, entry in enumerate(entries):
        where = f"{path}: objects[{k}]"
        if not isinstance(entry, Mapping):
            raise SceneError(f"{where}: expected a mapping of fields, not {brief(entry)}")
        solid = _solid(Fields(where, entry), files, f"object_{k}")
        if solid.name in names:
            raise SceneError(f"{where}: name must differ from all others, not {solid.name!r}")
        names.add(solid.name)
        solids.append(solid)
        n_faces += len(solid.faces)
        if n_faces > MAX_FACES:
            raise SceneError(f"{where}: with it the objects have more than {MAX_FACES:,} triangles")
    if not any(solid.is_target for solid in solids):
        raise SceneError(f"{path}: objects must hold a target (target: true), not none")
    try:
        return UserScene(path.stem, tuple(solids), grid, _bases(top))
    except SceneError:
        raise
    except ValueError as error:
        raise SceneError(f"{path}: {error}") from error


def _grid(top: Fields) -> VoxelGrid:
    if "grid" not in top.content:
        return FIELD_GRID
    if not isinstance(top.content["grid"], Mapping):
        raise top.error("grid", "a mapping of shape, resolution and origin")
    fields = Fields(f"{top.where}: grid", top.content["grid"])
    fields.check_keys("shape", "resolution", "origin")
    shape = fields.vector("shape", above=0.0)
    if (shape % 1.0).any():
        raise fields.error("shape", "three integers")
    resolution = read_yaml_number(fields.content.get("resolution", FIELD_GRID.resolution))
    least, most = _RESOLUTIONS
    if not least <= resolution <= most:
        raise fields.error("resolution", f"a number of metres from {least:g} to {most:g}")
    nx, ny, nz = (int(n) for n in shape)
    x, y, z = (float(metres) for metres in fields.vector("origin"))
    try:
        return VoxelGrid((nx, ny, nz), resolution, (x, y, z))
    except ValueError as error:
        raise SceneError(f"{fields.where}: {error}") from error


def _package_dirs(top: Fields, folder: Path) -> tuple[str, ...]:
    """Folders of ROS packages, which must exist."""
    entries = top.content.get("package_dirs", [])
    if not isinstance(entries, list) or not all(isinstance(entry, str) for entry in entries):
        raise top.error("package_dirs", "a list of folders")
    for entry in entries:
        if "\0" in entry or not (folder / entry).is_dir():
            raise SceneError(f"{top.where}: package_dirs: there is no folder {brief(entry)}")
    return tuple(str(folder / entry) for entry in entries)


def _solid(fields: Fields, files: ShapeFiles, name: str) -> Solid:
    """Make the solid of an entry."""
    fields.check_keys(*_OBJECT)
    kinds = [kind for kind in _KINDS if kind in fields.content]
    if len(kinds) != 1:
        raise SceneError(
            f"{fields.where}: expected one of {', '.join(_KINDS)}, not {kinds or 'none'}"
        )
    name, is_target = fields.string("name", name), fields.boolean("target", False)
    if len(name) > _MAX_NAME_LENGTH or not name.isprintable():
        raise fields.error("name", f"text of at most {_MAX_NAME_LENGTH} printable letters")
    position = fields.vector("position", default=0.0)
    rotation = rotation_from_rpy(*np.radians(fields.vector("rpy", default=0.0)))
    scale = _scale(fields)
    if kinds == ["box"]:
        corners = box_corners(fields.vector("box", above=0.0) * scale, position, rotation)
        solid = solid_from_boxes(name, [corners], is_target=is_target)
        return _check_extent(solid, fields.where)
    file = fields.string(kinds[0])
    try:
        shape = files.read(kinds[0], file)
        solid = Solid(
            name,
            product(shape.vertices * scale, rotation.T) + position,
            shape.faces,
            tuple(product(part * scale, rotation.T) + position for part in shape.parts),
            is_target=is_target,
            is_concave=not shape.parts,
        )
    except ValueError as error:
        raise SceneError(f"{fields.where}: {kinds[0]}: {error}") from error
    return _check_extent(solid, fields.where)


def _check_extent(solid: Solid, where: str) -> Solid:
    """The solid, or SceneError if it is of no size that a scene can have."""
    extent = float(np.ptp(solid.bounds, axis=0).max())
    least, most = _EXTENTS
    if not least <= extent <= most:
        raise SceneError(
            f"{where}: it is {extent:.3g} m large, expected {least:g} to {most:g} m: is its unit "
            "or scale right?"
        )
    return solid


def _scale(fields: Fields) -> Any:
    """Factors (3,)."""
    if isinstance(fields.content.get("scale"), list):
        return fields.vector("scale", above=0.0)
    scale = read_yaml_number(fields.content.get("scale", 1.0))
    if not 0.0 < scale < math.inf:
        raise fields.error("scale", "a finite number above 0, or three")
    if scale > MAX_NUMBER:
        raise fields.error("scale", f"a number of at most {MAX_NUMBER:g}, or three")
    return np.full(3, scale)


def _bases(top: Fields) -> tuple[tuple[float, float, float], ...]:
    """Read x, y and yaw (radians) of each base."""
    entries = top.content.get("bases", [])
    if not isinstance(entries, list):
        raise top.error("bases", "a list of [x, y, yaw in degrees]")
    bases = []
    for k, entry in enumerate(entries):
        x, y, yaw = Fields(top.where, {f"bases[{k}]": entry}).vector(f"bases[{k}]")
        bases.append((float(x), float(y), math.radians(yaw)))
    return tuple(bases)
