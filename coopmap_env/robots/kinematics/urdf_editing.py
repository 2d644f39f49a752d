"""Edits of URDFs: links removed, joints fixed, trees joined, a vehicle put on a suspension."""

from __future__ import annotations

import copy
import hashlib
import math
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.files import private_folder, write_atomically
from coopmap_env.robots.kinematics.mesh_paths import resolve_mesh
from coopmap_env.robots.kinematics.urdf import UrdfModel
from coopmap_env.robots.kinematics.urdf_elements import parse_shape
from coopmap_env.robots.kinematics.urdf_xml import UrdfElement, read_robot, transform_from_xyz_rpy
from coopmap_env.robots.suspension import SUSPENSION_JOINTS

TINY_MASS, TINY_INERTIA = 1e-3, 1e-6
"""Mass and inertia of links without a mass: physics engines read a missing one as 1 kg, and zero as
fixed."""


def load_urdf_xml(
    path: str | Path, package_dirs: Sequence[str] = (), without_links: Iterable[str] = ()
) -> ET.Element:
    """A URDF as XML that any reader reads in the same way.

    It holds nothing but links and joints, absolute paths of meshes, no massless link, no shape
    without area, all limits, and rotations as roll, pitch and yaw.

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
    for element in list(tree):
        if element.tag not in ("link", "joint", "material"):
            tree.remove(element)
    for link in tree.findall("link"):
        _complete_link(link, path, package_dirs)
    for joint in tree.findall("joint"):
        _complete_joint(joint, path)
    return tree


def _complete_link(link: ET.Element, path: Path, package_dirs: Sequence[str]) -> None:
    for tag in ("visual", "collision"):
        for shape in link.findall(tag):
            _write_rotation_as_rpy(shape, path)
            if not parse_shape(UrdfElement(shape, str(path))).has_area:
                link.remove(shape)
    for mesh in link.iter("mesh"):
        found = resolve_mesh(mesh.get("filename", "").strip(), path, package_dirs)
        mesh.set("filename", str(found.resolve()))
    mass = link.find("inertial/mass")
    if mass is None or float(mass.get("value", "0")) <= 0.0:
        for inertial in link.findall("inertial"):
            link.remove(inertial)
        link.append(_tiny_inertial())
    for inertial in link.findall("inertial"):
        _write_rotation_as_rpy(inertial, path)


def _complete_joint(joint: ET.Element, path: Path) -> None:
    """Write the limits that the specification gives for missing ones; PyBullet takes others."""
    _write_rotation_as_rpy(joint, path)
    for limit in joint.findall("limit"):
        for name in ("lower", "upper"):
            if limit.get(name) is None:
                limit.set(name, "0")


def _write_rotation_as_rpy(element: ET.Element, path: Path) -> None:
    """Replace the quaternion of an element's origin, which only URDF 1.1 knows."""
    origin = element.find("origin")
    if origin is not None and origin.get("quat_xyzw") is not None:
        _set_origin(element, UrdfElement(element, str(path)).origin())


def remove_links(tree: ET.Element, links: Iterable[str]) -> None:
    """Remove links with all their descendants."""
    pending = list(links)
    while pending:
        name = pending.pop()
        for joint in tree.findall("joint"):
            parent, child = _parent_and_child(joint)
            if name in (parent, child):
                tree.remove(joint)
            if name == parent:
                pending.append(child)
        for link in tree.findall("link"):
            if link.get("name") == name:
                tree.remove(link)


def fix_joints(
    tree: ET.Element, moving: Sequence[str], values: Mapping[str, float], path: Path
) -> None:
    """Fix all joints but `moving` and those that mimic them, at given values or at 0.

    Joints that mimic fixed ones are fixed where they put them. Those that mimic others of `moving`
    through further joints mimic them at once from then on. `path` names the URDF in errors.

    Raises
    ------
    ValueError
        As `UrdfModel.with_fixed_joints`.
    """
    model = UrdfModel.from_xml(tree, path).with_fixed_joints(moving, values)
    joints = {joint.name: joint for joint in model.joints}
    for element in tree.findall("joint"):
        joint = joints[element.get("name", "")]
        if joint.joint_type != element.get("type"):
            _set_origin(element, joint.origin)
            element.set("type", "fixed")
            _remove_children(
                element, "axis", "limit", "mimic", "dynamics", "safety_controller", "calibration"
            )
        elif joint.mimic is not None:
            _remove_children(element, "mimic")
            source, multiplier, offset = joint.mimic
            ET.SubElement(
                element, "mimic", joint=source, multiplier=repr(multiplier), offset=repr(offset)
            )


def _remove_children(element: ET.Element, *tags: str) -> None:
    for tag in tags:
        for child in element.findall(tag):
            element.remove(child)


def attach_tree(
    tree: ET.Element, other: ET.Element, link: str, T_link_root: NDArray[np.float64]
) -> None:
    """Fix the root of another tree to a link of this one.

    Raises
    ------
    ValueError
        If both have a link or joint of the same name.
    """
    existing = {(e.tag, e.get("name")) for e in tree if e.tag != "material"}
    duplicates = [e.get("name") for e in other if (e.tag, e.get("name")) in existing]
    if duplicates:
        raise ValueError(f"both URDFs have {duplicates}")
    joint = _fixed_joint(f"{link}_to_{root_link(other)}", link, root_link(other), T_link_root)
    tree.extend([*copy.deepcopy(list(other)), joint])


