"""Kernels of a vehicle's camera: where it is at given joints, and how uncertain that is."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import PlainTuple, borrowing_kernel, kernel
from coopmap_env.core.linear_algebra import multiply
from coopmap_env.robots._spring_kernels import load_response, solve_equilibrium
from coopmap_env.robots.kinematics.forward import (
    KinematicTree,
    frame_jacobian,
    frame_poses,
    mounted_frame_poses,
)

Array = NDArray[np.float64]


class CameraModel(NamedTuple):
    """What the pose of a vehicle's camera depends on, besides the joints (n,) of the mount.

    The parts are plain tuples. The camera's chain has m joints: those of the suspension, if there
    is one, and those of the mount.
    """

    frame: PlainTuple
    """The camera as a plain `MountedFrames` on its chain."""
    masses: PlainTuple
    """A plain `MassModel`; anything if the deflection is not predicted."""
    springs: PlainTuple
    """Plain `Springs`; likewise."""
    compliance: Array
    """Shape (2,), see `Equilibrium.compliance`; likewise."""
    n_suspension: int
    """Joints of the suspension."""
    predicts_deflection: bool
    """Whether the suspension is where the springs carry the load; otherwise it is at rest."""


class CameraUncertainty(NamedTuple):
    """Variances of the errors that make the pose of a vehicle's camera uncertain."""

    per_scan: Array
    """Shape (m,): of the camera's chain, independent in each scan."""
    calibration: Array
    """Shape (n,): of the offsets of the mount's joints."""
    compliance_std: float
    """Standard deviation of `Equilibrium.compliance`."""
    base: Array
    """Shape (6, 6): covariance of the base; empty if it is known exactly."""


class CameraJacobians(NamedTuple):
    """Derivatives of the camera's pose [translation; rotation vector], world frame."""

    by_joints: Array
    """Shape (6, m). A joint of the mount that moves changes the load of the springs, too, if their
    deflection is predicted."""
    by_compliance: Array
    """Shape (6, 2): by `Equilibrium.compliance`; zeros if the deflection is not predicted."""


@kernel
def camera_joints(model: PlainTuple, q: Array) -> Array:
    """Joints (k, m) of the camera's chain from those (k, n) of the mount."""
    _, masses, springs, _, n_suspension, predicts_deflection = model
    k, n = q.shape
    out = np.zeros((k, n_suspension + n))
    for i in range(k):
        for j in range(n):
            out[i, n_suspension + j] = q[i, j]
    if predicts_deflection:
        solve_equilibrium(masses, springs, out)
    return out


@kernel
def camera_deflection(model: PlainTuple, q: Array) -> float:
    """Metres from where the camera would be on a suspension at rest, at joints q (n,)."""
    frame, _, _, _, n_suspension, _ = model
    tree, body, rotation, translation, _, _ = frame
    joints = np.empty((2, n_suspension + len(q)))
    joints[0] = camera_joints(model, q.reshape(1, -1))[0]
    joints[1] = joints[0]
    joints[1, :n_suspension] = 0.0
    R, t = np.empty((2, 1, 3, 3)), np.empty((2, 1, 3))
    frame_poses(KinematicTree(*tree), joints, body, rotation, translation, R, t)
    square = 0.0
    for i in range(3):
        difference = t[0, 0, i] - t[1, 0, i]
        square += difference * difference
    return math.sqrt(square)


@kernel
def camera_jacobians(model: PlainTuple, joints: Array) -> CameraJacobians:
    """Derivatives at joints (m,) of the camera's chain."""
    frame, masses, springs, compliance, n_suspension, predicts_deflection = model
    tree, body, _, translation, base_rotation, _ = frame
    m = len(joints)
    in_base, J, C = np.empty((6, m)), np.empty((6, m)), np.zeros((6, 2))
    frame_jacobian(KinematicTree(*tree), joints, body[0], translation[0], in_base)
    _rotate_halves(base_rotation, in_base, J)
    if predicts_deflection:
        response = np.empty((2, m - 1))
        load_response(masses, springs, joints, response)
        for i in range(2):
            response[i, 0] /= compliance[0]
            response[i, 1] /= compliance[1]
        for i in range(6):
            roll, pitch = J[i, 1], J[i, 2]
            for j in range(2):
                C[i, j] = roll * response[0, j] + pitch * response[1, j]
            for j in range(n_suspension, m):
                J[i, j] += roll * response[0, j - 1] + pitch * response[1, j - 1]
    return CameraJacobians(J, C)


@kernel
def estimate_camera(
    model: PlainTuple, uncertainty: PlainTuple, q: Array
) -> tuple[Array, Array, Array]:
    """Rotation (3, 3), translation (3,) and covariance (6, 6) of the camera at joints q (n,).

    See `Vehicle.camera_estimate`.
    """
    frame, _, _, _, _, _ = model
    joints = camera_joints(model, q.reshape(1, -1))
    R, t = mounted_frame_poses(frame, joints)
    jacobians = camera_jacobians(model, joints[0])
    covariance = np.zeros((6, 6))
    add_persistent_covariance(model, uncertainty, jacobians, t[0, 0], covariance)
    add_per_scan_covariance(uncertainty, jacobians, covariance)
    return R[0, 0], t[0, 0], covariance


@kernel
def add_persistent_covariance(
    model: PlainTuple,
    uncertainty: PlainTuple,
    jacobians: CameraJacobians,
    position: Array,
    out: Array,
) -> None:
    """Add the covariance (6, 6) by errors that persist from scan to scan."""
    frame, _, _, _, n_suspension, predicts_deflection = model
    _, calibration, compliance_std, base = uncertainty
    J, C = jacobians.by_joints[:, n_suspension:], jacobians.by_compliance * compliance_std
    _add_product(J * calibration, J, out)
    if predicts_deflection:
        _add_product(C, C, out)
    if len(base):
        _, _, _, _, _, base_position = frame
        B, BS = np.eye(6), np.empty((6, 6))
        write_base_jacobian(position, base_position, B)
        multiply(B, base, BS)
        _add_product(BS, B, out)


@kernel
def add_per_scan_covariance(
    uncertainty: PlainTuple, jacobians: CameraJacobians, out: Array
) -> None:
    """Add the covariance (6, 6) by errors that are independent in each scan."""
    J, (per_scan, _, _, _) = jacobians.by_joints, uncertainty
    _add_product(J * per_scan, J, out)


@kernel
def write_base_jacobian(position: Array, base_position: Array, out: Array) -> None:
    """Turn the identity (6, 6) into the Jacobian of the camera's pose by its base's."""
    x = position[0] - base_position[0]
    y = position[1] - base_position[1]
    z = position[2] - base_position[2]
    out[0, 4], out[0, 5] = z, -y
    out[1, 3], out[1, 5] = -z, x
    out[2, 3], out[2, 4] = y, -x


@borrowing_kernel
def _rotate_halves(R: Array, J: Array, out: Array) -> None:
    """Write J (6, m) with both halves, translations and rotation vectors, rotated by R."""
    for half in range(0, 6, 3):
        for i in range(3):
            for j in range(J.shape[1]):
                x, y, z = J[half, j], J[half + 1, j], J[half + 2, j]
                out[half + i, j] = R[i, 0] * x + R[i, 1] * y + R[i, 2] * z


@borrowing_kernel
def _add_product(A: Array, B: Array, out: Array) -> None:
    """Add A B^T (6, 6) of A and B (6, k)."""
    for i in range(6):
        for j in range(6):
            total = 0.0
            for k in range(A.shape[1]):
                total += A[i, k] * B[j, k]
            out[i, j] += total
