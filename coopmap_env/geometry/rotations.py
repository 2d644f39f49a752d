"""Rotations in space as vectors, and small displacements of poses.

A displacement is [dt, dw]: the frame stands dt further, turned by exp([dw]x), both along the axes
of the frame in which the pose is given. Covariances of poses are those of such displacements.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.geometry.transforms import Pose

SMALL_ANGLE = 1e-8
"""Radians below which the sine is the angle."""


def skew(v: ArrayLike) -> NDArray[np.float64]:
    """[v]x, shape (..., 3, 3): ``skew(v) @ u`` is the cross product of v (..., 3) and u."""
    v = np.asarray(v, dtype=np.float64)
    out = np.zeros((*v.shape, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = v[..., 2], -v[..., 1], v[..., 0]
    return out


def rotation_from_rotvec(w: ArrayLike) -> NDArray[np.float64]:
    """exp([w]x): the rotation (3, 3) about w by its length in radians (Rodrigues)."""
    w = np.asarray(w, dtype=np.float64)
    angle = math.sqrt(float(w @ w))
    K = skew(w)
    if angle < SMALL_ANGLE:
        return nearest_rotation(np.eye(3) + K)
    half = math.sin(angle / 2.0) / (angle / 2.0)
    return np.eye(3) + (math.sin(angle) / angle) * K + (0.5 * half * half) * (K @ K)


def rotvec_from_rotation(R: ArrayLike) -> NDArray[np.float64]:
    """Rotation vector (3,) of a rotation (3, 3), of length 0 to pi."""
    R = np.asarray(R, dtype=np.float64)
    # by its quaternion, which is well conditioned at every angle (Shepperd 1978)
    four = np.array([R[0, 0], R[1, 1], R[2, 2], np.trace(R)])
    i = int(four.argmax())
    q = np.empty(4)
    if i == 3:
        q[:3] = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
        q[3] = 1.0 + four[3]
    else:
        j, k = (i + 1) % 3, (i + 2) % 3
        q[i] = 1.0 + four[i] - four[j] - four[k]
        q[j], q[k] = R[j, i] + R[i, j], R[k, i] + R[i, k]
        q[3] = R[k, j] - R[j, k]
    q *= math.copysign(1.0, q[3])
    length = math.sqrt(float(q[:3] @ q[:3]))
    if length == 0.0:
        return np.zeros(3)
    return q[:3] * (2.0 * math.atan2(length, float(q[3])) / length)


def nearest_rotation(M: ArrayLike) -> NDArray[np.float64]:
    """The rotation that is nearest to a matrix (3, 3) in the Frobenius norm.

    U diag(1, 1, det(U V^T)) V^T of the singular value decomposition U S V^T (Umeyama 1991).
    """
    U, _, Vt = np.linalg.svd(np.asarray(M, dtype=np.float64))
    U[:, 2] *= math.copysign(1.0, np.linalg.det(U) * np.linalg.det(Vt))
    return np.asarray(U @ Vt)


def apply_displacement(pose: Pose, displacement: ArrayLike) -> Pose:
    """A pose that stands dt further, turned by exp([dw]x), of a displacement (6,) = [dt, dw]."""
    d = np.asarray(displacement, dtype=np.float64)
    return Pose(pose.translation + d[:3], rotation_from_rotvec(d[3:]) @ pose.rotation)


def displacement_between(pose: Pose, other: Pose) -> NDArray[np.float64]:
    """The displacement (6,) that leads from one pose to another: the inverse of `apply_displacement`."""
    return np.concatenate(
        [
            other.translation - pose.translation,
            rotvec_from_rotation(other.rotation @ pose.rotation.T),
        ]
    )
