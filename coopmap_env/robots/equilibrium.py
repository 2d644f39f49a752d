"""Where a vehicle's body comes to rest on its suspension, at given joints of its mount.

With the deflections s = (heave h, roll r, pitch p), the stiffness K, the preload P and the weight w
(mass times gravity) of all that the springs carry, whose center of mass lies at u from the center
of roll and pitch, the potential energy is

    V(s) = s^T K s / 2 - P^T s - w^T (h e_z + R_x(r) R_y(p) u)

and the body rests where its gradient vanishes. The preload makes that s = 0 at home. Heave stays 0
in every posture, as the weight does not change; roll and pitch follow by Newton's method.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.caches import freeze
from coopmap_env.core.elementary import sin_cos
from coopmap_env.core.kernels import PlainTuple, kernel
from coopmap_env.core.linear_algebra import product
from coopmap_env.robots.kinematics.chain import Chain
from coopmap_env.robots.kinematics.forward import (
    BodyPoses,
    KinematicTree,
    allocate_body_poses,
    body_poses,
)
from coopmap_env.robots.mount import Mount

GRAVITY = 9.81
"""m/s^2, along -z of the world."""
N_SUSPENSION = 3
"""Heave, roll and pitch come first among the joints of a chain on its suspension."""
GRAVITY_VECTOR = (0.0, 0.0, -GRAVITY)


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


@kernel
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


@kernel
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
def compliance_response(
    plain_model: PlainTuple,
    plain_springs: PlainTuple,
    q: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:
    """Write how much roll and pitch at rest grow with the compliance of either, relatively: (2, 2).

    Where the gradient vanishes at q (3 + n,), it keeps doing so: H ds = K s dc / c for compliances
    c = 1 / K, with the Hessian H of V.
    """
    tree, masses, centers, pivot = plain_model
    model = MassModel(KinematicTree(*tree), masses, centers, pivot)
    springs = Springs(*plain_springs)
    unloaded, u = q.copy(), np.empty(3)
    unloaded[:3] = 0.0
    center_of_mass_offset(model, unloaded, allocate_body_poses(model.tree), u)
    d = energy_derivatives(q[1], q[2], u, springs)
    determinant = d.roll_roll * d.pitch_pitch - d.roll_pitch * d.roll_pitch
    roll, pitch = springs.stiffness[1] * q[1], springs.stiffness[2] * q[2]
    out[0, 0] = d.pitch_pitch * roll / determinant
    out[1, 0] = -d.roll_pitch * roll / determinant
    out[0, 1] = -d.roll_pitch * pitch / determinant
    out[1, 1] = d.roll_roll * pitch / determinant


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """Static equilibrium of a mount's vehicle on its suspension; see `from_mount`."""

    model: MassModel
    springs: Springs
    damping: NDArray[np.float64]
    """Shape (3,): N s/m, N m s/rad, N m s/rad."""
    home_offset: NDArray[np.float64]
    """Shape (3,): center of mass at home, from the pivot, metres."""
    compliance: NDArray[np.float64] = field(default_factory=lambda: np.ones(2))
    """Shape (2,): that of roll and pitch, as a multiple of what the mount's description gives."""

    @classmethod
    def from_mount(cls, mount: Mount, gravity: ArrayLike = GRAVITY_VECTOR) -> Equilibrium:
        """Read masses from the mount's URDF and preload the springs for its home.

        Parameters
        ----------
        mount : Mount
        gravity : array_like, shape (3,), optional
            In the base frame, m/s^2: not straight down where a vehicle stands on a slope.

        Raises
        ------
        ValueError
            If the mount has no suspension, or its joints are not heave along z, then roll about
            x and pitch about y through one point.
        """
        chain = mount.chain(with_suspension=True)
        assert mount.suspension is not None  # or it would have no such chain
        model = _mass_model(chain, mount.name)
        home, u = np.array([0.0, 0.0, 0.0, *mount.home]), np.empty(3)
        center_of_mass_offset(model, home, allocate_body_poses(model.tree), u)
        stiffness = np.array(mount.suspension.stiffness)
        springs = _preloaded_springs(model, u, stiffness, gravity)
        return cls(model, springs, np.array(mount.suspension.damping), u)

    def with_gravity(self, gravity: ArrayLike) -> Equilibrium:
        """The same vehicle on another slope; gravity (3,) in the base frame, m/s^2."""
        stiffness = self.springs.stiffness
        springs = _preloaded_springs(self.model, self.home_offset, stiffness, gravity)
        return replace(self, springs=springs)

    def with_compliance(self, compliance: NDArray[np.float64]) -> Equilibrium:
        """The same vehicle on other springs; see `compliance` (2,)."""
        stiffness = self.springs.stiffness.copy()
        stiffness[1:] *= self.compliance / compliance
        springs = self.springs._replace(stiffness=stiffness)
        return replace(self, springs=springs, compliance=compliance)

    @cached_property
    def _plain_model(self) -> PlainTuple:
        return tuple(self.model.tree), *self.model[1:]

    def rest_configurations(self, joints: NDArray[np.float64]) -> NDArray[np.float64]:
        """Joints (k, n) of the mount with the deflections before them: (k, 3 + n)."""
        q = np.empty((len(joints), N_SUSPENSION + joints.shape[1]))
        q[:, N_SUSPENSION:] = joints
        solve_equilibrium(self._plain_model, tuple(self.springs), q)
        return q

    def compliance_jacobian(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        """Derivatives (2, 2) of roll and pitch at rest q (3 + n,) with respect to `compliance`."""
        out = np.empty((2, 2))
        compliance_response(self._plain_model, tuple(self.springs), q, out)
        return np.asarray(out / self.compliance)


@lru_cache(maxsize=32)
def _mass_model(chain: Chain, name: str) -> MassModel:
    """Rigid bodies of a mount on its suspension; `name` is that of the mount, for errors."""
    tree, n_bodies = chain.tree, len(chain.tree.parent)
    masses, moments = np.zeros(n_bodies), np.zeros((n_bodies, 3))
    in_body = product(chain.link_rotations, chain.centers_of_mass[..., None])[..., 0]
    np.add.at(masses, chain.link_body, chain.masses)
    np.add.at(moments, chain.link_body, chain.masses[:, None] * (chain.link_translations + in_body))
    centers = np.divide(
        moments, masses[:, None], out=np.zeros_like(moments), where=masses[:, None] > 0
    )
    masses[0] = 0.0
    return freeze(MassModel(tree, masses, centers, _pivot(name, tree)))


def _preloaded_springs(
    model: MassModel,
    home_offset: NDArray[np.float64],
    stiffness: NDArray[np.float64],
    gravity: ArrayLike,
) -> Springs:
    """Springs that carry the weight without a deflection where its center is at `home_offset`."""
    u, weight = home_offset, model.masses.sum() * np.asarray(gravity, dtype=np.float64)
    preload = -np.array(  # minus what the weight does to heave, roll and pitch at s = 0
        [weight[2], weight[2] * u[1] - weight[1] * u[2], weight[0] * u[2] - weight[2] * u[0]]
    )
    return Springs(weight, stiffness, preload)


def _pivot(name: str, tree: KinematicTree) -> NDArray[np.float64]:
    """Point about which the body rolls and pitches."""
    work = allocate_body_poses(tree)
    R, t = work[0], work[1]
    body_poses(tree, np.zeros(tree.variable.max() + 1), work)
    axes = [product(R[b], tree.axis[b]) for b in range(1, N_SUSPENSION + 1)]
    in_a_row = (tree.parent[1:4] == [0, 1, 2]).all() and (tree.variable[1:4] == [0, 1, 2]).all()
    if not (in_a_row and np.allclose(axes, np.eye(3)[[2, 0, 1]]) and np.allclose(t[2], t[3])):
        raise ValueError(
            f"the suspension of {name!r} must be heave along z, then roll about x and pitch "
            f"about y through one point; its axes are {np.round(axes, 6).tolist()}"
        )
    return t[2]
