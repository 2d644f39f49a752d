"""The physics of one world: its solids, the vehicles among them, and their contacts.

A world has a PyBullet client of its own, new and empty. State that outlives a reset (caches of
contacts, orders of pairs) makes Bullet's runs differ, so no client is used twice.

Suspension: a spring of stiffness k and preload p and a damper d push a body of inertia m, which
the weight and the moving mount load by b, for a step of h with

    tau = b + (p - b - k s - (d + h k) ds/dt) / (1 + (h d + h^2 k) / m)

that is, as they are at the end of the step (implicit Euler). It is stable for every step; longer
steps damp oscillations more, and the body rests where p - k s = b whatever h and m. The mount's
joints are held by position motors, which Bullet solves implicitly as well, after torques that
carry the weight and accelerate it as planned.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.linear_algebra import are_finite, product
from coopmap_env.geometry import Pose, Spheres, join_spheres
from coopmap_env.robots import GRAVITY, Mount
from coopmap_env.simulation.physics._joint_map import JointMap
from coopmap_env.simulation.physics._loading import (
    MAX_VEHICLES,
    load_solid,
    load_vehicle,
    part_boxes,
)
from coopmap_env.simulation.physics._sweep import SweepObstacles
from coopmap_env.simulation.physics._vehicle import LoadedVehicle
from coopmap_env.simulation.physics.client import BulletClient
from coopmap_env.simulation.scenes.field.solid import Solid

OWN_BODY = "its own body"
"""Name of the vehicle under an arm, as an obstacle to it."""
SOLVER_ITERATIONS = 100
"""Of Bullet's solver, at most; it takes fewer where it can. Joints then miss their targets by some
1e-5 rad; with a quarter of the iterations an arm of seven joints shakes in long steps."""


class ArmContact(NamedTuple):
    """The deepest contact of a vehicle's arm."""

    depth: float
    """Metres, negative: how deep it is; 0 without a contact."""
    obstacle: str
    """What the arm touches; empty without a contact."""


NO_CONTACT = ArmContact(0.0, "")


