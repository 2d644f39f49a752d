"""Kernels of a body at rest on its springs, at given joints of its mount.

With the deflections s = (heave h, roll r, pitch p), the stiffness K, the preload P and the weight w
(mass times gravity) of all that the springs carry, whose center of mass lies at u from the center
of roll and pitch, the potential energy is

    V(s) = s^T K s / 2 - P^T s - w^T (h e_z + R_x(r) R_y(p) u)

and the body rests where its gradient vanishes. The preload makes that s = 0 at home. Heave stays 0
in every posture, as the weight does not change; roll and pitch follow by Newton's method.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.elementary import sin_cos
from coopmap_env.core.kernels import PlainTuple, borrowing_kernel, kernel
from coopmap_env.robots.kinematics.forward import (
    BodyPoses,
    KinematicTree,
    allocate_body_poses,
    body_poses,
)

JOINT_STEP = 1e-3
"""Radians or metres, of the differences by which the load's change with a joint is found."""


class MassModel(NamedTuple):
    """Rigid bodies with their masses; body 0 stands on the ground."""

    tree: KinematicTree
    masses: NDArray[np.float64]
    """Shape (b,): kilograms."""
    centers: NDArray[np.float64]
    """Shape (b, 3): centers of mass in the frames of the bodies."""
    pivot: NDArray[np.float64]
    """Shape (3,): where the axes of roll and pitch intersect at rest, base frame."""


class Springs(NamedTuple):
    """Springs of heave, roll and pitch, and what they carry."""

    weight: NDArray[np.float64]
    """Shape (3,): newtons, base frame."""
    stiffness: NDArray[np.float64]
    """Shape (3,): N/m, N m/rad, N m/rad."""
    preload: NDArray[np.float64]
    """Shape (3,): N, N m, N m: spring forces at home."""


@kernel
def center_of_mass_offset(
    model: MassModel,
    q: NDArray[np.float64],
    work: BodyPoses,
    out: NDArray[np.float64],
) -> None:
    """Write the center of mass (3,) at q (3 + n,), from the pivot.

    `work` is what `allocate_body_poses` made.
    """
    R, t = work[0], work[1]
    body_poses(model.tree, q, work)
    out[:] = 0.0
    total = 0.0
    for b in range(1, len(model.masses)):
        c, mass = model.centers[b], model.masses[b]
        for i in range(3):
            at = t[b, i] + R[b, i, 0] * c[0] + R[b, i, 1] * c[1] + R[b, i, 2] * c[2]
            out[i] += mass * at
        total += mass
    for i in range(3):
        out[i] = out[i] / total - model.pivot[i]


class EnergyDerivatives(NamedTuple):
    """Derivatives of V with respect to roll and pitch."""

    roll: float
    pitch: float
    roll_roll: float
    roll_pitch: float
    pitch_pitch: float


@borrowing_kernel
def energy_derivatives(
    r: float, p: float, u: NDArray[np.float64], springs: Springs
) -> EnergyDerivatives:
    """Gradient and Hessian of V at roll r and pitch p, with the center of mass at u (3,)."""
    w = springs.weight
    k_roll, k_pitch = springs.stiffness[1], springs.stiffness[2]
    (sr, cr), (sp, cp) = sin_cos(r), sin_cos(p)
    vx, vy, vz = cp * u[0] + sp * u[2], u[1], cp * u[2] - sp * u[0]  # R_y u
    dx, dz = vz, -vx  # its derivative; the second one is (-vx, 0, -vz)
    return EnergyDerivatives(
        k_roll * r
        - springs.preload[1]
        - (w[1] * (-sr * vy - cr * vz) + w[2] * (cr * vy - sr * vz)),
        k_pitch * p - springs.preload[2] - (w[0] * dx - w[1] * sr * dz + w[2] * cr * dz),
        k_roll + w[1] * (cr * vy - sr * vz) + w[2] * (sr * vy + cr * vz),
        w[1] * cr * dz + w[2] * sr * dz,
        k_pitch + w[0] * vx - w[1] * sr * vz + w[2] * cr * vz,
    )


@borrowing_kernel
def solve_roll_pitch(u: NDArray[np.float64], springs: Springs) -> tuple[float, float]:
    """Where the gradient of V vanishes, by Newton's method from the unloaded attitude."""
    r = p = 0.0
    for _ in range(20):
        d = energy_derivatives(r, p, u, springs)
        determinant = d.roll_roll * d.pitch_pitch - d.roll_pitch * d.roll_pitch
        step_r = (d.pitch_pitch * d.roll - d.roll_pitch * d.pitch) / determinant
        step_p = (d.roll_roll * d.pitch - d.roll_pitch * d.roll) / determinant
        r -= step_r
        p -= step_p
        if abs(step_r) + abs(step_p) < 1e-13:
            break
    return r, p


@kernel
def solve_equilibrium(
    plain_model: PlainTuple, plain_springs: PlainTuple, q: NDArray[np.float64]
) -> None:
    """Overwrite the first three of the joints q (k, 3 + n) by the deflections at rest.

    `plain_model` is a plain `MassModel` with a plain tree, `plain_springs` a plain `Springs`.
    """
    tree, masses, centers, pivot = plain_model
    model = MassModel(KinematicTree(*tree), masses, centers, pivot)
    springs = Springs(*plain_springs)
    work, u = allocate_body_poses(model.tree), np.empty(3)
    for k in range(len(q)):
        q[k, :3] = 0.0
        center_of_mass_offset(model, q[k], work, u)
        q[k, 0] = (springs.preload[0] + springs.weight[2]) / springs.stiffness[0]
        q[k, 1], q[k, 2] = solve_roll_pitch(u, springs)


@kernel
def load_response(
    plain_model: PlainTuple,
    plain_springs: PlainTuple,
    q: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:
    """Write how roll and pitch at rest change with compliances and joints: (2, 2 + n).

    The first two columns are by the relative compliances of roll and pitch: where the gradient
    vanishes at q (3 + n,), it keeps doing so, H ds = K s dc / c for compliances c = 1 / K, with the
    Hessian H of V. The others are central differences.
    """
    tree, masses, centers, pivot = plain_model
    model = MassModel(KinematicTree(*tree), masses, centers, pivot)
    springs = Springs(*plain_springs)
    work, u, unloaded = allocate_body_poses(model.tree), np.empty(3), q.copy()
    unloaded[:3] = 0.0
    center_of_mass_offset(model, unloaded, work, u)
    d = energy_derivatives(q[1], q[2], u, springs)
    determinant = d.roll_roll * d.pitch_pitch - d.roll_pitch * d.roll_pitch
    roll, pitch = springs.stiffness[1] * q[1], springs.stiffness[2] * q[2]
    out[0, 0] = d.pitch_pitch * roll / determinant
    out[1, 0] = -d.roll_pitch * roll / determinant
    out[0, 1] = -d.roll_pitch * pitch / determinant
    out[1, 1] = d.roll_roll * pitch / determinant
    for joint in range(3, len(q)):
        unloaded[joint] = q[joint] + JOINT_STEP
        center_of_mass_offset(model, unloaded, work, u)
        roll, pitch = solve_roll_pitch(u, springs)
        unloaded[joint] = q[joint] - JOINT_STEP
        center_of_mass_offset(model, unloaded, work, u)
        roll_below, pitch_below = solve_roll_pitch(u, springs)
        unloaded[joint] = q[joint]
        out[0, joint - 1] = (roll - roll_below) / (2.0 * JOINT_STEP)
        out[1, joint - 1] = (pitch - pitch_below) / (2.0 * JOINT_STEP)
