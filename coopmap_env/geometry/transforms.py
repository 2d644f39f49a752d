"""Rigid transforms in two and three dimensions, and poses of planar cameras."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

TURN = 2.0 * math.pi


@dataclass(frozen=True)
class Pose:
    """A rigid transform T_world_camera: where a frame stands and how it is turned.

    Parameters
    ----------
    translation : ndarray, shape (D,)
        Origin of the camera frame in the world frame, metres.
    rotation : ndarray, shape (D, D)
        R_world_camera: turns vectors of the camera frame into the world frame.

    Raises
    ------
    ValueError
        If the shapes disagree, a value is not finite, or the rotation is not proper.
    """

    translation: NDArray[np.float64]
    rotation: NDArray[np.float64]

    def __post_init__(self) -> None:
        t = np.asarray(self.translation, dtype=np.float64)
        R = np.asarray(self.rotation, dtype=np.float64)
        if t.ndim != 1 or R.shape != (t.size, t.size):
            raise ValueError(f"translation {t.shape} and rotation {R.shape} do not fit together")
        if not (np.isfinite(t).all() and np.isfinite(R).all()):
            raise ValueError(f"pose has a value that is not finite: {t}, {R}")
        if not np.allclose(R @ R.T, np.eye(t.size), atol=1e-6) or np.linalg.det(R) < 0:
            raise ValueError(f"rotation is not a proper rotation matrix: {R}")
        object.__setattr__(self, "translation", t)
        object.__setattr__(self, "rotation", R)

    @classmethod
    def planar(cls, x: float, y: float, heading: float) -> Pose:
        """Pose of a planar frame from position (metres) and heading (radians, from +x to +y)."""
        c, s = math.cos(heading), math.sin(heading)
        return cls(np.array([x, y]), np.array([[c, -s], [s, c]]))

    def transform(self, points: ArrayLike) -> NDArray[np.float64]:
        """Points (..., D) of the camera frame, in the world frame."""
        return np.asarray(points) @ self.rotation.T + self.translation

    def inverse(self) -> Pose:
        """T_camera_world."""
        return Pose(-self.rotation.T @ self.translation, self.rotation.T)

    def __matmul__(self, other: Pose) -> Pose:
        return Pose(self.transform(other.translation), self.rotation @ other.rotation)


def wrap_angle(angle: ArrayLike) -> NDArray[np.float64]:
    """Angles wrapped to [-pi, pi), radians."""
    turned = np.mod(np.asarray(angle, dtype=np.float64) + math.pi, TURN)
    # just below -pi, the remainder of a tiny negative number rounds to a whole turn
    return np.where(turned < TURN, turned, 0.0) - math.pi


def to_camera_frame(poses: ArrayLike, reference: ArrayLike) -> NDArray[np.float64]:
    """Planar poses (..., 3) [x, y, heading] as seen from the pose `reference` (3,)."""
    poses, reference = np.asarray(poses, dtype=np.float64), np.asarray(reference, dtype=np.float64)
    delta = poses - reference
    c, s = math.cos(reference[2]), math.sin(reference[2])
    out = np.empty_like(delta)
    out[..., 0] = c * delta[..., 0] + s * delta[..., 1]
    out[..., 1] = c * delta[..., 1] - s * delta[..., 0]
    out[..., 2] = wrap_angle(delta[..., 2])
    return out


def to_world_frame(poses: ArrayLike, reference: ArrayLike) -> NDArray[np.float64]:
    """Planar poses (..., 3) given in the frame of `reference` (3,), in the world frame."""
    poses, reference = np.asarray(poses, dtype=np.float64), np.asarray(reference, dtype=np.float64)
    c, s = math.cos(reference[2]), math.sin(reference[2])
    out = np.empty_like(poses)
    out[..., 0] = reference[0] + c * poses[..., 0] - s * poses[..., 1]
    out[..., 1] = reference[1] + s * poses[..., 0] + c * poses[..., 1]
    out[..., 2] = wrap_angle(poses[..., 2] + reference[2])
    return out
