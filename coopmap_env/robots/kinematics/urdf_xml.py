"""Elements of a URDF, read strictly: numbers, vectors and frames; errors name the place."""

from __future__ import annotations

import math
import os
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.elementary import sin_cos
from coopmap_env.core.files import FileError, brief
from coopmap_env.core.linear_algebra import length
from coopmap_env.core.xml_files import read_xml
from coopmap_env.geometry import rotation_from_quaternion

NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", re.ASCII)
MAX_NUMBER = 1e12
"""Of any length, mass or inertia: products of such numbers are still finite."""
MIN_LENGTH = 1e-6
"""Of an axis or a quaternion: below, it has no direction."""
MAX_NAME = 255
"""Characters of a name. PyBullet cuts longer ones than 1023."""
MAX_DEPTH = 50
"""Elements inside of each other; a URDF needs 6."""


class UrdfError(FileError):
    """A URDF that cannot be read; the message names the file, the element and what was expected."""


class UrdfNotFoundError(UrdfError, FileNotFoundError):
    """A URDF, or a mesh that it names, that is not there."""


@dataclass(frozen=True)
class UrdfElement:
    """An element of a URDF and where it stands."""

    xml: ET.Element
    where: str
    """For errors: the file, and the names of the link or joint and of the element."""

    def error(self, problem: str) -> UrdfError:
        """The error that something is wrong with this element."""
        return UrdfError(f"{self.where}: {problem}")

    def children(self, tag: str) -> Iterator[UrdfElement]:
        """All children of a tag."""
        for element in self.xml.findall(tag):
            yield UrdfElement(element, f"{self.where}, <{tag}>")

    def find_child(self, tag: str) -> UrdfElement | None:
        """The child of a tag that may be there once, or again with the same attributes.

        Raises
        ------
        UrdfError
            If there are several others.
        """
        found = list(self.children(tag))
        if any(len(one.xml) or one.xml.attrib != found[0].xml.attrib for one in found[1:]):
            raise self.error(f"it has {len(found)} elements <{tag}>, expected one")
        return found[0] if found else None

    def child(self, tag: str) -> UrdfElement:
        """The child of a tag that must be there once.

        Raises
        ------
        UrdfError
            If there is none, or several.
        """
        found = self.find_child(tag)
        if found is None:
            raise self.error(f"its <{tag}> is missing")
        return found

    def text(self, attribute: str) -> str:
        """An attribute that must be there.

        Raises
        ------
        UrdfError
            If it is missing or empty.
        """
        value = self.xml.get(attribute, "")
        if not value.strip():
            raise self.error(f"its {attribute} is missing")
        return value

    def name(self, attribute: str = "name") -> str:
        """A name, exactly as it stands there.

        Raises
        ------
        UrdfError
            If it is missing, empty or longer than `MAX_NAME`.
        """
        value = self.text(attribute)
        if len(value) > MAX_NAME:
            raise self.error(
                f"its {attribute} {brief(value)} has {len(value)} characters, "
                f"expected {MAX_NAME} at most"
            )
        return value

    def numbers(self, attribute: str, count: int) -> tuple[float, ...]:
        """Numbers of an attribute, separated by spaces.

        Raises
        ------
        UrdfError
            If there are not `count` of them, or one is no finite number.
        """
        text = self.text(attribute)
        parts = text.split()
        if not all(NUMBER.fullmatch(part) for part in parts) or len(parts) != count:
            hint = "; commas cannot stand in it" if "," in text else ""
            expected = "a number" if count == 1 else f"{count} numbers separated by spaces"
            raise self.error(f"{attribute}={brief(text)}, expected {expected}{hint}")
        values = tuple(float(part) for part in parts)
        if not all(math.isfinite(value) for value in values):
            raise self.error(f"{attribute}={brief(text)} is not finite")
        return values

    def vector(
        self, attribute: str, default: tuple[float, ...] | None = None, count: int = 3
    ) -> NDArray[np.float64]:
        """Numbers of an attribute, as `numbers`; the default if it is missing.

        Raises
        ------
        UrdfError
            Also if one is larger than `MAX_NUMBER`.
        """
        if default is not None and self.xml.get(attribute) is None:
            return np.array(default)
        values = self.numbers(attribute, count)
        self._check_size(attribute, values)
        return np.array(values)

    def number(self, attribute: str, default: float | None = None) -> float:
        """One number, as `numbers`; the default if it is missing.

        Raises
        ------
        UrdfError
            Also if it is larger than `MAX_NUMBER`.
        """
        if default is not None and self.xml.get(attribute) is None:
            return default
        values = self.numbers(attribute, 1)
        self._check_size(attribute, values)
        return values[0]

    def size(self, attribute: str) -> float:
        """One number that is not negative.

        Raises
        ------
        UrdfError
            As `number`, and if it is negative.
        """
        value = self.number(attribute)
        if value < 0.0:
            raise self.error(f"{attribute}={value:g}, expected a number >= 0")
        return value

    def origin(self) -> NDArray[np.float64]:
        """T (4, 4) of the child ``<origin>``; the identity if it is missing.

        Its rotation is rpy, or since URDF 1.1 the quaternion quat_xyzw.

        Raises
        ------
        UrdfError
            If a number is none, there are both, or the quaternion is zero.
        """
        origin = self.find_child("origin")
        if origin is None:
            return np.eye(4)
        xyz = origin.vector("xyz", (0.0, 0.0, 0.0))
        if origin.xml.get("quat_xyzw") is None:
            return transform_from_xyz_rpy(xyz, origin.vector("rpy", (0.0, 0.0, 0.0)))
        if origin.xml.get("rpy") is not None:
            raise origin.error("it has both rpy and quat_xyzw, expected one of them")
        quaternion = origin.vector("quat_xyzw", count=4)
        if length(quaternion) < MIN_LENGTH:
            raise origin.error(f"quat_xyzw={brief(origin.text('quat_xyzw'))} is no rotation")
        T = np.eye(4)
        T[:3, :3] = rotation_from_quaternion(quaternion)
        T[:3, 3] = xyz
        return T

    def _check_size(self, attribute: str, values: tuple[float, ...]) -> None:
        if max(map(abs, values)) > MAX_NUMBER:
            raise self.error(
                f"{attribute}={brief(self.text(attribute))} is larger than {MAX_NUMBER:g}"
            )


