"""3MF: a zip archive of XML, with a unit (millimetres if none is named), z up."""

import posixpath
import zipfile
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.archives import unpack_member
from coopmap_env.core.files import brief
from coopmap_env.core.linear_algebra import product
from coopmap_env.core.xml_files import parse_xml
from coopmap_env.geometry.mesh_formats.surface import (
    Surface,
    SurfaceBuilder,
    check_faces,
    floats,
    integers,
    open_archive,
)

_UNITS = {
    "micron": 1e-6, "millimeter": 1e-3, "centimeter": 1e-2, "meter": 1.0,
    "inch": 0.0254, "foot": 0.3048,
}  # fmt: skip
_ROOT_MODEL, _RELATIONS = "3D/3dmodel.model", "_rels/.rels"
_MAX_DEPTH = 64


def read_3mf(content: bytes) -> Surface:
    """Read what the model builds: its objects, with the components that they are made of."""
    archive = open_archive(content)
    models: dict[str, _Model] = {}
    root = _model(archive, models, _root_model(archive))
    builder = SurfaceBuilder()
    for item in root.element.iterfind("{*}build/{*}item"):
        _place(archive, models, root, item, np.eye(4), builder, 0)
    vertices, faces = builder.surface()
    return Surface(vertices * root.unit, faces)


class _Model:
    """One XML file of the archive and its objects by id."""

    def __init__(self, path: str, content: bytes) -> None:
        self.path = path
        self.element = parse_xml(content, path)
        unit = self.element.get("unit", "millimeter")
        if unit not in _UNITS:
            raise ValueError(f"its unit must be one of {', '.join(_UNITS)}, not {brief(unit)}")
        self.unit = _UNITS[unit]
        self.objects = {
            entry.get("id"): entry for entry in self.element.iterfind("{*}resources/{*}object")
        }
        self.meshes: dict[str | None, Surface] = {}

    def mesh(self, number: str | None, element: ElementTree.Element) -> Surface:
        """The mesh of an object, parsed once."""
        if number not in self.meshes:
            self.meshes[number] = _mesh(element)
        return self.meshes[number]


def _root_model(archive: zipfile.ZipFile) -> str:
    """Name of the model that the archive's relationships name."""
    names = archive.namelist()
    if _RELATIONS in names:
        content = unpack_member(archive, archive.getinfo(_RELATIONS))
        for relation in parse_xml(content, _RELATIONS):
            if relation.get("Type", "").endswith("/3dmodel"):
                return relation.get("Target", "").lstrip("/")
    return next((name for name in names if name.lower() == _ROOT_MODEL.lower()), _ROOT_MODEL)


def _model(archive: zipfile.ZipFile, models: dict[str, _Model], path: str) -> _Model:
    if path not in models:
        if path not in archive.namelist():
            raise ValueError(f"it has no model {brief(path)}")
        models[path] = _Model(path, unpack_member(archive, archive.getinfo(path)))
    return models[path]


def _place(
    archive: zipfile.ZipFile,
    models: dict[str, _Model],
    model: _Model,
    reference: ElementTree.Element,
    T: NDArray[np.float64],
    builder: SurfaceBuilder,
    depth: int,
) -> None:
    """Add the object that an item or a component names, of this model or of another file."""
    builder.visit()
    path = next((value for key, value in reference.items() if key.endswith("}path")), None)
    if path is not None:  # the production extension
        model = _model(archive, models, posixpath.normpath(path).lstrip("/"))
    number = reference.get("objectid")
    entry = model.objects.get(number)
    if entry is None or depth > _MAX_DEPTH:
        reason = "does not exist" if entry is None else "contains itself"
        raise ValueError(f"{model.path}: the object {brief(number)} {reason}")
    T = product(T, _transform(reference.get("transform")))
    mesh = entry.find("{*}mesh")
    if mesh is not None:
        builder.add(model.mesh(number, mesh), T)
    for component in entry.iterfind("{*}components/{*}component"):
        _place(archive, models, model, component, T, builder, depth + 1)


def _transform(text: str | None) -> NDArray[np.float64]:
    """T (4, 4): the file has its columns, one after the other, without the last row."""
    T = np.eye(4)
    if text is not None:
        T[:3] = floats(text.split(), 12, "a transform").reshape(4, 3).T
    return T


def _mesh(element: ElementTree.Element) -> Surface:
    points = [
        vertex.get(axis, "")
        for vertex in element.iterfind("{*}vertices/{*}vertex")
        for axis in "xyz"
    ]
    corners = [
        triangle.get(corner, "")
        for triangle in element.iterfind("{*}triangles/{*}triangle")
        for corner in ("v1", "v2", "v3")
    ]
    surface = Surface(
        floats(points, len(points), "a vertex").reshape(-1, 3),
        integers(corners, len(corners), "a triangle").reshape(-1, 3),
    )
    check_faces(surface.faces, len(surface.vertices))
    return surface
