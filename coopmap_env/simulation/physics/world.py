"""The physics of one world: its solids, the vehicles among them, and what touches what.

A world has a PyBullet client of its own, new and empty: state that outlives a reset (caches of
contacts, orders of pairs) is what makes Bullet's runs differ, so none is ever used twice.

Suspension: a spring of stiffness k and preload p and a damper d push a body of inertia m, which
the weight and the moving mount load by b, for a step of h with

    tau = b + (p - b - k s - (d + h k) ds/dt) / (1 + (h d + h^2 k) / m)

that is, as they are at the end of the step (implicit Euler): no step is too long for them, what
swings dies down the sooner the longer the step, and the body rests where p - k s = b whatever h and
m. The mount's joints are held by position motors, which Bullet solves implicitly as well, after
torques that carry the weight and accelerate it as planned.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from coopmap_env.geometry.transforms import Pose
from coopmap_env.robots.mount import Mount
from coopmap_env.simulation.physics.client import BulletClient
from coopmap_env.simulation.physics.equilibrium import GRAVITY, Equilibrium
from coopmap_env.simulation.physics.joint_map import JointMap
from coopmap_env.simulation.scenes.field.solid import Solid

STATIC, BODY, FIRST_ARM_BIT = 1, 2, 4
"""Bits of collision groups: solids, bodies of vehicles, and one for each vehicle's arm. Only arms
move, so that all pairs have one in them; links of one arm are kept apart by their limits."""
MAX_VEHICLES = 28
"""Bits that are left."""
OWN_BODY = "its own body"
"""What an arm touches that touches the vehicle under it."""
SOLVER_ITERATIONS = 100
"""Of Bullet's solver, at most; it takes fewer where it can. Joints then miss their targets by some
1e-5 rad; a quarter of it leaves an arm of seven joints so soft that long steps shake it."""


class LoadedVehicle:
    """A vehicle in the physics: its body by PyBullet's `number`, its springs and its motors."""

    def __init__(self, number: int, mount: Mount, joint_map: JointMap, T_world_base: Pose) -> None:
        n = joint_map.n_suspension
        self.number = number
        self.joint_map = joint_map
        self.R, self.t = T_world_base.rotation, T_world_base.translation
        self.home = np.array([*(0.0,) * n, *mount.home])
        self.state: tuple[list[float], list[float]] | None = None
        """Values and velocities of all joints as PyBullet counts them, if they were asked for."""
        self.joint_loads: list[float] | None = None
        """What holds all joints against the weight at that state, if it was asked for."""
        self.springs: Equilibrium | None = None
        self.dof_joints = sorted(joint_map.joints)
        """All joints that can move, as PyBullet counts degrees of freedom."""
        self.q_dofs = [self.dof_joints.index(joint) for joint in joint_map.joints[: len(self.home)]]
        """Where those of q are among them."""
        self.zeros = [0.0] * len(self.dof_joints)
        self.planned_accelerations = self.zeros
        """Accelerations of them all in the next step."""
        self.suspension_dofs = [self.dof_joints.index(joint) for joint in joint_map.joints[:n]]
        """Where heave, roll and pitch are among them."""
        self.spring_rates: list[tuple[int, float, float, float]] = []
        """(where, preload, stiffness, damping) of heave, roll and pitch."""
        self.inertias = [1.0] * n
        """Of heave, roll and pitch, with the mount at home."""
        self.implicit_springs: list[tuple[int, float, float, float, float]] = []
        """Of the formula above: (where, p, k, d + h k, 1 / (1 + (h d + h^2 k) / m))."""
        if mount.suspension is not None:
            springs = self.springs = Equilibrium.from_mount(mount, self.R.T @ [0.0, 0.0, -GRAVITY])
            rows = np.stack([springs.preload, springs.stiffness, springs.damping], axis=1)
            self.spring_rates = [
                (at, row[0], row[1], row[2])
                for at, row in zip(self.suspension_dofs, rows.tolist(), strict=True)
            ]
        self.motor_joints, self.forces = joint_map.joints[n:], joint_map.motor_forces[n:]
        self._motor_dofs = [self.dof_joints.index(joint) for joint in self.motor_joints]
        self.gains = (1.0,) * len(self.motor_joints)  # to the target within one step
        self._values, self._offsets = joint_map.joint_matrix[n:, n:], joint_map.joint_offsets[n:]
        self._has_mimic_joints = len(self.motor_joints) > len(mount.joints)

    def motor_targets(self, joints: NDArray[np.float64]) -> list[float]:
        """Of all driven joints, from those of the mount (n,)."""
        values = self._values @ joints + self._offsets if self._has_mimic_joints else joints
        return values.tolist()

    def plan_accelerations(self, accelerations: NDArray[np.float64] | None) -> None:
        """Take note of those (n,) of the mount's joints in the next step."""
        self.planned_accelerations = self.zeros
        if accelerations is not None:
            values = self._values @ accelerations if self._has_mimic_joints else accelerations
            self.planned_accelerations = self.zeros.copy()
            for at, value in zip(self._motor_dofs, values.tolist(), strict=True):
                self.planned_accelerations[at] = value

    def discretize_springs(self, h: float) -> None:
        """Springs and dampers for steps of h seconds."""
        self.implicit_springs = [
            (at, p, k, d + h * k, 1.0 / (1.0 + (h * d + h * h * k) / m))
            for (at, p, k, d), m in zip(self.spring_rates, self.inertias, strict=True)
        ]