class BulletWorld:
    """Solids and vehicles in a physics engine of their own.

    Configurations q (m,) are ``[heave, roll, pitch, *joints]``, or the joints alone where a vehicle
    has no suspension. Vehicles begin at home.

    Parameters
    ----------
    solids : sequence of Solid
        What does not move.
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
        self._client = BulletClient()
        self._unplaced: set[int] = set()
        self.time_step = math.nan
        self.names: dict[int, str] = {}
        """Name of each body, by PyBullet's number."""
        for solid in solids:
            for number in load_solid(self.client, solid):
                self.names[number] = solid.name
        self.solid_boxes = np.concatenate([np.zeros((0, 2, 3)), *map(part_boxes, solids)])
        self.vehicles = [
            load_vehicle(self.client, robot, mount, joint_map, T_world_base)
            for robot, (mount, joint_map, T_world_base) in enumerate(
                zip(mounts, joint_maps, base_poses, strict=True)
            )
        ]
        for robot, vehicle in enumerate(self.vehicles):
            self.names[vehicle.number] = f"robot_{robot}"
        self.client.p.setGravity(0, 0, -GRAVITY, physicsClientId=self.client.id)
        self.client.p.setPhysicsEngineParameter(
            numSolverIterations=SOLVER_ITERATIONS,
            deterministicOverlappingPairs=1,
            physicsClientId=self.client.id,
        )
        self.q = [vehicle.home for vehicle in self.vehicles]
        """Configuration of each vehicle; `set_configuration` and `velocity` update it."""
        self._spheres: list[Spheres | None] = [None] * len(mounts)
        self.set_time_step(time_step)
        for robot, vehicle in enumerate(self.vehicles):
            self.set_configuration(robot, vehicle.home)

    @property
    def client(self) -> BulletClient:
        """The physics engine, with all vehicles where they were set."""
        if self._unplaced:
            for robot in sorted(self._unplaced):
                self._place(robot)
            self._unplaced.clear()
        return self._client

    def close(self) -> None:
        """Release the physics; doing so twice does no harm."""
        self._client.close()

    def set_configuration(self, robot: int, q: NDArray[np.float64]) -> None:
        """Set a vehicle's joints to q (m,), at rest.

        The physics engine is given it before the next query: most motions pass nothing.

        Raises
        ------
        ValueError
            If there are not m values, or one is not finite.
        """
        self._client.check_open()
        vehicle, q = self.vehicles[robot], np.array(q, dtype=np.float64)
        if q.shape != vehicle.home.shape or not are_finite(q):
            raise ValueError(
                f"the configuration of robot {robot} must be {len(vehicle.home)} finite values, "
                f"got {q}"
            )
        self.q[robot] = q
        self._spheres[robot] = vehicle.state = vehicle.joint_loads = None
        self._unplaced.add(robot)

    def _place(self, robot: int) -> None:
        """Tell the physics engine a vehicle's configuration."""
        vehicle, joint_map = self.vehicles[robot], self.vehicles[robot].joint_map
        values = product(joint_map.joint_matrix, self.q[robot]) + joint_map.joint_offsets
        self._client.p.resetJointStatesMultiDof(
            vehicle.number,
            joint_map.joints,
            values[:, None].tolist(),
            physicsClientId=self._client.id,
        )

    def velocity(self, robot: int) -> NDArray[np.float64]:
        """Velocity (m,) of q after a `step`; updates `q` as well."""
        vehicle = self.vehicles[robot]
        values, velocities = self._read_joint_states(vehicle)
        self.q[robot] = np.array([values[dof] for dof in vehicle.q_dofs])
        self._spheres[robot] = None
        return np.array([velocities[dof] for dof in vehicle.q_dofs])

    def spring_imbalance(self, robot: int) -> float:
        """Largest distance of a spring from its equilibrium under the load, metres or radians."""
        vehicle = self.vehicles[robot]
        if not vehicle.spring_rates:
            return 0.0
        s, v = self._read_joint_states(vehicle)
        b = vehicle.joint_loads = self._inverse_dynamics(vehicle, s, v)
        return max(abs(p - b[dof] - k * s[dof]) / k for dof, p, k, _ in vehicle.spring_rates)

    def rest_configurations(self, robot: int, joints: NDArray[np.float64]) -> NDArray[np.float64]:
        """Configurations q (k, m) at rest, from joints (k, n) of the mount."""
        springs = self.vehicles[robot].springs
        return joints if springs is None else springs.rest_configurations(joints)

    def find_contacts(self) -> None:
        """Detect contacts where vehicles are now, without moving anything; see `contacts`."""
        self.client.p.performCollisionDetection(physicsClientId=self.client.id)

    def contacts(self) -> list[ArmContact]:
        """The deepest contact of each vehicle's arm, of the last `step` or `find_contacts`."""
        deepest = [NO_CONTACT] * len(self.vehicles)
        for point in self.client.p.getContactPoints(physicsClientId=self.client.id):
            _, a, b, link_a, link_b, _, _, _, depth = point[:9]
            if depth < 0.0:
                for robot, vehicle in enumerate(self.vehicles):
                    own, arm = vehicle.number, vehicle.joint_map.arm
                    is_own = (a == own and link_a in arm) or (b == own and link_b in arm)
                    if is_own and depth < deepest[robot].depth:
                        obstacle = OWN_BODY if a == b else self.names[b if a == own else a]
                        deepest[robot] = ArmContact(depth, obstacle)
        return deepest

    def swept_collisions(
        self,
        robot: int,
        q: NDArray[np.float64],
        others: Spheres | None = None,
        margin: float = 0.0,
    ) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
        """Between which of the configurations q (k, m) an arm might touch something.

        `others` are spheres around all other vehicles, where they are now by default; solids are
        enlarged by `margin` metres on all sides. Returns marks (k - 1,), and metres (k - 1,) that
        the fastest part of the arm goes.
        """
        vehicle = self.vehicles[robot]
        if others is None:
            others = join_spheres(
                [self._current_spheres(o) for o in range(len(self.vehicles)) if o != robot]
            )
        boxes = self.solid_boxes
        if margin != 0.0:
            boxes = boxes + np.array([[-margin], [margin]])
        return vehicle.joint_map.sweep_model.swept_collisions(
            vehicle.T_world_base, q, SweepObstacles(boxes, others)
        )

    def spheres(self, robot: int, q: NDArray[np.float64]) -> Spheres:
        """Spheres in the world around all links at q (m,)."""
        vehicle = self.vehicles[robot]
        return vehicle.joint_map.sweep_model.spheres(vehicle.T_world_base, q)

    def set_time_step(self, time_step: float) -> None:
        """Set the length of the steps from now on, seconds."""
        if time_step != self.time_step:
            self.client.p.setTimeStep(time_step, physicsClientId=self.client.id)
            self.time_step = time_step
            for vehicle in self.vehicles:
                vehicle.discretize_springs(time_step)

    def set_motor_targets(
        self,
        robot: int,
        joints: NDArray[np.float64],
        accelerations: NDArray[np.float64] | None = None,
    ) -> None:
        """Set the targets (n,) of the motors of a mount's joints from now on.

        `accelerations` (n,) are those of the next step on the way there, if known.
        """
        vehicle = self.vehicles[robot]
        vehicle.plan_accelerations(accelerations)
        self.client.p.setJointMotorControlArray(
            vehicle.number,
            vehicle.motor_joints,
            self.client.p.POSITION_CONTROL,
            vehicle.motor_targets(joints),
            forces=vehicle.motor_forces,
            positionGains=vehicle.motor_gains,
            velocityGains=vehicle.motor_gains,
            physicsClientId=self.client.id,
        )

    def step(self) -> None:
        """One time step of all vehicles."""
        client = self.client.id
        for vehicle in self.vehicles:
            self._apply_torques(vehicle, client)
            vehicle.planned_accelerations = vehicle.zeros
            vehicle.state = vehicle.joint_loads = None
        self.client.p.stepSimulation(physicsClientId=client)

    def _apply_torques(self, vehicle: LoadedVehicle, client: int) -> None:
        """Torques for one step: those of the springs, and of the motors those against the weight.

        Without these the solver of the motors needs hundreds of iterations, as they lift an arm.
        """
        p = self.client.p
        s, v = self._read_joint_states(vehicle)
        forces = vehicle.joint_loads
        if forces is None or vehicle.planned_accelerations is not vehicle.zeros:
            forces = self._inverse_dynamics(vehicle, s, v)
        for dof, preload, stiffness, damping, gain in vehicle.implicit_springs:
            b = forces[dof]
            forces[dof] = b + gain * (preload - b - stiffness * s[dof] - damping * v[dof])
        p.setJointMotorControlArray(
            vehicle.number, vehicle.dof_joints, p.TORQUE_CONTROL, forces=forces,
            physicsClientId=client,
        )  # fmt: skip

    def _inverse_dynamics(
        self, vehicle: LoadedVehicle, s: list[float], v: list[float]
    ) -> list[float]:
        """Forces that give all joints their planned accelerations at a state, without springs."""
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

    def _current_spheres(self, robot: int) -> Spheres:
        spheres = self._spheres[robot]
        if spheres is None:
            spheres = self._spheres[robot] = self.spheres(robot, self.q[robot])
        return spheres