def add_suspension(
    tree: ET.Element,
    roll_center_height: float,
    root_height: float = 0.0,
    wheels: Iterable[str] = (),
) -> None:
    """Put heave, roll and pitch between a new root "base", on the ground, and the old root.

    Parameters
    ----------
    tree : Element
        Changed in place.
    roll_center_height : float
        Of the axes of roll and pitch above ground, metres.
    root_height : float
        Of the old root above ground at rest, metres.
    wheels : iterable of str
        Links that stay on the ground with all their descendants.
    """
    old_root = root_link(tree)
    names = {element.get("name") for element in tree.findall("link")}
    base = "base" if "base" not in names else "ground_base"
    for wheel in wheels:
        _attach_wheel_to_base(tree, wheel, old_root, base, root_height)
    body = "suspension_body"
    links = [base, "suspension_heave_link", "suspension_roll_link", body]
    for name in links:
        link = ET.SubElement(tree, "link", name=name)
        link.append(_tiny_inertial())
    kinds = (("prismatic", "0 0 1", 0.1), ("revolute", "1 0 0", 0.3), ("revolute", "0 1 0", 0.3))
    for i, (name, (kind, axis, travel)) in enumerate(zip(SUSPENSION_JOINTS, kinds, strict=True)):
        joint = _fixed_joint(
            name,
            links[i],
            links[i + 1],
            transform_from_xyz_rpy((0, 0, 0 if i else roll_center_height)),
        )
        joint.set("type", kind)
        ET.SubElement(joint, "axis", xyz=axis)
        limit = {"lower": str(-travel), "upper": str(travel), "effort": "1e5", "velocity": "10"}
        ET.SubElement(joint, "limit", limit)
        tree.append(joint)
    lift = transform_from_xyz_rpy((0, 0, root_height - roll_center_height))
    tree.append(_fixed_joint("suspension_to_vehicle", body, old_root, lift))


def _attach_wheel_to_base(
    tree: ET.Element, wheel: str, root: str, base: str, root_height: float
) -> None:
    """Attach a wheel to the ground-fixed base instead of the body."""
    above = {_parent_and_child(joint)[1]: joint for joint in tree.findall("joint")}
    if wheel not in above:
        raise ValueError(f"there is no wheel {wheel!r} below the root; there are {sorted(above)}")
    T, link = np.eye(4), wheel
    while link != root:
        T = _origin(above[link]) @ T
        link = _parent_and_child(above[link])[0]
    joint = above[wheel]
    tree.remove(joint)
    tree.append(
        _fixed_joint(
            joint.get("name", ""), base, wheel, transform_from_xyz_rpy((0, 0, root_height)) @ T
        )
    )


def write_urdf_cached(tree: ET.Element, name: str) -> Path:
    """Write a URDF to a file named by its content, in this user's folder for temporary files.

    Several processes may do so at once: the file appears whole or not at all.
    """
    text = ET.tostring(tree, encoding="utf-8", xml_declaration=True)
    path = private_folder() / f"{name}-{hashlib.sha256(text).hexdigest()[:16]}.urdf"
    if not (path.is_file() and path.read_bytes() == text):
        write_atomically(path, text)
    return path


def root_link(tree: ET.Element) -> str:
    """Name of the link that is no joint's child."""
    children = {_parent_and_child(joint)[1] for joint in tree.findall("joint")}
    roots = [link.get("name", "") for link in tree.findall("link")]
    roots = [name for name in roots if name not in children]
    if len(roots) != 1:
        raise ValueError(f"a URDF needs one root link, got {roots}")
    return roots[0]


def _origin(joint: ET.Element) -> NDArray[np.float64]:
    return UrdfElement(joint, f"joint {joint.get('name')!r}").origin()


def _set_origin(joint: ET.Element, T: NDArray[np.float64]) -> None:
    _remove_children(joint, "origin")
    level = math.hypot(T[0, 0], T[1, 0])
    if level > 1e-9:
        roll, yaw = math.atan2(T[2, 1], T[2, 2]), math.atan2(T[1, 0], T[0, 0])
    else:  # straight up or down: roll and yaw are one turn
        roll, yaw = math.atan2(-T[1, 2], T[1, 1]), 0.0
    rpy = (roll, math.atan2(-T[2, 0], level), yaw)
    # repr keeps all digits, so that reading it back changes nothing
    texts = [" ".join(repr(float(v)) for v in values) for values in (T[:3, 3], rpy)]
    ET.SubElement(joint, "origin", xyz=texts[0], rpy=texts[1])


def _parent_and_child(joint: ET.Element) -> tuple[str, str]:
    parent, child = joint.find("parent"), joint.find("child")
    if parent is None or child is None:
        raise ValueError(f"the joint {joint.get('name')!r} lacks its parent or child")
    return parent.get("link", ""), child.get("link", "")


def _fixed_joint(name: str, parent: str, child: str, T: NDArray[np.float64]) -> ET.Element:
    joint = ET.Element("joint", name=name, type="fixed")
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)
    _set_origin(joint, T)
    return joint


def _tiny_inertial() -> ET.Element:
    inertial = ET.Element("inertial")
    ET.SubElement(inertial, "mass", value=str(TINY_MASS))
    moments = {f"i{a}{b}": "0" for a, b in ("xy", "xz", "yz")}
    moments |= {f"i{a}{a}": str(TINY_INERTIA) for a in "xyz"}
    ET.SubElement(inertial, "inertia", moments)
    return inertial
