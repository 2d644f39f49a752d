"""A URDF as plain data: a tree of links with masses and triangles."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.extras import import_optional
from coopmap_env.geometry import rotation_about_axis

MOVABLE_JOINT_TYPES = ("revolute", "continuous", "prismatic")


@dataclass(frozen=True)
class UrdfJoint:
    """One joint: the child's frame in the parent's, and how a value moves it."""

    name: str
    joint_type: str
    parent: str
    child: str
    origin: NDArray[np.float64]
    """Shape (4, 4): T_parent_joint, the child's frame at value 0."""
    axis: NDArray[np.float64]
    lower: float
    upper: float
    mimic: tuple[str, float, float] | None = None
    """(joint, multiplier, offset): the value follows another joint's."""


@dataclass(frozen=True)
class UrdfLink:
    """One link: its mass and where its shapes are described."""

    name: str
    mass: float
    center_of_mass: NDArray[np.float64]
    """Shape (3,), in the link's frame."""
    inertia: NDArray[np.float64]
    """Shape (3, 3), about the center of mass, along the link's axes."""
    shapes: tuple[Any, ...] = field(repr=False)
    """Visual shapes, or where there are none the collision shapes, as parsed."""


@dataclass(frozen=True)
class UrdfModel:
    """The tree of a URDF: links and joints from the root outwards."""

    path: Path
    root: str
    links: dict[str, UrdfLink]
    joints: tuple[UrdfJoint, ...]
    """Parents before their children."""
    package_dirs: tuple[str, ...] = ()

    @classmethod
    def from_file(cls, path: str | Path, package_dirs: Sequence[str] = ()) -> UrdfModel:
        """Read a URDF.

        Parameters
        ----------
        path : path
        package_dirs : sequence of str, optional
            Folders in which ``package://name/...`` is searched.

        Raises
        ------
        FileNotFoundError
            If there is no such file.
        ValueError
            If the joints do not form one tree.
        """
        path = Path(path)
        if not path.is_file():
            raise FileNotFoundError(f"there is no URDF at {path}")
        yourdfpy = import_optional("yourdfpy", "field")
        parsed = yourdfpy.URDF.load(str(path), build_scene_graph=False, load_meshes=False).robot
        links = {link.name: _link(link) for link in parsed.links}
        joints = [_joint(joint) for joint in parsed.joints]
        root, ordered = _order_from_root(path, set(links), joints)
        return cls(path, root, links, ordered, tuple(package_dirs))

    def triangles(self, link: str) -> NDArray[np.float64]:
        """Triangles (m, 3, 3) of a link's shapes in its own frame, metres."""
        parts = [self._shape(shape) for shape in self.links[link].shapes]
        return np.concatenate(parts) if parts else np.zeros((0, 3, 3))

    def _shape(self, shape: Any) -> NDArray[np.float64]:
        creation = import_optional("trimesh.creation", "field")
        geometry = shape.geometry
        if geometry.box is not None:
            mesh = creation.box(extents=geometry.box.size)
        elif geometry.cylinder is not None:
            mesh = creation.cylinder(geometry.cylinder.radius, geometry.cylinder.length)
        elif geometry.sphere is not None:
            mesh = creation.icosphere(subdivisions=2, radius=geometry.sphere.radius)
        else:
            mesh = _load_mesh(resolve_mesh(geometry.mesh.filename, self.path, self.package_dirs))
            mesh.apply_scale(1.0 if geometry.mesh.scale is None else geometry.mesh.scale)
        if shape.origin is not None:
            mesh.apply_transform(shape.origin)
        return np.array(mesh.triangles, dtype=np.float64)


def resolve_mesh(filename: str, urdf: Path, package_dirs: Sequence[str] = ()) -> Path:
    """Path of a mesh that a URDF names.

    Raises
    ------
    FileNotFoundError
        Naming the folders searched.
    """
    name = filename.removeprefix("file://")
    relative_path = name.removeprefix("package://")
    folders = [urdf.parent, *map(Path, package_dirs)]
    if relative_path != name:  # with and without the package's own name, which may be the folder's
        paths = [folder / relative_path for folder in folders]
        paths += [folder / Path(*Path(relative_path).parts[1:]) for folder in folders]
    else:
        paths = [folder / name for folder in folders]
    for candidate in paths:
        if candidate.is_file():
            return candidate
    raise FileNotFoundError(
        f"{urdf} names the mesh {filename}, which is in none of {[str(f) for f in folders]}; "
        f"give the folder that holds it as package_dirs"
    )


def joint_transform(
    joint_type: str, axis: NDArray[np.float64], value: float
) -> NDArray[np.float64]:
    """T (4, 4) by which a joint's value moves its child; the identity for a fixed joint."""
    T = np.eye(4)
    if joint_type == "prismatic":
        T[:3, 3] = value * axis
    elif joint_type in MOVABLE_JOINT_TYPES:
        T[:3, :3] = rotation_about_axis(axis, value)
    return T


def _load_mesh(path: Path) -> Any:
    trimesh = import_optional("trimesh", "field")
    return trimesh.load(str(path), force="mesh")


def _link(link: Any) -> UrdfLink:
    inertial = link.inertial
    mass, inertia, frame = 0.0, np.zeros((3, 3)), np.eye(4)
    if inertial is not None:
        mass = float(inertial.mass or 0.0)
        frame = frame if inertial.origin is None else np.asarray(inertial.origin)
        if inertial.inertia is not None:
            inertia = frame[:3, :3] @ np.asarray(inertial.inertia) @ frame[:3, :3].T
    return UrdfLink(
        link.name, mass, frame[:3, 3].copy(), inertia, tuple(link.visuals or link.collisions)
    )


def _joint(joint: Any) -> UrdfJoint:
    origin = np.eye(4) if joint.origin is None else np.asarray(joint.origin, dtype=np.float64)
    lower, upper = -math.inf, math.inf
    if joint.limit is not None and joint.type != "continuous":
        lower = -math.inf if joint.limit.lower is None else float(joint.limit.lower)
        upper = math.inf if joint.limit.upper is None else float(joint.limit.upper)
    axis = np.array([1.0, 0.0, 0.0] if joint.axis is None else joint.axis, dtype=np.float64)
    if joint.type in MOVABLE_JOINT_TYPES:
        axis = axis / np.linalg.norm(axis)
    mimic = None
    if joint.mimic is not None:
        multiplier, offset = joint.mimic.multiplier, joint.mimic.offset
        mimic = (
            joint.mimic.joint,
            1.0 if multiplier is None else float(multiplier),
            0.0 if offset is None else float(offset),
        )
    return UrdfJoint(
        joint.name, joint.type, joint.parent, joint.child, origin, axis, lower, upper, mimic
    )


def _order_from_root(
    path: Path, links: set[str], joints: list[UrdfJoint]
) -> tuple[str, tuple[UrdfJoint, ...]]:
    """The root link, and the joints with parents before children."""
    roots = links - {joint.child for joint in joints}
    if len(roots) != 1:
        raise ValueError(f"{path} has {len(roots)} root links {sorted(roots)}, expected one")
    root = roots.pop()
    children: dict[str, list[UrdfJoint]] = {}
    for joint in joints:
        children.setdefault(joint.parent, []).append(joint)
    ordered: list[UrdfJoint] = []
    pending = [root]
    while pending:
        outgoing = children.get(pending.pop(), [])
        ordered += outgoing
        pending += [joint.child for joint in outgoing]
    if len(ordered) != len(joints):
        raise ValueError(f"{path}: the joints do not form one tree from the link {root!r}")
    return root, tuple(ordered)
