"""Rigid transforms in two and three dimensions, and poses of planar frames as arrays."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.elementary import sin_cos
from coopmap_env.core.kernels import kernel
from coopmap_env.core.linear_algebra import are_finite, product

TWO_PI = 2.0 * math.pi


class RigidTransform(NamedTuple):
    """The arrays of a `Pose`, as kernels take them."""

    rotation: NDArray[np.float64]
    """Shape (D, D)."""
    translation: NDArray[np.float64]
    """Shape (D,), metres unless a kernel says otherwise."""


@dataclass(frozen=True)
class Pose:
    """A rigid transform T_world_camera: position and orientation of a frame.

    Parameters
    ----------
    translation : ndarray, shape (D,)
        Origin of the camera frame in the world frame, metres.
    rotation : ndarray, shape (D, D)
        R_world_camera: rotates vectors of the camera frame into the world frame.

    Raises
    ------
    ValueError
        If the shapes disagree or are not of 2 or 3 axes, a value is not finite, or the rotation is
        not proper.
    """

    translation: NDArray[np.float64]
    rotation: NDArray[np.float64]

    def __post_init__(self) -> None:
        t = np.asarray(self.translation, dtype=np.float64)
        R = np.asarray(self.rotation, dtype=np.float64)
        if t.ndim != 1 or R.shape != (t.size, t.size):
            raise ValueError(f"translation {t.shape} and rotation {R.shape} do not fit together")
        if not (are_finite(t) and are_finite(R.ravel())):
            raise ValueError(f"pose has a value that is not finite: {t}, {R}")
        if t.size not in (2, 3) or not _is_proper_rotation(np.ascontiguousarray(R)):
            raise ValueError(f"rotation is not a proper rotation matrix: {R}")
        object.__setattr__(self, "translation", t)
        object.__setattr__(self, "rotation", R)

    @classmethod
    def identity(cls) -> Pose:
        """The pose in space of the reference frame itself."""
        return cls(np.zeros(3), np.eye(3))

    @classmethod
    def planar(cls, x: float, y: float, heading: float) -> Pose:
        """Pose of a planar frame from position (metres) and heading (radians, from +x to +y)."""
        s, c = sin_cos(heading)
        return cls(np.array([x, y]), np.array([[c, -s], [s, c]]))

    @property
    def arrays(self) -> RigidTransform:
        """Rotation and translation, contiguous, for kernels."""
        return RigidTransform(
            np.ascontiguousarray(self.rotation), np.ascontiguousarray(self.translation)
        )

    @property
    def spatial_arrays(self) -> RigidTransform:
        """`arrays` of a pose in space, for kernels that read three axes.

        Raises
        ------
        ValueError
            If the pose is planar.
        """
        if self.translation.size != 3:
            raise ValueError(f"a pose of three axes is needed, got {self}")
        return self.arrays

    def transform(self, points: ArrayLike) -> NDArray[np.float64]:
        """Points (..., D) of the camera frame, in the world frame."""
        return product(points, self.rotation.T) + self.translation

    def inverse(self) -> Pose:
        """T_camera_world."""
        return Pose(-product(self.translation, self.rotation), self.rotation.T)

    def __matmul__(self, other: Pose) -> Pose:
        return Pose(self.transform(other.translation), product(self.rotation, other.rotation))


@kernel
def _is_proper_rotation(R: NDArray[np.float64]) -> bool:
    """Whether a 2 x 2 or 3 x 3 matrix is orthonormal and right-handed, to within 1e-5."""
    n = len(R)
    error = 0.0
    for i in range(n):
        for j in range(i + 1):
            dot = 0.0
            for k in range(n):
                dot += R[i, k] * R[j, k]
            error = max(error, abs(dot - (1.0 if i == j else 0.0)))
    determinant = 0.0
    if n == 2:
        determinant = R[0, 0] * R[1, 1] - R[0, 1] * R[1, 0]
    else:
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            determinant += R[0, i] * (R[1, j] * R[2, k] - R[1, k] * R[2, j])
    return max(error, abs(determinant - 1.0)) < 1e-5


def wrap_angle(angle: ArrayLike) -> NDArray[np.float64]:
    """Angles wrapped to [-pi, pi), radians."""
    shifted = np.mod(np.asarray(angle, dtype=np.float64) + math.pi, TWO_PI)
    # just below -pi, the remainder of a tiny negative number rounds to 2 pi
    return np.where(shifted < TWO_PI, shifted, 0.0) - math.pi


@kernel
def wrap_scalar_angle(angle: float) -> float:
    """One angle wrapped to [-pi, pi), radians; the same bits as of `wrap_angle`."""
    shifted = (angle + math.pi) % TWO_PI
    return (shifted if shifted < TWO_PI else 0.0) - math.pi


def to_camera_frame(poses: ArrayLike, reference: ArrayLike) -> NDArray[np.float64]:
    """Planar poses (..., 3) [x, y, heading] of the world frame in the frame of `reference` (3,)."""
    poses, reference = np.asarray(poses, dtype=np.float64), np.asarray(reference, dtype=np.float64)
    delta = poses - reference
    s, c = sin_cos(reference[2])
    out = np.empty_like(delta)
    out[..., 0] = c * delta[..., 0] + s * delta[..., 1]
    out[..., 1] = c * delta[..., 1] - s * delta[..., 0]
    out[..., 2] = wrap_angle(delta[..., 2])
    return out


def to_world_frame(poses: ArrayLike, reference: ArrayLike) -> NDArray[np.float64]:
    """Planar poses (..., 3) given in the frame of `reference` (3,), in the world frame."""
    poses, reference = np.asarray(poses, dtype=np.float64), np.asarray(reference, dtype=np.float64)
    s, c = sin_cos(reference[2])
    out = np.empty_like(poses)
    out[..., 0] = reference[0] + c * poses[..., 0] - s * poses[..., 1]
    out[..., 1] = reference[1] + s * poses[..., 0] + c * poses[..., 1]
    out[..., 2] = wrap_angle(poses[..., 2] + reference[2])
    return out
