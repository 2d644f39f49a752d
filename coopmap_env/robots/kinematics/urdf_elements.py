"""Links, joints and shapes of a URDF as plain data."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.files import brief
from coopmap_env.core.linear_algebra import length, product
from coopmap_env.geometry import rotation_about_axis
from coopmap_env.robots.kinematics.urdf_xml import MIN_LENGTH, UrdfElement

MOVABLE_JOINT_TYPES = ("revolute", "continuous", "prismatic")
JOINT_TYPES = (*MOVABLE_JOINT_TYPES, "fixed", "planar", "floating", "spherical")
"""Those of the specification, and PyBullet's "spherical"."""
SHAPES = ("box", "cylinder", "sphere", "capsule", "mesh")
UNLIMITED = 1e9
"""Limits from here on are none: Gazebo writes 1e16."""
NEGATIVE_INERTIA = -1e-12
"""kg m^2: what is above is zero but for rounding."""


class Mimic(NamedTuple):
    """The value of a joint is ``multiplier`` times that of another one, plus ``offset``."""

    joint: str
    multiplier: float
    offset: float


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
    """Radians or metres; -inf where there is none."""
    upper: float
    max_speed: float = math.inf
    """Radians or metres a second; inf where none is stated, or 0 is."""
    mimic: Mimic | None = None

    def transform(self, value: float) -> NDArray[np.float64]:
        """T_parent_child (4, 4) at a value, radians or metres."""
        return product(self.origin, joint_transform(self.joint_type, self.axis, value))

    def fixed_at(self, value: float) -> UrdfJoint:
        """The joint fixed at a value, which stays in `lower` and `upper`."""
        return replace(
            self, joint_type="fixed", origin=self.transform(value), lower=value, upper=value,
            mimic=None,
        )  # fmt: skip

    @property
    def dependence(self) -> Mimic:
        """The joint that decides the value of this one, itself if it moves, and how.

        A fixed joint has the multiplier 0.
        """
        if self.mimic is not None:
            return self.mimic
        if self.joint_type in MOVABLE_JOINT_TYPES:
            return Mimic(self.name, 1.0, 0.0)
        return Mimic(self.name, 0.0, self.lower if self.lower == self.upper else 0.0)


@dataclass(frozen=True)
class UrdfShape:
    """A box, cylinder, sphere, capsule or mesh; its size is empty for a mesh."""

    kind: str
    origin: NDArray[np.float64]
    """Shape (4, 4): T_link_shape."""
    size: tuple[float, ...] = ()
    """Metres: sides of a box; radius, then length along z, of the others. A capsule's length is
    that of its cylinder, between its half spheres."""
    filename: str = ""
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)

    @property
    def has_area(self) -> bool:
        """Whether it has a surface at all: not more than one side of it is zero."""
        if self.kind == "mesh":
            return sum(factor == 0.0 for factor in self.scale) < 2
        if self.kind == "box":
            return sum(side == 0.0 for side in self.size) < 2
        return self.size[0] > 0.0


@dataclass(frozen=True)
class UrdfLink:
    """One link: its mass and its shapes."""

    name: str
    mass: float
    center_of_mass: NDArray[np.float64]
    """Shape (3,), in the link's frame."""
    inertia: NDArray[np.float64]
    """Shape (3, 3), about the center of mass, along the link's axes."""
    visuals: tuple[UrdfShape, ...] = field(repr=False)
    """Shapes without area are left out, here and in `collisions`."""
    collisions: tuple[UrdfShape, ...] = field(repr=False)

    @property
    def shapes(self) -> tuple[UrdfShape, ...]:
        """Visual shapes, or where there are none the collision shapes."""
        return self.visuals or self.collisions


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


def parse_link(element: UrdfElement) -> UrdfLink:
    """A ``<link>``.

    Raises
    ------
    UrdfError
        If a mass, inertia or shape is missing or none.
    """
    mass, center, inertia = 0.0, np.zeros(3), np.zeros((3, 3))
    inertial = element.find_child("inertial")
    if inertial is not None:
        frame = inertial.origin()
        center = frame[:3, 3].copy()
        mass = inertial.child("mass").size("value")
        tensor = inertial.find_child("inertia")
        if tensor is not None:
            inertia = product(product(frame[:3, :3], _inertia(tensor)), frame[:3, :3].T)
        elif mass > 0.0:
            raise inertial.error("it has a mass, but no <inertia>")
    return UrdfLink(
        element.name(),
        mass,
        center,
        inertia,
        visuals=tuple(filter(_has_area, map(parse_shape, element.children("visual")))),
        collisions=tuple(filter(_has_area, map(parse_shape, element.children("collision")))),
    )


def _has_area(shape: UrdfShape) -> bool:
    return shape.has_area


