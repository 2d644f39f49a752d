"""Camera mounts: URDF, joints, camera, and the errors of the joints."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from coopmap_env.core.caches import freeze
from coopmap_env.geometry import Pose
from coopmap_env.robots.kinematics.chain import IDENTITY_POSE, Chain
from coopmap_env.robots.suspension import SUSPENSION_JOINTS, Suspension

DEGREE = math.pi / 180.0


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
    T_link_camera: Pose = IDENTITY_POSE
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
        n = len(self.joints)
        object.__setattr__(self, "urdf", Path(self.urdf))
        for name in ("home", "encoder_noise", "calibration_error", "alpha"):
            values = np.atleast_1d(np.asarray(getattr(self, name), dtype=np.float64))
            if values.size == 1 and name != "home":
                values = np.repeat(values, n)
            if values.shape != (n,):
                raise ValueError(
                    f"Mount.{name} needs one value for each of {list(self.joints)}, got {values}"
                )
            if not np.isfinite(values).all() or (name != "home" and (values < 0).any()):
                raise ValueError(f"Mount.{name} must be finite and >= 0, got {values}")
            object.__setattr__(self, name, tuple(values.tolist()))

    def chain(self, with_suspension: bool = False) -> Chain:
        """The mount's kinematics, read once per process.

        With the suspension, q is [heave, roll, pitch, *joints]: what physics moves. Without it, the
        suspension is at rest: what the robot assumes.

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
            self.urdf.stat().st_mtime_ns if self.urdf.is_file() else 0,
            (*(SUSPENSION_JOINTS if with_suspension else ()), *self.joints),
            self.camera_link,
            (camera.translation.tobytes(), camera.rotation.tobytes()),
            self.package_dirs,
        )
        if not with_suspension:
            chain.check_limits(self.home)
        return chain


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
