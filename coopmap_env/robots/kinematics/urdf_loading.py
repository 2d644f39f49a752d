"""URDFs as XML that PyBullet reads as we do: loaded, and written to files named by content."""

from __future__ import annotations

import hashlib
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.elementary import atan2
from coopmap_env.core.files import private_folder, read_bytes, write_atomically
from coopmap_env.core.linear_algebra import length
from coopmap_env.geometry.mesh_files import read_mesh
from coopmap_env.geometry.mesh_formats.stl import is_exact_binary_stl
from coopmap_env.robots.kinematics.mesh_paths import resolve_mesh
from coopmap_env.robots.kinematics.urdf import UrdfModel
from coopmap_env.robots.kinematics.urdf_elements import (
    MOVABLE_JOINT_TYPES,
    parse_joint,
    parse_shape,
)
from coopmap_env.robots.kinematics.urdf_xml import UrdfElement, UrdfError, read_robot

TINY_MASS, TINY_INERTIA = 1e-3, 1e-6
"""Mass and inertia of links without a mass: physics engines read a missing one as 1 kg, and zero as
fixed."""
MAX_STEM = 50
"""Characters of a file's name that are kept in the name of its copy."""
LINK_PARTS = ("inertial", "visual", "collision", "contact")
"""What is read of a link; "contact" is PyBullet's."""
SHAPE_PARTS = ("origin", "geometry")
"""What is read of a visual or collision shape."""
JOINT_PARTS = ("parent", "child", "origin", "axis", "limit", "mimic", "dynamics")
"""What is read of a joint."""
MAX_LINE = 8000
"""Characters. PyBullet breaks longer lines, within numbers too."""


def load_urdf_xml(
    path: str | Path, package_dirs: Sequence[str] = (), without_links: Iterable[str] = ()
) -> ET.Element:
    """A URDF as XML that PyBullet reads as we do.

    It holds nothing but links and joints, absolute paths of meshes in formats that PyBullet knows,
    no massless link, no shape without area, all limits, axes of length 1, and rotations as roll,
    pitch and yaw.

    Parameters
    ----------
    path : path
    package_dirs : sequence of str, optional
        Folders in which ``package://`` meshes are searched.
    without_links : iterable of str, optional
        Links that are removed with all their descendants before anything is checked.

    Raises
    ------
    UrdfNotFoundError
        If the URDF or one of its meshes does not exist; it is a FileNotFoundError as well.
    UrdfError
        If it cannot be read; see `UrdfModel.from_file`.
    """
    path = Path(path)
    tree = read_robot(path)
    remove_links(tree, without_links)
    UrdfModel.from_xml(tree, path)
    _remove_other_elements(tree)
    _complete(tree, path, package_dirs)
    return tree


def urdf_for_physics(path: Path, package_dirs: Sequence[str] = ()) -> Path:
    """The file that PyBullet loads: a URDF itself, or a copy if `load_urdf_xml` completes it."""
    tree = read_robot(path)
    UrdfModel.from_xml(tree, path)
    _remove_other_elements(tree)
    before = ET.tostring(tree)
    _complete(tree, path, package_dirs)
    longest = max(map(len, read_bytes(path, UrdfError).splitlines()), default=0)
    if ET.tostring(tree) == before and longest < MAX_LINE:
        return path
    return write_urdf_cached(tree, path.stem[:MAX_STEM])


def write_urdf_cached(tree: ET.Element, name: str) -> Path:
    """Write a URDF to a file named by its content, in this user's folder for temporary files.

    Several processes may do so at once: the file appears whole or not at all.
    """
    ET.indent(tree)
    return _write_cached(ET.tostring(tree, encoding="utf-8", xml_declaration=True), name, ".urdf")


def _write_cached(content: bytes, name: str, suffix: str) -> Path:
    path = private_folder() / f"{name}-{hashlib.sha256(content).hexdigest()[:16]}{suffix}"
    if not (path.is_file() and path.read_bytes() == content):
        write_atomically(path, content)
    return path


def remove_links(tree: ET.Element, links: Iterable[str]) -> None:
    """Remove links with all their descendants."""
    below: dict[str, list[str]] = {}
    for joint in tree.findall("joint"):
        parent, child = parent_and_child(joint)
        below.setdefault(parent, []).append(child)
    removed: set[str] = set()
    pending = list(links)
    while pending:
        name = pending.pop()
        if name not in removed:
            removed.add(name)
            pending += below.get(name, [])
    for element in list(tree):
        names = parent_and_child(element) if element.tag == "joint" else (element.get("name", ""),)
        if element.tag in ("link", "joint") and removed.intersection(names):
            tree.remove(element)


def _remove_other_elements(tree: ET.Element) -> None:
    """Remove all that is neither read here nor needed by PyBullet, which some of it would stop."""
    _keep_children(tree, "link", "joint")
    for joint in tree.findall("joint"):
        _keep_children(joint, *JOINT_PARTS)
    for link in tree.findall("link"):
        _keep_children(link, *LINK_PARTS)
        for shape in (*link.findall("visual"), *link.findall("collision")):
            _keep_children(shape, *SHAPE_PARTS)


def _keep_children(element: ET.Element, *tags: str) -> None:
    for child in list(element):
        if child.tag not in tags:
            element.remove(child)


def _complete(tree: ET.Element, path: Path, package_dirs: Sequence[str]) -> None:
    meshes: dict[str, str] = {}
    for link in tree.findall("link"):
        _complete_link(link, path)
        for mesh in link.iter("mesh"):
            name = mesh.get("filename", "").strip()
            if name not in meshes:
                found = resolve_mesh(name, path, package_dirs).resolve()
                meshes[name] = str(_mesh_for_physics(found))
            mesh.set("filename", meshes[name])
    for joint in tree.findall("joint"):
        _complete_joint(joint, path)