def _inertia(element: UrdfElement) -> NDArray[np.float64]:
    xx, xy, xz, yy, yz, zz = (
        element.number(name) for name in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    )
    for name, moment in (("ixx", xx), ("iyy", yy), ("izz", zz)):
        if moment < NEGATIVE_INERTIA:
            raise element.error(f"{name}={moment:g}, expected a number >= 0")
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def parse_shape(element: UrdfElement) -> UrdfShape:
    """A ``<visual>`` or ``<collision>``.

    Raises
    ------
    UrdfError
        If its geometry is none of `SHAPES`, or a size is missing or negative.
    """
    geometry = element.child("geometry")
    found = [shape for kind in SHAPES for shape in geometry.children(kind)]
    if len(found) != 1:
        tags = [child.tag for child in geometry.xml]
        raise geometry.error(f"expected one of {list(SHAPES)}, not {brief(tags)}")
    shape, kind, origin = found[0], found[0].xml.tag, element.origin()
    if kind == "mesh":
        return UrdfShape(kind, origin, filename=shape.text("filename"), scale=_mesh_scale(shape))
    if kind == "box":
        sides = shape.vector("size")
        if (sides < 0.0).any():
            raise shape.error(f"size={brief(shape.text('size'))}, expected numbers >= 0")
        return UrdfShape(kind, origin, tuple(sides.tolist()))
    sizes = ("radius",) if kind == "sphere" else ("radius", "length")
    return UrdfShape(kind, origin, tuple(shape.size(name) for name in sizes))


def _mesh_scale(mesh: UrdfElement) -> tuple[float, float, float]:
    """Factors along the axes; one number stands for three."""
    if len(mesh.xml.get("scale", "").split()) == 1:
        return (mesh.number("scale"),) * 3
    x, y, z = mesh.vector("scale", (1.0, 1.0, 1.0)).tolist()
    return x, y, z


def parse_joint(element: UrdfElement) -> UrdfJoint:
    """A ``<joint>``; one with equal limits is fixed there, unless it mimics another one.

    Raises
    ------
    UrdfError
        If its type is unknown, an axis has no direction, limits are missing or the wrong way round.
    """
    joint_type = element.text("type")
    if joint_type not in JOINT_TYPES:
        raise element.error(f"type={brief(joint_type)}, expected one of {list(JOINT_TYPES)}")
    name, origin = element.name(), element.origin()
    parent, child = (element.child(tag).name("link") for tag in ("parent", "child"))
    axis, limits, mimic = np.array([1.0, 0.0, 0.0]), JointLimits(), None
    if joint_type in MOVABLE_JOINT_TYPES:
        axis, mimic = _axis(element), _mimic(element)
        limits = _limits(element, joint_type)
        check_dynamics(element)
    return UrdfJoint(name, joint_type, parent, child, origin, axis, *limits, mimic)


def _axis(joint: UrdfElement) -> NDArray[np.float64]:
    element = joint.find_child("axis")
    if element is None:
        return np.array([1.0, 0.0, 0.0])
    axis = element.vector("xyz", (1.0, 0.0, 0.0))
    norm = length(axis)
    if norm < MIN_LENGTH:
        raise element.error(f"xyz={brief(element.text('xyz'))} has no direction")
    return np.asarray(axis / norm)


class JointLimits(NamedTuple):
    """What bounds the values of a joint, and how fast they change."""

    lower: float = -math.inf
    upper: float = math.inf
    max_speed: float = math.inf


def _limits(joint: UrdfElement, joint_type: str) -> JointLimits:
    """Lower and upper limit: a missing one is 0; a speed of 0 says that none is stated."""
    element = joint.find_child("limit")
    if element is None:
        if joint_type == "continuous":
            return JointLimits()
        raise joint.error(f"its <limit> is missing, which a {joint_type} joint needs")
    limits = {
        name: 0.0 if element.xml.get(name) is None else element.numbers(name, 1)[0]
        for name in ("lower", "upper", "effort", "velocity")
    }
    max_speed = abs(limits["velocity"]) or math.inf
    if joint_type == "continuous":
        return JointLimits(max_speed=max_speed)
    lower, upper = limits["lower"], limits["upper"]
    if lower > upper:
        raise element.error(f"lower={lower:g} is above upper={upper:g}")
    return JointLimits(
        -math.inf if lower <= -UNLIMITED else lower,
        math.inf if upper >= UNLIMITED else upper,
        max_speed,
    )


def _mimic(joint: UrdfElement) -> Mimic | None:
    element = joint.find_child("mimic")
    if element is None:
        return None
    return Mimic(
        element.name("joint"), element.number("multiplier", 1.0), element.number("offset", 0.0)
    )


def check_dynamics(joint: UrdfElement) -> None:
    """Check what only physics engines read: damping and friction.

    Raises
    ------
    UrdfError
        If one is no finite number.
    """
    dynamics = joint.find_child("dynamics")
    for name in ("damping", "friction"):
        if dynamics is not None:
            dynamics.number(name, 0.0)
