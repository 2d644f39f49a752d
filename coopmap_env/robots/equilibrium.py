"""Where a vehicle's body comes to rest on its suspension; see `_spring_kernels`."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.caches import freeze
from coopmap_env.core.kernels import PlainTuple
from coopmap_env.core.linear_algebra import product
from coopmap_env.robots._spring_kernels import (
    MassModel,
    Springs,
    center_of_mass_offset,
    solve_equilibrium,
)
from coopmap_env.robots.kinematics.chain import Chain
from coopmap_env.robots.kinematics.forward import KinematicTree, allocate_body_poses, frame_poses
from coopmap_env.robots.mount import Mount

GRAVITY = 9.81
"""m/s^2, along -z of the world."""
GRAVITY_VECTOR = (0.0, 0.0, -GRAVITY)
N_SUSPENSION = 3
"""Heave, roll and pitch come first among the joints of a chain on its suspension."""
PlainEquilibrium = tuple[PlainTuple, PlainTuple, NDArray[np.float64]]
"""A plain `MassModel` with a plain tree, plain `Springs`, and `Equilibrium.compliance`."""


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
        """The same vehicle on other springs; see `compliance` (2,).

        Raises
        ------
        ValueError
            If these are not two finite numbers above 0.
        """
        if compliance.shape != (2,) or not all(0.0 < c < math.inf for c in compliance.tolist()):
            raise ValueError(
                f"compliance must be two finite numbers above 0, got {compliance.tolist()}"
            )
        compliance, stiffness = np.array(compliance, np.float64), self.springs.stiffness.copy()
        stiffness[1:] *= self.compliance / compliance
        springs = self.springs._replace(stiffness=stiffness)
        return replace(self, springs=springs, compliance=compliance)

    @cached_property
    def plain(self) -> PlainEquilibrium:
        """The equilibrium as kernels take it."""
        model = (tuple(self.model.tree), *self.model[1:])
        return model, tuple(self.springs), self.compliance

    @staticmethod
    def plain_without_springs(tree: KinematicTree) -> PlainEquilibrium:
        """Nothing, in the types of `plain`: kernels are not compiled once more for it."""
        masses = freeze((np.zeros(0), np.zeros((0, 3)), np.zeros(3)))
        return (tuple(tree), *masses), (np.zeros(3), np.zeros(3), np.zeros(3)), np.ones(2)

    def rest_configurations(self, joints: NDArray[np.float64]) -> NDArray[np.float64]:
        """Joints (k, n) of the mount with the deflections before them: (k, 3 + n)."""
        q = np.empty((len(joints), N_SUSPENSION + joints.shape[1]))
        q[:, N_SUSPENSION:] = joints
        solve_equilibrium(*self.plain[:2], q)
        return q


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
    bodies, q = np.arange(N_SUSPENSION + 1), np.zeros((1, tree.variable.max() + 1))
    turned, moved = np.tile(np.eye(3), (len(bodies), 1, 1)), np.zeros((len(bodies), 3))
    R, t = np.empty((len(bodies), 3, 3)), np.empty((len(bodies), 3))
    frame_poses(tree, q, bodies, turned, moved, R[None], t[None])
    axes = [product(R[b], tree.axis[b]) for b in range(1, N_SUSPENSION + 1)]
    in_a_row = (tree.parent[1:4] == [0, 1, 2]).all() and (tree.variable[1:4] == [0, 1, 2]).all()
    if not (in_a_row and np.allclose(axes, np.eye(3)[[2, 0, 1]]) and np.allclose(t[2], t[3])):
        raise ValueError(
            f"the suspension of {name!r} must be heave along z, then roll about x and pitch "
            f"about y through one point; its axes are {np.round(axes, 6).tolist()}"
        )
    return t[2]
