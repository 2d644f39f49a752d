"""Joints that depend on others: mimic joints, and joints that are fixed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from coopmap_env.core.files import brief
from coopmap_env.core.settings import checked_value
from coopmap_env.robots.kinematics.urdf_elements import MOVABLE_JOINT_TYPES, Mimic, UrdfJoint
from coopmap_env.robots.kinematics.urdf_xml import MAX_NUMBER, UrdfError

SAME_VALUE = 1e-6
"""Radians or metres: values of a mimic joint that are this near to each other are one."""


def resolve_mimics(joints: Iterable[UrdfJoint], path: Path) -> dict[str, UrdfJoint]:
    """The joints by name, as `UrdfModel.joints` has them.

    Joints with equal limits are fixed there, unless they mimic another one; one that mimics a fixed
    joint is fixed itself; one that mimics a mimic joint mimics what that one does.

    Raises
    ------
    UrdfError
        If a joint mimics one that does not exist or has no value, or itself through others.
    """
    by_name = {joint.name: _fixed_by_limits(joint) for joint in joints}
    resolved: dict[str, UrdfJoint] = {}
    for joint in by_name.values():
        trail: dict[str, UrdfJoint] = {}
        while joint.mimic is not None and joint.name not in resolved:
            if joint.name in trail:
                raise UrdfError(f"{path}: the joints {brief(list(trail))} mimic each other")
            trail[joint.name] = joint
            source = by_name.get(joint.mimic.joint)
            if source is None:
                raise UrdfError(
                    f"{path}: joint {brief(joint.name)} mimics {brief(joint.mimic.joint)}, "
                    "and there is no such joint"
                )
            joint = source
        resolved.setdefault(joint.name, joint)
        for follower in reversed(trail.values()):
            assert follower.mimic is not None
            resolved[follower.name] = _follow(
                follower, follower.mimic, resolved[follower.mimic.joint], path
            )
    return resolved


def _fixed_by_limits(joint: UrdfJoint) -> UrdfJoint:
    """A joint with equal limits as a fixed one."""
    if joint.mimic is None and joint.lower == joint.upper:
        return joint.fixed_at(joint.lower)
    return joint


def _follow(joint: UrdfJoint, mimic: Mimic, source: UrdfJoint, path: Path) -> UrdfJoint:
    """A joint as a follower of what its source depends on."""
    if source.joint_type not in (*MOVABLE_JOINT_TYPES, "fixed"):
        raise UrdfError(
            f"{path}: joint {brief(joint.name)} mimics {brief(source.name)}, which has no single "
            f"value: its type is {source.joint_type}"
        )
    name, multiplier, offset = source.dependence
    multiplier, offset = mimic.multiplier * multiplier, mimic.multiplier * offset + mimic.offset
    if not max(abs(multiplier), abs(offset)) <= MAX_NUMBER:
        raise UrdfError(
            f"{path}: joint {brief(joint.name)} mimics {brief(name)} with the multiplier "
            f"{multiplier:g} and the offset {offset:g}, larger than {MAX_NUMBER:g}"
        )
    if source.joint_type == "fixed":
        return joint.fixed_at(offset)
    return replace(joint, mimic=Mimic(name, multiplier, offset))


def fix_all_but(
    joints: Sequence[UrdfJoint], moving: Sequence[str], values: Mapping[str, float], path: Path
) -> tuple[UrdfJoint, ...]:
    """The joints, fixed but for `moving` and their followers; see `UrdfModel.with_fixed_joints`."""
    by_name = {joint.name: joint for joint in joints}
    movable = [joint.name for joint in joints if joint.joint_type in MOVABLE_JOINT_TYPES]
    for name in (*moving, *values):
        if name not in movable:
            raise ValueError(
                f"{path} has no moving joint {name!r}{_why_fixed(by_name.get(name))}; it has "
                f"{movable}"
            )
    for name in moving:
        mimic = by_name[name].mimic
        if mimic is not None:
            raise ValueError(
                f"the joint {name!r} of {path} mimics {mimic.joint!r}, so it does not move by "
                f"itself: name {mimic.joint!r} instead"
            )
        if name in values:
            raise ValueError(f"the joint {name!r} of {path} is to move and has a fixed value")
    numbers = {
        name: checked_value(f"the value of the joint {name!r}", value, float)
        for name, value in values.items()
    }
    return tuple(_fixed_unless(joint, moving, numbers, path) for joint in joints)


def _why_fixed(joint: UrdfJoint | None) -> str:
    """For errors: what holds a joint that a file calls movable."""
    if joint is None or joint.lower != joint.upper:
        return ""
    return f" (equal limits, or a fixed joint that it mimics, hold it at {joint.lower:g})"


def _fixed_unless(
    joint: UrdfJoint, moving: Sequence[str], values: Mapping[str, float], path: Path
) -> UrdfJoint:
    if joint.joint_type in ("planar", "floating", "spherical"):
        raise ValueError(
            f"{path}: the joint {joint.name!r} is {joint.joint_type}; the joints of a mount can "
            f"be {', '.join(MOVABLE_JOINT_TYPES)} or fixed"
        )
    source, multiplier, offset = joint.dependence
    if joint.joint_type == "fixed":
        return joint
    value = multiplier * values.get(source, 0.0) + offset
    if joint.name in values and (source in moving or abs(values[joint.name] - value) > SAME_VALUE):
        follows = "moves" if source in moving else f"puts it at {value:g}"
        raise ValueError(
            f"the joint {joint.name!r} of {path} mimics {source!r}, which {follows}: it cannot be "
            f"fixed at {values[joint.name]:g}"
        )
    return joint if source in moving else joint.fixed_at(value)
