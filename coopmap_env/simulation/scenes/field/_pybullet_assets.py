"""Assets of pybullet_data, read where that package is installed; none of it is copied here.

Tables and shelves are the boxes of their descriptions (the shelf's own mesh has ten thousand
triangles). The random objects, duck and teddy come as convex parts, which the physics uses as
they are; the bunny is one concave surface.
"""

import re
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.caches import freeze
from coopmap_env.core.extras import import_optional
from coopmap_env.core.files import read_text
from coopmap_env.core.linear_algebra import product
from coopmap_env.core.xml_files import read_xml
from coopmap_env.geometry import rotation_about_axis, rotation_from_rpy
from coopmap_env.simulation.scenes.factory import SceneError
from coopmap_env.simulation.scenes.field.solid import (
    Solid,
    box_corners,
    convex_hull,
    solid_from_boxes,
)

RANDOM_ASSETS = tuple(sorted({*range(1000)} - {168, 295, 297, 602, 824}))
"""Objects of the folder random_urdfs: in one of the others vertices are not numbers, and four
are less than 1 cm large."""

_RANDOM_SCALE = 0.015
"""The scale in the description of each random object."""
_MAX_FACES = 500
_NAMED_ASSET_FILES = {
    "duck": ("duck_vhacd.obj", 0.26, np.pi / 2),
    "teddy": ("teddy2_VHACD_CHs.obj", 0.5, np.pi / 2),
    "bunny": ("bunny.obj", 0.2, 0.0),
}
"""File, scale and angle about x that puts it upright: each about 0.4 m tall, several voxels."""
NAMED_ASSETS = tuple(_NAMED_ASSET_FILES)


@dataclass(frozen=True, eq=False)
class PyBulletAsset:
    """An asset in its own frame: middle of its outline at x = y = 0, lowest point at z = 0."""

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    parts: tuple[slice, ...]
    """Vertices of each convex part; none for a concave asset."""

    @cached_property
    def size(self) -> NDArray[np.float64]:
        """Extent (3,) along its axes, metres."""
        return np.ptp(self.vertices, axis=0)

    def to_solid(
        self, name: str, position: ArrayLike, rotation: NDArray[np.float64], *, is_target: bool
    ) -> Solid:
        """The solid of this name: rotated about its middle, its origin at `position` (3,)."""
        vertices = product(self.vertices, rotation.T) + np.asarray(position)
        hulls = tuple(vertices[part] for part in self.parts)
        return Solid(
            name, vertices, self.faces, hulls, is_target=is_target, is_concave=not self.parts
        )


@lru_cache(maxsize=2 * len(RANDOM_ASSETS))
def load_random_asset(number: int, object_scale: float) -> PyBulletAsset:
    """Read one of `RANDOM_ASSETS`, scaled: at scale 1 it is about 0.1 m large.

    One in four has more than 500 faces and is replaced by its convex hull.
    """
    path = data_folder() / "random_urdfs" / f"{number:03d}" / f"{number:03d}.obj"
    asset = freeze(_read_asset(path, _RANDOM_SCALE * object_scale, np.eye(3)))
    if len(asset.faces) <= _MAX_FACES:
        return asset
    vertices, faces = convex_hull(asset.vertices)
    return freeze(PyBulletAsset(vertices, faces, (slice(None),)))


@lru_cache
def load_asset(name: str) -> PyBulletAsset:
    """Read one of `NAMED_ASSETS`."""
    file, scale, angle = _NAMED_ASSET_FILES[name]
    upright = rotation_about_axis([1.0, 0.0, 0.0], angle)
    return freeze(_read_asset(data_folder() / file, scale, upright))


def table(
    name: str, position: ArrayLike, rotation: NDArray[np.float64], *, is_target: bool
) -> Solid:
    """Make a table, 1.5 x 1 m and 0.625 m high, that stands at a position (3,)."""
    return _solid(name, _table_boxes(), position, rotation, is_target)


def shelf(name: str, position: ArrayLike, rotation: NDArray[np.float64]) -> Solid:
    """Make a shelf, 0.9 x 0.9 m and 2.3 m high, open along y, that stands at a position (3,)."""
    return _solid(name, _shelf_boxes(), position, rotation, False)


def data_folder() -> Path:
    """Folder of the installed pybullet_data.

    Raises
    ------
    ImportError
        With the pip command, if it is not installed.
    """
    return Path(import_optional("pybullet_data", "field").getDataPath())


def _solid(
    name: str,
    boxes: tuple[NDArray[np.float64], ...],
    position: ArrayLike,
    rotation: NDArray[np.float64],
    is_target: bool,
) -> Solid:
    placed = [product(box, rotation.T) + np.asarray(position) for box in boxes]
    return solid_from_boxes(name, placed, is_target=is_target)


@lru_cache
def _table_boxes() -> tuple[NDArray[np.float64], ...]:
    """Boxes of table.urdf: its visuals scale a cube of side 1."""
    path = data_folder() / "table" / "table.urdf"
    boxes = []
    for visual in read_xml(path, SceneError).iter("visual"):
        origin, mesh = visual.find("origin"), visual.find("geometry/mesh")
        if origin is None or mesh is None:
            raise SceneError(f"{path}: each visual must have an origin and a mesh")
        boxes.append(box_corners(_numbers(mesh.get("scale")), _numbers(origin.get("xyz"))))
    return freeze(tuple(boxes))


@lru_cache
def _shelf_boxes() -> tuple[NDArray[np.float64], ...]:
    """Boxes of kiva_shelf/model.sdf: its collision shapes, each once."""
    path = data_folder() / "kiva_shelf" / "model.sdf"
    shapes: dict[tuple[tuple[float, ...], ...], None] = {}
    for shape in read_xml(path, SceneError).iter("collision"):
        pose, size = shape.findtext("pose"), shape.findtext("geometry/box/size")
        if pose is None or size is None:
            raise SceneError(f"{path}: each collision shape must have a pose and a box")
        shapes[tuple(_numbers(pose)), tuple(_numbers(size))] = None
    return freeze(
        tuple(box_corners(size, pose[:3], rotation_from_rpy(*pose[3:])) for pose, size in shapes)
    )


def _numbers(text: str | None) -> list[float]:
    return [float(word) for word in (text or "").split()]


def _read_asset(path: Path, scale: float, upright: NDArray[np.float64]) -> PyBulletAsset:
    """Read an OBJ file of triangles; V-HACD calls its convex parts ``o convex_0`` and so on."""
    text = read_text(path, SceneError)
    try:
        points = product(_rows(text, "v", float), upright.T) * scale
        faces = _rows(text, "f", int) - 1
        low, high = points.min(axis=0), points.max(axis=0)
    except (ValueError, OverflowError) as error:
        raise SceneError(f"{path}: cannot be read: {error}") from error
    points -= [*(low + high)[:2] / 2, low[2]]
    starts = [text.count("\nv ", 0, part.start()) for part in re.finditer("o convex_", text)]
    ends = [*starts[1:], len(points)]
    return PyBulletAsset(points, faces, tuple(map(slice, starts, ends)) if starts else ())


def _rows(text: str, kind: str, number: type) -> NDArray[Any]:
    """Numbers (n, 3) of the lines of one kind."""
    words = " ".join(re.findall(f"^{kind} (.*)$", text, re.MULTILINE)).split()
    return np.array(list(map(number, words))).reshape(-1, 3)