def _complete_link(link: ET.Element, path: Path) -> None:
    for tag in ("visual", "collision"):
        for shape in link.findall(tag):
            _write_rotation_as_rpy(shape, path)
            parsed = parse_shape(UrdfElement(shape, str(path)))
            if not parsed.has_area:
                link.remove(shape)
            for mesh in shape.iter("mesh"):
                if mesh.get("scale") is not None:
                    mesh.set("scale", " ".join(map(repr, parsed.scale)))
    mass = link.find("inertial/mass")
    if mass is None or float(mass.get("value", "0")) <= 0.0:
        remove_children(link, "inertial")
        link.append(tiny_inertial())
    for inertial in link.findall("inertial"):
        _write_rotation_as_rpy(inertial, path)
    for contact in link.findall("contact"):
        for parameter in contact:
            UrdfElement(parameter, f"{path}: link {link.get('name')!r}, <contact>").number(
                "value", 0
            )


def _complete_joint(joint: ET.Element, path: Path) -> None:
    """Write the limits and axes that the specification means; PyBullet's are others."""
    _write_rotation_as_rpy(joint, path)
    for limit in joint.findall("limit"):
        for name in ("lower", "upper"):
            if limit.get(name) is None:
                limit.set(name, "0")
    parsed = parse_joint(UrdfElement(joint, str(path)))
    if parsed.joint_type in MOVABLE_JOINT_TYPES:
        element = joint.find("axis")
        text = "" if element is None else element.get("xyz", "")
        if tuple(map(float, text.split())) != tuple(parsed.axis):
            remove_children(joint, "axis")
            ET.SubElement(joint, "axis", xyz=" ".join(map(repr, parsed.axis.tolist())))


def _mesh_for_physics(file: Path) -> Path:
    """A mesh, or a copy that PyBullet reads as we do."""
    status = file.stat()
    key = file, status.st_mtime_ns, status.st_size
    path = _checked_mesh(*key)
    if not path.is_file():  # folders for temporary files are swept
        _checked_mesh.cache_clear()
        path = _checked_mesh(*key)
    return path


@lru_cache(maxsize=256)
def _checked_mesh(file: Path, _modified_ns: int, _size: int) -> Path:
    """A mesh that we can read, or a copy of it.

    PyBullet reads memory that is not its own where a face names a vertex that does not exist, takes
    NaN as a corner, and crashes at some COLLADA files, of which it reads nothing but triangles.
    """
    mesh = read_mesh(file, UrdfError, in_urdf=True)
    suffix = file.suffix.lower()
    if suffix == ".obj" or (suffix == ".stl" and is_exact_binary_stl(read_bytes(file, UrdfError))):
        return file
    rows = [f"v {x!r} {y!r} {z!r}\n" for x, y, z in mesh.vertices.tolist()]
    rows += [f"f {a} {b} {c}\n" for a, b, c in (mesh.faces + 1).tolist()]
    return _write_cached("".join(rows).encode(), file.stem[:MAX_STEM], ".obj")


def _write_rotation_as_rpy(element: ET.Element, path: Path) -> None:
    """Replace the quaternion of an element's origin, which only URDF 1.1 knows."""
    origin = element.find("origin")
    if origin is not None and origin.get("quat_xyzw") is not None:
        write_origin(element, UrdfElement(element, str(path)).origin())


def parent_and_child(joint: ET.Element) -> tuple[str, str]:
    """Names of the links that a joint joins; empty where one is missing."""
    parent, child = joint.find("parent"), joint.find("child")
    return (
        "" if parent is None else parent.get("link", ""),
        "" if child is None else child.get("link", ""),
    )


def read_origin(joint: ET.Element) -> NDArray[np.float64]:
    """T (4, 4) of a joint's origin."""
    return UrdfElement(joint, f"joint {joint.get('name')!r}").origin()


def write_origin(joint: ET.Element, T: NDArray[np.float64]) -> None:
    """Replace the origin of a joint or shape by T (4, 4)."""
    remove_children(joint, "origin")
    level = length(T[:2, 0])
    if level > 1e-9:
        roll, yaw = atan2(T[2, 1], T[2, 2]), atan2(T[1, 0], T[0, 0])
    else:  # straight up or down: roll and yaw are one turn
        roll, yaw = atan2(-T[1, 2], T[1, 1]), 0.0
    rpy = (roll, atan2(-T[2, 0], level), yaw)
    # repr keeps all digits, so that reading it back changes nothing
    texts = [" ".join(repr(float(v)) for v in values) for values in (T[:3, 3], rpy)]
    ET.SubElement(joint, "origin", xyz=texts[0], rpy=texts[1])


def remove_children(element: ET.Element, *tags: str) -> None:
    """Remove all children of some tags."""
    for tag in tags:
        for child in element.findall(tag):
            element.remove(child)


def tiny_inertial() -> ET.Element:
    """The ``<inertial>`` of a link without a mass."""
    inertial = ET.Element("inertial")
    ET.SubElement(inertial, "mass", value=str(TINY_MASS))
    moments = {f"i{a}{b}": "0" for a, b in ("xy", "xz", "yz")}
    moments |= {f"i{a}{a}": str(TINY_INERTIA) for a in "xyz"}
    ET.SubElement(inertial, "inertia", moments)
    return inertial
