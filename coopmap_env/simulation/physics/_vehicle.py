"""One vehicle as the physics engine knows it: its joints, its springs and its motors."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.linear_algebra import product
from coopmap_env.geometry import Pose
from coopmap_env.robots import GRAVITY, Equilibrium, Mount
from coopmap_env.simulation.physics._joint_map import JointMap


class SpringRates(NamedTuple):
    """Spring and damper of heave, roll or pitch."""

    dof: int
    """Index among `LoadedVehicle.dof_joints`."""
    preload: float
    stiffness: float
    damping: float


class ImplicitSpring(NamedTuple):
    """Spring and damper for one length of step; the formula is that of `world`."""

    dof: int
    preload: float
    stiffness: float
    damping: float
    """d + h k."""
    gain: float
    """1 / (1 + (h d + h^2 k) / m)."""


class LoadedVehicle:
    """A vehicle in the physics: PyBullet's number of its body, its springs and its motors."""

    def __init__(self, number: int, mount: Mount, joint_map: JointMap, T_world_base: Pose) -> None:
        n = joint_map.n_suspension
        self.number = number
        self.joint_map = joint_map
        self.T_world_base = T_world_base.arrays
        self.home = np.array([*(0.0,) * n, *mount.home])
        self.state: tuple[list[float], list[float]] | None = None
        """Values and velocities of all joints as PyBullet counts them, if read since the step."""
        self.joint_loads: list[float] | None = None
        """Forces that hold all joints against the weight in that state, if computed."""
        self.dof_joints = sorted(joint_map.joints)
        """All joints that can move, as PyBullet counts degrees of freedom."""
        self.q_dofs = [self.dof_joints.index(joint) for joint in joint_map.joints[: len(self.home)]]
        """Indices of the entries of q among them."""
        self.zeros = [0.0] * len(self.dof_joints)
        self.planned_accelerations = self.zeros
        """Accelerations of all joints in the next step."""
        self.suspension_dofs = [self.dof_joints.index(joint) for joint in joint_map.joints[:n]]
        """Indices of heave, roll and pitch among them."""
        self.inertias = [1.0] * n
        """Inertias of heave, roll and pitch, with the mount at home."""
        self.springs: Equilibrium | None = None
        self.spring_rates: list[SpringRates] = []
        self.implicit_springs: list[ImplicitSpring] = []
        if mount.suspension is not None:
            self.springs = Equilibrium.from_mount(
                mount, product(T_world_base.rotation.T, [0.0, 0.0, -GRAVITY])
            )
            self.spring_rates = self._read_spring_rates(self.springs)
        self.motor_joints, self.motor_forces = joint_map.joints[n:], joint_map.motor_forces[n:]
        self.motor_gains = (1.0,) * len(self.motor_joints)  # to the target within one step
        self._motor_dofs = [self.dof_joints.index(joint) for joint in self.motor_joints]
        self._motor_matrix = joint_map.joint_matrix[n:, n:]
        self._motor_offsets = joint_map.joint_offsets[n:]
        self._has_mimic_joints = len(self.motor_joints) > len(mount.joints)

    def _read_spring_rates(self, springs: Equilibrium) -> list[SpringRates]:
        preload, stiffness = springs.springs.preload, springs.springs.stiffness
        rows = np.stack([preload, stiffness, springs.damping], axis=1).tolist()
        return [SpringRates(dof, *row) for dof, row in zip(self.suspension_dofs, rows, strict=True)]

    def motor_targets(self, joints: NDArray[np.float64]) -> list[float]:
        """Targets of all motors, from the joints (n,) of the mount."""
        values = joints
        if self._has_mimic_joints:
            values = product(self._motor_matrix, joints) + self._motor_offsets
        return values.tolist()

    def plan_accelerations(self, accelerations: NDArray[np.float64] | None) -> None:
        """Set the accelerations (n,) of the mount's joints in the next step."""
        self.planned_accelerations = self.zeros
        if accelerations is not None:
            values = (
                product(self._motor_matrix, accelerations)
                if self._has_mimic_joints
                else accelerations
            )
            self.planned_accelerations = self.zeros.copy()
            for dof, value in zip(self._motor_dofs, values.tolist(), strict=True):
                self.planned_accelerations[dof] = value

    def discretize_springs(self, h: float) -> None:
        """Prepare springs and dampers for steps of h seconds."""
        self.implicit_springs = [
            ImplicitSpring(dof, p, k, d + h * k, 1.0 / (1.0 + (h * d + h * h * k) / m))
            for (dof, p, k, d), m in zip(self.spring_rates, self.inertias, strict=True)
        ]
