"""Edits of URDFs: joints fixed, trees joined, a vehicle put on a suspension."""

from __future__ import annotations

import copy
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.linear_algebra import product
from coopmap_env.robots.kinematics.urdf import UrdfModel
from coopmap_env.robots.kinematics.urdf_loading import (
    parent_and_child,
    read_origin,
    remove_children,
    tiny_inertial,
    write_origin,
)
from coopmap_env.robots.kinematics.urdf_xml import transform_from_xyz_rpy
from coopmap_env.robots.suspension import SUSPENSION_JOINTS


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
            write_origin(element, joint.origin)
            element.set("type", "fixed")
            remove_children(
                element, "axis", "limit", "mimic", "dynamics", "safety_controller", "calibration"
            )
        elif joint.mimic is not None:
            remove_children(element, "mimic")
            source, multiplier, offset = joint.mimic
            ET.SubElement(
                element, "mimic", joint=source, multiplier=repr(multiplier), offset=repr(offset)
            )


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

    Raises
    ------
    ValueError
        If names of the suspension are taken, or a wheel is no link below the root or moved by a
        joint.
    """
    old_root = root_link(tree)
    names = {element.get("name") for element in tree.findall("link")}
    base = "base" if "base" not in names else "ground_base"
    links = [base, "suspension_heave_link", "suspension_roll_link", "suspension_body"]
    joints = [*SUSPENSION_JOINTS, "suspension_to_vehicle"]
    taken = names.intersection(links)
    taken |= {element.get("name") for element in tree.findall("joint")}.intersection(joints)
    if taken:
        raise ValueError(
            f"the URDF has {sorted(map(str, taken))} already: names that its suspension gets"
        )
    for wheel in wheels:
        _attach_wheel_to_base(tree, wheel, old_root, base, root_height)
    for name in links:
        link = ET.SubElement(tree, "link", name=name)
        link.append(tiny_inertial())
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
    tree.append(_fixed_joint(joints[-1], links[-1], old_root, lift))


def _attach_wheel_to_base(
    tree: ET.Element, wheel: str, root: str, base: str, root_height: float
) -> None:
    """Attach a wheel to the ground-fixed base instead of the body."""
    above = {parent_and_child(joint)[1]: joint for joint in tree.findall("joint")}
    if wheel not in above:
        raise ValueError(f"there is no wheel {wheel!r} below the root; there are {sorted(above)}")
    T, link = np.eye(4), wheel
    while link != root:
        if link == base:  # below another wheel, with which it stays
            return
        joint = above[link]
        if joint.get("type") != "fixed":
            raise ValueError(
                f"the joint {joint.get('name')!r} moves the wheel {wheel!r}, which is to stay on "
                "the ground"
            )
        T = product(read_origin(joint), T)
        link = parent_and_child(joint)[0]
    joint = above[wheel]
    tree.remove(joint)
    tree.append(
        _fixed_joint(
            joint.get("name", ""),
            base,
            wheel,
            product(transform_from_xyz_rpy((0, 0, root_height)), T),
        )
    )


def root_link(tree: ET.Element) -> str:
    """Name of the link that is no joint's child."""
    children = {parent_and_child(joint)[1] for joint in tree.findall("joint")}
    roots = [link.get("name", "") for link in tree.findall("link")]
    roots = [name for name in roots if name not in children]
    if len(roots) != 1:
        raise ValueError(f"a URDF needs one root link, got {roots}")
    return roots[0]


def _fixed_joint(name: str, parent: str, child: str, T: NDArray[np.float64]) -> ET.Element:
    joint = ET.Element("joint", name=name, type="fixed")
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)
    write_origin(joint, T)
    return joint
