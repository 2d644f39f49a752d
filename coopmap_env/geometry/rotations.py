"""Rotation matrices and rotation vectors, and small displacements of poses.

A displacement is [dt, dw]: the frame is translated by dt and rotated by exp([dw]x), both along the
axes of the frame in which the pose is given. Covariances of poses are those of such displacements.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.elementary import atan2, sin_cos
from coopmap_env.core.kernels import PlainTuple, kernel
from coopmap_env.core.linear_algebra import length, product, total
from coopmap_env.geometry.transforms import Pose

SMALL_ANGLE = 1e-8
"""Radians: below this, the sine of an angle equals the angle in double precision."""
Z_AXIS = np.array([0.0, 0.0, 1.0])
"""The vertical."""
Z_AXIS.flags.writeable = False


def skew(v: ArrayLike) -> NDArray[np.float64]:
    """[v]x, shape (..., 3, 3): ``skew(v) @ u`` is the cross product of v (..., 3) and u."""
    v = np.asarray(v, dtype=np.float64)
    out = np.zeros((*v.shape, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = v[..., 2], -v[..., 1], v[..., 0]
    return out


def rotation_about_axis(axis: ArrayLike, angle: float) -> NDArray[np.float64]:
    """Rotation (3, 3) by `angle` radians about a unit vector `axis` (3,) (Rodrigues' formula).

    ``I + sin(angle) [a]x + (1 - cos(angle)) [a]x^2``.
    """
    K = skew(axis)
    sine, cosine = sin_cos(angle)
    return np.eye(3) + sine * K + (1.0 - cosine) * product(K, K)


def rotation_about_z(angle: float) -> NDArray[np.float64]:
    """Rotation (3, 3) about the z axis, radians.

    Its entries are the sine and cosine themselves, which `rotation_about_axis` meets to within
    rounding.
    """
    s, c = sin_cos(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def rotation_from_rpy(roll: float, pitch: float, yaw: float) -> NDArray[np.float64]:
    """Rotation (3, 3) about the fixed axes x, y, z in this order, as in URDF and SDF, radians."""
    x, y, z = np.eye(3)
    R_x, R_y = rotation_about_axis(x, roll), rotation_about_axis(y, pitch)
    return product(product(rotation_about_axis(z, yaw), R_y), R_x)


def random_rotation(rng: np.random.Generator) -> NDArray[np.float64]:
    """Rotation (3, 3), uniform over all orientations (a normal quaternion, normalised)."""
    w, x, y, z = (q := rng.normal(size=4)) / length(q)
    return _rotation_from_unit_quaternion(x, y, z, w)


def rotation_from_quaternion(xyzw: ArrayLike) -> NDArray[np.float64]:
    """Rotation (3, 3) of a quaternion (4,), which need not have length 1.

    Raises
    ------
    ValueError
        If its length is zero or not finite.
    """
    q = np.asarray(xyzw, dtype=np.float64)
    norm = length(q)
    if not 0.0 < norm < math.inf:
        raise ValueError(f"a rotation must be a quaternion of finite length above 0, not {q}")
    return _rotation_from_unit_quaternion(*(q / norm))


def _rotation_from_unit_quaternion(x: float, y: float, z: float, w: float) -> NDArray[np.float64]:
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def rotation_from_rotvec(w: ArrayLike) -> NDArray[np.float64]:
    """exp([w]x): the rotation (3, 3) about `w` (3,) by its length in radians.

    Rodrigues' formula with half angles, which stays accurate for the small rotations of pose
    corrections.
    """
    w = np.asarray(w, dtype=np.float64)
    angle = length(w)
    K = skew(w)
    if angle < SMALL_ANGLE:
        return nearest_rotation(np.eye(3) + K)
    half = sin_cos(angle / 2.0)[0] / (angle / 2.0)
    return np.eye(3) + (sin_cos(angle)[0] / angle) * K + (0.5 * half * half) * product(K, K)


def rotvec_from_rotation(R: ArrayLike) -> NDArray[np.float64]:
    """Rotation vector (3,) of a rotation (3, 3), of length 0 to pi.

    Raises
    ------
    ValueError
        If the shape is another one.
    """
    rotation, out = np.ascontiguousarray(R, dtype=np.float64), np.empty(3)
    if rotation.shape != (3, 3):
        raise ValueError(f"a rotation must be (3, 3), got {rotation.shape}")
    write_rotvec(rotation, out)
    return out


@kernel
def write_rotvec(R: NDArray[np.float64], out: NDArray[np.float64]) -> None:
    """Write `rotvec_from_rotation` to `out` (3,)."""
    # through the quaternion, which is well conditioned at every angle (Shepperd 1978)
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    i = 0
    for axis in range(1, 3):
        if R[axis, axis] > R[i, i]:
            i = axis
    if trace > R[i, i]:
        x, y, z = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
        w = 1.0 + trace
    else:
        j, k = (i + 1) % 3, (i + 2) % 3
        out[i] = 1.0 + R[i, i] - R[j, j] - R[k, k]
        out[j], out[k] = R[j, i] + R[i, j], R[k, i] + R[i, k]
        x, y, z = out[0], out[1], out[2]
        w = R[k, j] - R[j, k]
    sign = math.copysign(1.0, w)
    sine = math.sqrt(x * x + y * y + z * z)
    factor = 0.0 if sine == 0.0 else 2.0 * atan2(sine, sign * w) / sine
    out[0], out[1], out[2] = sign * x * factor, sign * y * factor, sign * z * factor


def nearest_rotation(M: ArrayLike) -> NDArray[np.float64]:
    """Rotation nearest to a matrix (3, 3) in the Frobenius norm.

    U diag(1, 1, det(U V^T)) V^T of the singular value decomposition U S V^T (Umeyama 1991): the
    third columns of U and V are cross products of the others, which makes both right-handed.
    """
    columns = np.array(M, dtype=np.float64)
    V = np.eye(3)
    _orthogonalise(columns, V)
    singular_values = np.sqrt(np.square(columns).sum(axis=0))
    i, j = np.argsort(-singular_values, kind="stable")[:2]
    u_1 = _direction(columns[:, i], Z_AXIS)
    u_2 = columns[:, j] - u_1 * total((u_1 * columns[:, j]).tolist())
    u_2 = _direction(u_2, np.cross(u_1, np.eye(3)[int(np.abs(u_1).argmin())]))
    U = np.stack([u_1, u_2, np.cross(u_1, u_2)])
    W = np.stack([V[:, i], V[:, j], np.cross(V[:, i], V[:, j])])
    return product(U.T, W)


def _direction(v: NDArray[np.float64], otherwise: NDArray[np.float64]) -> NDArray[np.float64]:
    """A vector (3,) as a unit vector; if it is zero, another one."""
    norm = length(v)
    return v / norm if norm > 0.0 else otherwise / length(otherwise)


@kernel
def _orthogonalise(A: NDArray[np.float64], V: NDArray[np.float64]) -> None:
    """Rotate the columns of A (3, 3) until they are orthogonal; V (3, 3) is rotated alike.

    One-sided Jacobi method: A V^T stays the same, so that A becomes U S.
    """
    for _ in range(30):
        rotated = False
        for p in range(2):
            for q in range(p + 1, 3):
                a, b, c = 0.0, 0.0, 0.0
                for i in range(3):
                    a += A[i, p] * A[i, p]
                    b += A[i, q] * A[i, q]
                    c += A[i, p] * A[i, q]
                if abs(c) <= 1e-16 * math.sqrt(a * b):
                    continue
                rotated = True
                tau = (b - a) / (2.0 * c)
                t = math.copysign(1.0, tau) / (abs(tau) + math.sqrt(1.0 + tau * tau))
                cosine = 1.0 / math.sqrt(1.0 + t * t)
                sine = t * cosine
                for i in range(3):
                    x, y = A[i, p], A[i, q]
                    A[i, p], A[i, q] = cosine * x - sine * y, sine * x + cosine * y
                    x, y = V[i, p], V[i, q]
                    V[i, p], V[i, q] = cosine * x - sine * y, sine * x + cosine * y
        if not rotated:
            return


def apply_displacement(pose: Pose, displacement: ArrayLike) -> Pose:
    """The pose translated by dt and rotated by exp([dw]x); `displacement` (6,) is [dt, dw]."""
    d = np.asarray(displacement, dtype=np.float64)
    return Pose(pose.translation + d[:3], product(rotation_from_rotvec(d[3:]), pose.rotation))


def displacement_between(pose: Pose, other: Pose) -> NDArray[np.float64]:
    """Displacement (6,) from `pose` to `other`: the inverse of `apply_displacement`.

    Raises
    ------
    ValueError
        If one of the poses is planar.
    """
    out = np.empty(6)
    write_displacement(tuple(pose.spatial_arrays), tuple(other.spatial_arrays), out)
    return out


@kernel
def write_displacement(
    plain_pose: PlainTuple, plain_other: PlainTuple, out: NDArray[np.float64]
) -> None:
    """Write `displacement_between` plain `RigidTransform` to `out` (6,)."""
    (rotation, translation), (other_rotation, other_translation) = plain_pose, plain_other
    between = np.empty((3, 3))
    for i in range(3):
        out[i] = other_translation[i] - translation[i]
        a = other_rotation[i]
        for j in range(3):
            b = rotation[j]
            between[i, j] = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    write_rotvec(between, out[3:])
