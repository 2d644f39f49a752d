"""Camera mounts: URDF, joints, camera, and the errors of the joints."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.caches import freeze
from coopmap_env.core.files import brief
from coopmap_env.geometry import Pose
from coopmap_env.robots.kinematics.chain import Chain
from coopmap_env.robots.kinematics.urdf_loading import urdf_for_physics
from coopmap_env.robots.suspension import SUSPENSION_JOINTS, Suspension

DEGREE = math.pi / 180.0
MAX_NAME_BYTES = 100
"""Of a mount's name, in UTF-8: files are named by it."""


@dataclass(frozen=True, eq=False)
class Mount:
    """A camera on the moving joints of a stationary vehicle.

    The URDF's root link is the frame of the wheels, on the ground under the vehicle; between it
    and the vehicle's body lie the three `SUSPENSION_JOINTS`, if the mount has a suspension.

    Raises
    ------
    ValueError
        If lengths disagree or a value is out of its range.
    """

    name: str
    urdf: Path
    camera_link: str
    joints: tuple[str, ...]
    """The joints that move the camera, from the vehicle outwards: the order of q."""
    home: tuple[float, ...]
    """Joint values at the start; the suspension is at rest there."""
    T_link_camera: Pose = field(default_factory=Pose.identity)
    """Camera frame (x optical axis, y left, z up) in the frame of the camera link."""
    encoder_noise: tuple[float, ...] | float = 0.1 * DEGREE
    """Standard deviation of one encoder reading, radians or metres, per joint or for all."""
    calibration_error: tuple[float, ...] | float = 0.15 * DEGREE
    """Standard deviation of a joint's constant offset, drawn once per episode."""
    suspension: Suspension | None = None
    alpha: tuple[float, ...] | float = 1.0
    """Weights of squared joint motions in Eq. 5: per rad^2, or per m^2 of a prismatic joint."""
    package_dirs: tuple[str, ...] = ()
    """Folders in which ``package://`` meshes are searched."""

    def __post_init__(self) -> None:
        check_mount_name(self.name)
        for name in ("joints", "package_dirs"):
            object.__setattr__(self, name, as_names(f"Mount.{name}", getattr(self, name)))
        if self.suspension is not None:
            check_suspension(self.suspension)
        if not isinstance(self.T_link_camera, Pose):
            raise ValueError(f"Mount.T_link_camera must be a Pose, got {brief(self.T_link_camera)}")
        n = len(self.joints)
        object.__setattr__(self, "urdf", Path(self.urdf))
        for name in ("home", "encoder_noise", "calibration_error", "alpha"):
            values = _numbers(name, getattr(self, name))
            if values.size == 1 and name != "home":
                values = np.repeat(values, n)
            if values.shape != (n,):
                raise ValueError(
                    f"Mount.{name} needs one value for each of {list(self.joints)}, got {values}"
                )
            if not np.isfinite(values).all() or (name != "home" and (values < 0).any()):
                range_ = "finite" if name == "home" else "finite and >= 0"
                raise ValueError(f"Mount.{name} must be {range_}, got {values}")
            object.__setattr__(self, name, tuple(values.tolist()))

    def chain(self, with_suspension: bool = False) -> Chain:
        """The mount's kinematics, read once per process.

        With the suspension, q is ``[heave, roll, pitch, *joints]``: what physics moves. Without it,
        the suspension is at rest: what the robot assumes.

        Raises
        ------
        ValueError
            If the URDF lacks a joint or link, or `home` is outside of the limits.
        """
        if with_suspension and self.suspension is None:
            raise ValueError(f"the mount {self.name!r} has no suspension")
        camera = self.T_link_camera
        chain = _read_chain(
            self.urdf,
            _modification_time(self.urdf),
            (*(SUSPENSION_JOINTS if with_suspension else ()), *self.joints),
            self.camera_link,
            (camera.translation.tobytes(), camera.rotation.tobytes()),
            self.package_dirs,
        )
        if not with_suspension:
            try:
                chain.check_limits(self.home)
            except ValueError as error:
                raise ValueError(f"home of the mount {self.name!r}: {error}") from error
        return chain

    def urdf_for_physics(self) -> Path:
        """The file that a physics engine loads: `urdf`, or a copy that PyBullet reads as we do.

        The copy has absolute paths of meshes, formats that PyBullet knows, and what the
        specification gives for missing limits and masses.

        Raises
        ------
        UrdfError
            If the URDF or a mesh cannot be read.
        """
        key = self.urdf, _modification_time(self.urdf), self.package_dirs
        path = _urdf_for_physics(*key)
        if not path.is_file():  # folders for temporary files are swept
            _urdf_for_physics.cache_clear()
            path = _urdf_for_physics(*key)
        return path


def as_names(what: str, values: Iterable[object]) -> tuple[str, ...]:
    """Names in a tuple.

    Raises
    ------
    ValueError
        If they are no sequence, or one name alone, whose letters would be taken for names.
    """
    if isinstance(values, str | bytes) or not isinstance(values, Iterable):
        raise ValueError(f"{what} must be a sequence of names, got {brief(values)}")
    return tuple(map(str, values))


def check_suspension(suspension: object) -> None:
    """Check the type of a suspension.

    Raises
    ------
    ValueError
        If it is none.
    """
    if not isinstance(suspension, Suspension):
        raise ValueError(f"suspension must be a Suspension, got {brief(suspension)}")


def _numbers(name: str, value: object) -> NDArray[np.float64]:
    try:
        return np.atleast_1d(np.asarray(value, dtype=np.float64))
    except (TypeError, ValueError) as error:
        raise ValueError(f"Mount.{name} must be numbers, got {brief(value)}") from error


def check_mount_name(name: str) -> None:
    """Check that a file can be named by a mount's name.

    Raises
    ------
    ValueError
        If it is no text, empty, longer than `MAX_NAME_BYTES`, or has slashes or control characters.
    """
    if not isinstance(name, str) or not name.strip() or not name.isprintable():
        raise ValueError(f"Mount.name must be printable text, got {brief(name)}")
    if "/" in name or "\\" in name:
        raise ValueError(f"Mount.name names a file, so it must have no slash, got {brief(name)}")
    if len(name.encode()) > MAX_NAME_BYTES:
        raise ValueError(
            f"Mount.name must have at most {MAX_NAME_BYTES} bytes, got {len(name.encode())} of "
            f"{brief(name)}: give a shorter name"
        )


@lru_cache(maxsize=32)
def _read_chain(
    urdf: Path,
    _modified_ns: int,
    joints: tuple[str, ...],
    camera_link: str,
    T_link_camera: tuple[bytes, bytes],
    package_dirs: tuple[str, ...],
) -> Chain:
    translation, rotation = (np.frombuffer(part).copy() for part in T_link_camera)
    camera = Pose(translation, rotation.reshape(3, 3))
    return freeze(Chain.from_urdf(urdf, joints, camera_link, camera, package_dirs))


@lru_cache(maxsize=32)
def _urdf_for_physics(urdf: Path, _modified_ns: int, package_dirs: tuple[str, ...]) -> Path:
    return urdf_for_physics(urdf, package_dirs)


def _modification_time(urdf: Path) -> int:
    """Nanoseconds; 0 without a file."""
    return urdf.stat().st_mtime_ns if urdf.is_file() else 0
