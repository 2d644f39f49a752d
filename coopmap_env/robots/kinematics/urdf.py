"""A URDF as plain data: a tree of links, and of joints of which some mimic others."""

from __future__ import annotations

import dataclasses
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.files import brief
from coopmap_env.core.linear_algebra import product
from coopmap_env.robots.kinematics.urdf_elements import (
    UrdfJoint,
    UrdfLink,
    UrdfShape,
    parse_joint,
    parse_link,
)
from coopmap_env.robots.kinematics.urdf_mimic import fix_all_but, resolve_mimics
from coopmap_env.robots.kinematics.urdf_shapes import shape_triangles
from coopmap_env.robots.kinematics.urdf_xml import (
    UrdfElement,
    UrdfError,
    check_expanded,
    read_robot,
)


@dataclass(frozen=True)
class UrdfModel:
    """The tree of a URDF: links and joints from the root outwards."""

    path: Path
    root: str
    links: dict[str, UrdfLink]
    joints: tuple[UrdfJoint, ...]
    """Parents before their children. Joints with equal limits are fixed there; a mimic joint
    names one that moves by itself, whatever stands between them, or is fixed."""
    package_dirs: tuple[str, ...] = ()

    @classmethod
    def from_file(cls, path: str | Path, package_dirs: Sequence[str] = ()) -> UrdfModel:
        """Read a URDF.

        Parameters
        ----------
        path : path
        package_dirs : sequence of str, optional
            Folders in which ``package://name/...`` is searched; see `resolve_mesh`.

        Raises
        ------
        UrdfNotFoundError
            If there is no such file; it is a FileNotFoundError as well.
        UrdfError
            A ValueError, naming the file and the element: if it is no XML or holds expressions of
            xacro, an element is missing or there twice, a number is none, a name is unknown or
            taken, the joints do not form one tree, or mimic each other in a circle.
        """
        path = Path(path)
        return cls.from_xml(read_robot(path), path, package_dirs)

    @classmethod
    def from_xml(cls, robot: ET.Element, path: Path, package_dirs: Sequence[str] = ()) -> UrdfModel:
        """The model of a ``<robot>``; `path` names it in errors. See `from_file`."""
        check_expanded(robot, path)
        links = {link.name: link for link in map(parse_link, _elements(robot, "link", path))}
        joints = [parse_joint(element) for element in _elements(robot, "joint", path)]
        _check_links_of_joints(joints, links, path)
        root, ordered = _order_from_root(path, links, joints)
        resolved = resolve_mimics(joints, path)
        return cls(
            path, root, links, tuple(resolved[joint.name] for joint in ordered), tuple(package_dirs)
        )

    def joint_values(self, values: Mapping[str, float] | None = None) -> dict[str, float]:
        """Values of all joints, from those that move by themselves; these are 0 if not given."""
        given = values or {}
        out = {}
        for joint in self.joints:
            source, multiplier, offset = joint.dependence
            out[joint.name] = multiplier * given.get(source, 0.0) + offset
        return out

    def link_poses(
        self, values: Mapping[str, float] | None = None
    ) -> dict[str, NDArray[np.float64]]:
        """T_root_link (4, 4) of every link, by name; see `joint_values`."""
        joint_values = self.joint_values(values)
        poses = {self.root: np.eye(4)}
        for joint in self.joints:
            poses[joint.child] = product(
                poses[joint.parent], joint.transform(joint_values[joint.name])
            )
        return poses

    def with_fixed_joints(
        self, moving: Sequence[str], values: Mapping[str, float] | None = None
    ) -> UrdfModel:
        """The model with all joints fixed but `moving` and those that mimic them.

        Parameters
        ----------
        moving : sequence of str
        values : mapping of str to float, optional
            Values of others; 0 if not given. Joints that mimic a fixed one follow it.

        Raises
        ------
        ValueError
            If a joint of `moving` does not move by itself, or one with a value moves, mimics one
            of another value, or has a value that is not finite.
        """
        joints = fix_all_but(self.joints, moving, values or {}, self.path)
        return dataclasses.replace(self, joints=joints)

    def triangles(self, link: str) -> NDArray[np.float64]:
        """Triangles (m, 3, 3) of a link's shapes in its own frame, metres."""
        parts = [self.shape_triangles(shape) for shape in self.links[link].shapes]
        return np.concatenate(parts) if parts else np.zeros((0, 3, 3))

    def shape_triangles(self, shape: UrdfShape) -> NDArray[np.float64]:
        """Triangles (m, 3, 3) of one shape in its link's frame, metres.

        Raises
        ------
        UrdfError
            If a mesh is missing or cannot be read.
        """
        return shape_triangles(shape, self.path, self.package_dirs)


def _elements(robot: ET.Element, tag: str, path: Path) -> Iterable[UrdfElement]:
    """The links or the joints.

    Raises
    ------
    UrdfError
        If one has no name, or that of another one.
    """
    names: set[str] = set()
    for number, xml in enumerate(robot.findall(tag), start=1):
        name = UrdfElement(xml, f"{path}: {tag} number {number}").name()
        element = UrdfElement(xml, f"{path}: {tag} {brief(name)}")
        if name in names:
            raise element.error(f"there are two {tag}s of this name")
        names.add(name)
        yield element


def _check_links_of_joints(
    joints: Sequence[UrdfJoint], links: Mapping[str, UrdfLink], path: Path
) -> None:
    """Check that joints join links that exist, and each link to one parent."""
    above: dict[str, str] = {}
    for joint in joints:
        for what, name in (("parent", joint.parent), ("child", joint.child)):
            if name not in links:
                raise UrdfError(f"{path}: joint {brief(joint.name)}: no link {brief(name)}, "
                                f"which is its {what}")  # fmt: skip
        if joint.child in above:
            raise UrdfError(
                f"{path}: link {brief(joint.child)} is the child of two joints, "
                f"{brief(above[joint.child])} and {brief(joint.name)}"
            )
        above[joint.child] = joint.name


def _order_from_root(
    path: Path, links: Mapping[str, UrdfLink], joints: Sequence[UrdfJoint]
) -> tuple[str, tuple[UrdfJoint, ...]]:
    """The root link, and the joints with parents before children."""
    inner = {joint.child for joint in joints}
    roots = [name for name in links if name not in inner]
    if len(roots) != 1:
        raise UrdfError(
            f"{path} has {len(roots)} root links {brief(sorted(roots))}, expected one "
            f"that is no joint's child"
        )
    children: dict[str, list[UrdfJoint]] = {}
    for joint in joints:
        children.setdefault(joint.parent, []).append(joint)
    ordered: list[UrdfJoint] = []
    pending = [roots[0]]
    while pending:
        outgoing = children.get(pending.pop(), [])
        ordered += outgoing
        pending += [joint.child for joint in outgoing]
    if len(ordered) != len(joints):
        reached = {joint.name for joint in ordered}
        apart = [joint.name for joint in joints if joint.name not in reached]
        raise UrdfError(
            f"{path}: the joints do not form one tree from the link {brief(roots[0])}: "
            f"{brief(apart)} form a circle"
        )
    return roots[0], tuple(ordered)
