"""Mounts of URDFs as JSON values: for the command line, jobs and trainings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from coopmap_env.core.choices import check_keywords
from coopmap_env.geometry import Pose
from coopmap_env.robots.kinematics.urdf_loading import load_urdf_xml
from coopmap_env.robots.mount import Mount
from coopmap_env.robots.mount_library import R_OPTICAL_CAMERA, mount_from_urdf


@dataclass(frozen=True, kw_only=True)
class MountFields:
    """The fields of a mount as a JSON object; see `mount_from_urdf`."""

    urdf: str
    """Path of the URDF."""
    joints: Sequence[str]
    """The joints that move the camera."""
    camera_link: str
    """Link of the camera."""
    home: Sequence[float] | None = None
    """Joint values at the start."""
    root_height: float = 0.0
    """Of the URDF's root link above ground, metres."""
    optical_frame: bool = False
    """Whether the link's z is the optical axis, and its x points right; else its x is the optical
    axis, and its y points left."""


def mount_from_json(fields: Mapping[str, Any]) -> Mount:
    """The mount of a JSON object with `MountFields`.

    Raises
    ------
    ValueError
        With the field or the file, if one is not accepted; see `mount_from_urdf`.
    """
    try:
        check_keywords("a mount", fields, MountFields)
        given = MountFields(**fields)
    except TypeError as error:
        raise ValueError(f"mount: {error}") from error
    settings: dict[str, Any] = {}
    if given.optical_frame:
        settings["T_link_camera"] = Pose(np.zeros(3), R_OPTICAL_CAMERA)
    return mount_from_urdf(
        given.urdf,
        given.joints,
        given.camera_link,
        given.home,
        root_height=given.root_height,
        **settings,
    )


def mount_files(fields: Mapping[str, Any]) -> list[Path]:
    """The URDF of a JSON object with `MountFields`, and its meshes."""
    urdf = Path(fields["urdf"])
    meshes = (element.get("filename", "") for element in load_urdf_xml(urdf).iter("mesh"))
    return [urdf, *map(Path, dict.fromkeys(meshes))]