class BulletWorld:
    """Solids and vehicles in a physics engine of their own.

    Configurations q (m,) are [heave, roll, pitch, *joints], or the joints alone where a vehicle
    has no suspension. Vehicles begin at home.

    Parameters
    ----------
    solids : sequence of Solid
        What stands still.
    mounts : sequence of Mount
        One for each vehicle.
    base_poses : sequence of Pose
        T_world_base of each.
    time_step : float, optional
        Of `step`, seconds; `set_time_step` changes it.

    Raises
    ------
    ImportError
        If the extra "field" is not installed.
    ValueError
        If there are more vehicles than collision groups, or not one base pose for each.
    RuntimeError
        From any method, once it is closed.
    """

    def __init__(
        self,
        solids: Sequence[Solid],
        mounts: Sequence[Mount],
        base_poses: Sequence[Pose],
        time_step: float = 1.0 / 30.0,
    ) -> None:
        if not len(mounts) == len(base_poses) <= MAX_VEHICLES:
            raise ValueError(
                f"{len(mounts)} mounts and {len(base_poses)} base poses: one of each for each of "
                f"at most {MAX_VEHICLES} vehicles"
            )
        joint_maps = [JointMap.from_mount(mount) for mount in mounts]
        self.client = BulletClient()
        self.time_step = math.nan
        self.names: dict[int, str] = {}
        """What a body, by PyBullet's number, is called."""
        self.solid_boxes = np.concatenate([np.zeros((0, 2, 3)), *map(self._add_solid, solids)])
        self.vehicles = [
            self._add_vehicle(robot, *parts)
            for robot, parts in enumerate(zip(mounts, joint_maps, base_poses, strict=True))
        ]
        self.client.p.setGravity(0, 0, -GRAVITY, physicsClientId=self.client.id)
        self.client.p.setPhysicsEngineParameter(
            numSolverIterations=SOLVER_ITERATIONS, deterministicOverlappingPairs=1,
            physicsClientId=self.client.id,
        )  # fmt: skip
        self.q = [vehicle.home for vehicle in self.vehicles]
        """Where each vehicle is; `set_configuration` and `velocity` renew it."""
        self._spheres: list[NDArray[np.float64] | None] = [None] * len(mounts)
        self.set_time_step(time_step)
        for robot, vehicle in enumerate(self.vehicles):
            self.set_configuration(robot, vehicle.home)

    def close(self) -> None:
        """Let go of the physics; doing so twice does no harm."""
        self.client.close()

    def set_configuration(self, robot: int, q: NDArray[np.float64]) -> None:
        """Put a vehicle's joints to q (m,), at rest."""
        vehicle, joint_map = self.vehicles[robot], self.vehicles[robot].joint_map
        values = joint_map.joint_matrix @ q + joint_map.joint_offsets
        self.client.p.resetJointStatesMultiDof(
            vehicle.number,
            joint_map.joints,
            values[:, None].tolist(),
            physicsClientId=self.client.id,
        )
        self.q[robot] = q
        self._spheres[robot] = vehicle.state = vehicle.joint_loads = None

    def velocity(self, robot: int) -> NDArray[np.float64]:
        """Velocity (m,) of q after a `step`; `q` itself is renewed as well."""
        vehicle = self.vehicles[robot]
        values, velocities = self._read_joint_states(vehicle)
        self.q[robot] = np.array([values[at] for at in vehicle.q_dofs])
        self._spheres[robot] = None
        return np.array([velocities[at] for at in vehicle.q_dofs])

    def spring_imbalance(self, robot: int) -> float:
        """How far the spring that is furthest from balance is from it, metres or radians."""
        vehicle = self.vehicles[robot]
        if not vehicle.spring_rates:
            return 0.0
        s, v = self._read_joint_states(vehicle)
        b = vehicle.joint_loads = self._inverse_dynamics(vehicle, s, v)
        return max(abs(p - b[at] - k * s[at]) / k for at, p, k, _ in vehicle.spring_rates)

    def rest_configurations(self, robot: int, joints: NDArray[np.float64]) -> NDArray[np.float64]:
        """Joints (k, n) of a mount with the deflections in which its vehicle rests: q (k, m)."""
        springs = self.vehicles[robot].springs
        return joints if springs is None else springs.rest_configurations(joints)

    def find_contacts(self) -> None:
        """Look where vehicles are now, without moving anything; then ask `contacts`."""
        self.client.p.performCollisionDetection(physicsClientId=self.client.id)

    def contacts(self) -> list[tuple[float, str]]:
        """Of each vehicle, how deep its arm is in something, as a negative number, and in what.

        Those of the last `step` or `find_contacts`; (0, "") for an arm that touches nothing.
        """
        deepest = [(0.0, "")] * len(self.vehicles)
        for point in self.client.p.getContactPoints(physicsClientId=self.client.id):
            if point[8] < 0.0:
                _, a, b, link_a, link_b = point[:5]
                for robot, vehicle in enumerate(self.vehicles):
                    own, arm = vehicle.number, vehicle.joint_map.arm
                    mine = (a == own and link_a in arm) or (b == own and link_b in arm)
                    if mine and point[8] < deepest[robot][0]:
                        obstacle = OWN_BODY if a == b else self.names[b if a == own else a]
                        deepest[robot] = point[8], obstacle
        return deepest

    def swept_collisions(
        self,
        robot: int,
        q: NDArray[np.float64],
        others: NDArray[np.float64] | None = None,
        margin: float = 0.0,
    ) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
        """Between which of the configurations q (k, m) an arm might touch; how far each goes.

        Marks (k - 1,) and metres (k - 1,). Other vehicles are where they are, or within spheres
        (o, 4), centres and radii; solids are larger by `margin` on all sides.
        """
        vehicle = self.vehicles[robot]
        if others is None:
            around = [self._spheres_of(o) for o in range(len(self.vehicles)) if o != robot]
            others = np.concatenate([np.zeros((0, 4)), *around])
        solid_boxes = (
            self.solid_boxes
            if margin == 0.0
            else self.solid_boxes + np.array([[-margin], [margin]])
        )
        return vehicle.joint_map.sweep_model.swept_collisions(
            vehicle.R, vehicle.t, q, solid_boxes, others
        )

    def spheres(self, robot: int, q: NDArray[np.float64]) -> NDArray[np.float64]:
        """Centres and radii (s, 4), in the world, of spheres around all links at q (m,)."""
        vehicle = self.vehicles[robot]
        return vehicle.joint_map.sweep_model.spheres(vehicle.R, vehicle.t, q)

    def set_time_step(self, time_step: float) -> None:
        """Make steps of so many seconds from now on."""
        if time_step != self.time_step:
            self.time_step = time_step
            self.client.p.setTimeStep(time_step, physicsClientId=self.client.id)
            for vehicle in self.vehicles:
                vehicle.discretize_springs(time_step)

    def set_motor_targets(
        self,
        robot: int,
        joints: NDArray[np.float64],
        accelerations: NDArray[np.float64] | None = None,
    ) -> None:
        """Set the targets (n,) that the motors of a mount's joints hold from now on.

        `accelerations` (n,) are those by which they get there in the next step, as far as known.
        """
        vehicle = self.vehicles[robot]
        vehicle.plan_accelerations(accelerations)
        self.client.p.setJointMotorControlArray(
            vehicle.number, vehicle.motor_joints, self.client.p.POSITION_CONTROL,
            vehicle.motor_targets(joints), forces=vehicle.forces, positionGains=vehicle.gains,
            velocityGains=vehicle.gains, physicsClientId=self.client.id,
        )  # fmt: skip

    def step(self) -> None:
        """One time step of all vehicles, as long as `set_time_step` made it."""
        client = self.client.id
        for vehicle in self.vehicles:
            self._apply_torques(vehicle, client)
            vehicle.planned_accelerations = vehicle.zeros
            vehicle.state = vehicle.joint_loads = None
        self.client.p.stepSimulation(physicsClientId=client)

    def _apply_torques(self, vehicle: LoadedVehicle, client: int) -> None:
        """Torques for one step: of the springs, and of the motors what carries the weight.

        Without it the solver of the motors needs hundreds of iterations: they lift a whole arm.
        """
        p = self.client.p
        s, v = self._read_joint_states(vehicle)
        forces = vehicle.joint_loads
        if forces is None or vehicle.planned_accelerations is not vehicle.zeros:
            forces = self._inverse_dynamics(vehicle, s, v)
        for at, preload, stiffness, damping, gain in vehicle.implicit_springs:
            b = forces[at]
            forces[at] = b + gain * (preload - b - stiffness * s[at] - damping * v[at])
        p.setJointMotorControlArray(
            vehicle.number, vehicle.dof_joints, p.TORQUE_CONTROL, forces=forces,
            physicsClientId=client,
        )  # fmt: skip

    def _inverse_dynamics(
        self, vehicle: LoadedVehicle, s: list[float], v: list[float]
    ) -> list[float]:
        """What gives all joints their planned accelerations at a state, springs left out."""
        return list(
            self.client.p.calculateInverseDynamics(
                vehicle.number, s, v, vehicle.planned_accelerations, physicsClientId=self.client.id
            )
        )

    def _read_joint_states(self, vehicle: LoadedVehicle) -> tuple[list[float], list[float]]:
        """Values and velocities of all joints as PyBullet counts them; once for each step."""
        if vehicle.state is None:
            states = self.client.p.getJointStates(
                vehicle.number, vehicle.dof_joints, physicsClientId=self.client.id
            )
            vehicle.state = [state[0] for state in states], [state[1] for state in states]
        return vehicle.state

    def _spheres_of(self, robot: int) -> NDArray[np.float64]:
        """Spheres (s, 4) around all links of a vehicle where it is."""
        spheres = self._spheres[robot]
        if spheres is None:
            spheres = self._spheres[robot] = self.spheres(robot, self.q[robot])
        return spheres

    def _add_solid(self, solid: Solid) -> NDArray[np.float64]:
        """Its boxes (b, 2, 3)."""
        p, k = self.client.p, {"physicsClientId": self.client.id}
        shapes = [solid.vertices] if solid.is_concave else solid.parts
        for points in shapes:
            shape = self.client.create_shape(points, solid.faces if solid.is_concave else None)
            # a plain rigid body, not one of Bullet's multi-bodies: half the price of a step
            number = p.createMultiBody(0, shape, useMaximalCoordinates=1, **k)
            p.setCollisionFilterGroupMask(number, -1, STATIC, ~(STATIC | BODY), **k)
            self.names[number] = solid.name
        return np.array([[points.min(axis=0), points.max(axis=0)] for points in shapes])

    def _add_vehicle(
        self, robot: int, mount: Mount, joint_map: JointMap, T_world_base: Pose
    ) -> LoadedVehicle:
        p, k = self.client.p, {"physicsClientId": self.client.id}
        number = self.client.load_mount(mount, T_world_base)
        self.names[number] = f"robot_{robot}"
        arm = FIRST_ARM_BIT << robot
        for j in range(-1, len(joint_map.link_names) - 1):
            group, mask = (arm, ~arm) if j in joint_map.arm else (BODY, ~(STATIC | BODY))
            p.setCollisionFilterGroupMask(number, j, group, mask, **k)
        for a, b in joint_map.ignored_pairs:
            p.setCollisionFilterPair(number, number, a, b, 0, **k)
        vehicle = LoadedVehicle(number, mount, joint_map, T_world_base)
        if vehicle.spring_rates:
            suspension = joint_map.joints[: joint_map.n_suspension]
            idle = [0.0] * len(suspension)  # or Bullet's own motors would brake it
            p.setJointMotorControlArray(number, suspension, p.VELOCITY_CONTROL, forces=idle, **k)
            values = joint_map.joint_matrix @ vehicle.home + joint_map.joint_offsets
            at_home = dict(zip(joint_map.joints, values.tolist(), strict=True))
            M = p.calculateMassMatrix(number, [at_home[j] for j in vehicle.dof_joints], **k)
            vehicle.inertias = [M[at][at] for at in vehicle.suspension_dofs]
        return vehicle