def transform_from_xyz_rpy(xyz: ArrayLike, rpy: ArrayLike = (0.0, 0.0, 0.0)) -> NDArray[np.float64]:
    """T (4, 4) from a translation (3,), and roll, pitch, yaw (3,) about fixed axes."""
    roll, pitch, yaw = np.asarray(rpy, dtype=np.float64).tolist()
    (sr, cr), (sp, cp), (sy, cy) = sin_cos(roll), sin_cos(pitch), sin_cos(yaw)
    T = np.eye(4)
    T[:3, :3] = [
        [cp * cy, sp * (sr * cy) - cr * sy, sp * (cr * cy) + sr * sy],
        [cp * sy, sp * (sr * sy) + cr * cy, sp * (cr * sy) - sr * cy],
        [-sp, cp * sr, cp * cr],
    ]
    T[:3, 3] = xyz
    return T


def read_robot(path: Path) -> ET.Element:
    """The ``<robot>`` of a URDF.

    Raises
    ------
    UrdfNotFoundError
        If there is no such file.
    UrdfError
        If it cannot be read, is no XML, or holds no robot.
    """
    if not os.path.exists(path):  # unlike `Path.exists`, of names that no file can have as well
        raise UrdfNotFoundError(f"there is no URDF at {path}")
    try:
        robot = read_xml(path, UrdfError)
    except UrdfError as error:
        if "unbound prefix" in str(error):
            raise UrdfError(f"{error}; if it is a file of xacro, run xacro first") from error
        raise
    if robot.tag != "robot":
        raise UrdfError(f"{path}: expected the element <robot>, not <{robot.tag:.60}>")
    return robot


def check_expanded(robot: ET.Element, path: Path) -> None:
    """Check that no macro of xacro is left in links and joints, and that none nests without end.

    Raises
    ------
    UrdfError
        Naming the element.
    """
    pending = [(element, f"{path}: {_label(element)}", 1) for element in robot]
    if any(map(_is_macro, robot.attrib.values())):
        raise UrdfError(f"{path}: <robot> belongs to xacro: run xacro first, read what it writes")
    while pending:
        element, where, depth = pending.pop()
        macros = [f'{name}="{value}"' for name, value in element.attrib.items() if _is_macro(value)]
        if "xacro" in element.tag or macros:
            shown = f" ({macros[0]:.80})" if macros else ""
            raise UrdfError(
                f"{where} belongs to xacro{shown}: run xacro first, read what it writes"
            )
        if depth > MAX_DEPTH:
            raise UrdfError(f"{where}: over {MAX_DEPTH} elements are inside of each other")
        if depth > 1 or element.tag in ("link", "joint", "material"):
            pending += [(child, f"{where}, {_label(child)}", depth + 1) for child in element]


def _is_macro(value: str) -> bool:
    return "${" in value or "$(" in value


def _label(element: ET.Element) -> str:
    name = element.get("name")
    return f"<{element.tag:.60}>" if name is None else f"<{element.tag:.60} name='{name:.60}'>"
