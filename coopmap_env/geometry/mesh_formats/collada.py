"""COLLADA (DAE, and ZAE in a zip archive): with a unit and an up axis, y if none is named.

Only triangles and polygons are read, placed by the nodes of the scene: no materials, pictures,
animations or armatures.
"""

from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.archives import unpack_member
from coopmap_env.core.files import brief
from coopmap_env.core.linear_algebra import product
from coopmap_env.core.xml_files import parse_xml
from coopmap_env.geometry.mesh_formats.collada_geometry import read_geometry
from coopmap_env.geometry.mesh_formats.surface import (
    Surface,
    SurfaceBuilder,
    floats,
    open_archive,
)
from coopmap_env.geometry.mesh_formats.transforms import (
    Z_UP_FROM_X_UP,
    Z_UP_FROM_Y_UP,
    axis_angle_transform,
)

_UP_AXES = {"X_UP": Z_UP_FROM_X_UP, "Y_UP": Z_UP_FROM_Y_UP, "Z_UP": np.eye(3)}


def read_dae(content: bytes, *, apply_up_axis: bool) -> Surface:
    """Read a DAE; without `apply_up_axis` only its unit counts."""
    root = parse_xml(content, "the document")
    if _name(root) != "COLLADA":
        raise ValueError(f"its root must be COLLADA, not {brief(root.tag)}")
    builder = SurfaceBuilder()
    document = _Document(root)
    pending = [(node, np.eye(4)) for node in document.roots()]
    while pending:
        node, T = pending.pop()
        builder.visit()
        if _name(node) == "geometry":
            builder.add(document.surface(node), T)
            continue
        for child in node:
            tag = _name(child)
            if tag == "node":
                pending.append((child, T))
            elif tag in ("instance_node", "instance_geometry"):
                pending.append((document.named(tag, child.get("url")), T))
            elif tag == "instance_controller":
                raise ValueError("skins cannot be read (instance_controller): apply them first")
            else:
                T = product(T, _transform(tag, child.text or ""))
    vertices, faces = builder.surface()
    vertices = vertices * document.unit()
    if apply_up_axis:
        vertices = product(vertices, document.up_axis().T)
    return Surface(vertices, faces)


def read_zae(content: bytes, *, apply_up_axis: bool) -> Surface:
    """Read the only DAE of an archive."""
    archive = open_archive(content)
    found = [
        member
        for member in archive.infolist()
        if member.filename.lower().endswith(".dae") and not member.filename.startswith("__MACOSX")
    ]
    if len(found) != 1:
        raise ValueError(f"it must hold one .dae file, not {len(found)}")
    return read_dae(unpack_member(archive, found[0]), apply_up_axis=apply_up_axis)


def _name(element: ElementTree.Element) -> str:
    """The tag of an element without its namespace."""
    return element.tag.rpartition("}")[2]


def _transform(tag: str, text: str) -> NDArray[np.float64]:
    """T (4, 4) of one element of a node; the identity if it is no transform."""
    T = np.eye(4)
    if tag == "matrix":
        T = floats(text.split(), 16, "a matrix").reshape(4, 4)
    elif tag == "translate":
        T[:3, 3] = floats(text.split(), 3, "a translation")
    elif tag == "rotate":
        *axis, degrees = floats(text.split(), 4, "a rotation")
        T = axis_angle_transform(np.array(axis), degrees)
    elif tag == "scale":
        T[:3, :3] = np.diag(floats(text.split(), 3, "a scale"))
    elif tag in ("skew", "lookat"):
        raise ValueError(f"the transform {tag} of a node cannot be read")
    return T


class _Document:
    """The parsed XML with its elements by tag and reference."""

    def __init__(self, root: ElementTree.Element) -> None:
        self._root = root
        self._by_id: dict[tuple[str, str], list[ElementTree.Element]] = {}
        for entry in root.iter():
            if entry.get("id"):
                self._by_id.setdefault((_name(entry), f"#{entry.get('id')}"), []).append(entry)
        self._surfaces: dict[ElementTree.Element, Surface] = {}

    def unit(self) -> float:
        """Metres."""
        element = self._root.find("{*}asset/{*}unit")
        text = "1" if element is None else element.get("meter", "1")
        unit = float(floats([text], 1, "the unit")[0])
        if not 0.0 < unit < np.inf:
            raise ValueError(f"its unit must be above 0 m, not {brief(text)}")
        return unit

    def up_axis(self) -> NDArray[np.float64]:
        """The rotation (3, 3) to z up."""
        name = (self._root.findtext("{*}asset/{*}up_axis") or "Y_UP").strip()
        if name not in _UP_AXES:
            raise ValueError(f"its up_axis must be one of {', '.join(_UP_AXES)}, not {brief(name)}")
        return _UP_AXES[name]

    def roots(self) -> list[ElementTree.Element]:
        """The scene that is shown, else the first one, else all geometries."""
        shown = self._root.find("{*}scene/{*}instance_visual_scene")
        if shown is not None:
            return [self.named("instance_visual_scene", shown.get("url"))]
        scenes = self._root.findall("{*}library_visual_scenes/{*}visual_scene")
        return scenes[:1] or self._root.findall("{*}library_geometries/{*}geometry")

    def named(self, instance: str, url: str | None) -> ElementTree.Element:
        """The element of which an instance inside of the document is one."""
        tag = instance.removeprefix("instance_")
        found = self._by_id.get((tag, url or ""), [])
        if len(found) != 1:
            raise ValueError(f"it has {len(found)} elements {tag} named {brief(url or '')}")
        return found[0]

    def surface(self, geometry: ElementTree.Element) -> Surface:
        """The triangles of a geometry, parsed once."""
        if geometry not in self._surfaces:
            self._surfaces[geometry] = read_geometry(geometry)
        return self._surfaces[geometry]
