"""The physics of one world: its solids, the vehicles among them, and what touches what.

A world has a PyBullet client of its own, new and empty: state that outlives a reset (caches of
contacts, orders of pairs) is what makes Bullet's runs differ, so none is ever used twice.

Suspension: in each step springs and dampers are explicit torques,

    tau = preload - stiffness * s - damping * ds/dt

and the step is cut where the stiffest of them would swing up. The mount's joints are held by
position motors, which Bullet solves implicitly, after torques that carry the weight.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from coopmap_env.geometry.transforms import Pose
from coopmap_env.robots.mount import Mount
from coopmap_env.simulation.anatomy import Anatomy
from coopmap_env.simulation.bullet import BulletClient
from coopmap_env.simulation.equilibrium import GRAVITY, Equilibrium
from coopmap_env.simulation.worksites.solid import Solid

STATIC, BODY, FIRST_ARM = 1, 2, 4
"""Bits of collision groups: solids, bodies of vehicles, and one for each vehicle's arm. Only arms
move, so that all pairs have one in them; links of one arm are kept apart by their limits."""
MOST_VEHICLES = 28
"""Bits that are left."""
OWN_BODY = "its own body"
"""What an arm touches that touches the vehicle under it."""
ITERATIONS = 25
"""Of Bullet's solver, at most: joints then miss their targets by some 1e-5 rad."""


class LoadedVehicle:
    """A vehicle in the physics: its body by PyBullet's `number`, its springs and its motors."""

    def __init__(self, number: int, mount: Mount, anatomy: Anatomy, T_world_base: Pose) -> None:
        n = anatomy.n_suspension
        self.number = number
        self.anatomy = anatomy
        self.R, self.t = T_world_base.rotation, T_world_base.translation
        self.home = np.array([*(0.0,) * n, *mount.home])
        self.springs: Equilibrium | None = None
        self.in_order = sorted(anatomy.joints)
        """All joints that can move, as PyBullet counts degrees of freedom."""
        self.zeros = [0.0] * len(self.in_order)
        self.sprung = [self.in_order.index(joint) for joint in anatomy.joints[:n]]
        """Where heave, roll and pitch are among them."""
        self.rates: list[tuple[int, float, float, float]] = []
        """(where, preload, stiffness, damping) of heave, roll and pitch."""
        if mount.suspension is not None:
            springs = self.springs = Equilibrium.of(mount, self.R.T @ [0.0, 0.0, -GRAVITY])
            rows = np.stack([springs.preload, springs.stiffness, springs.damping], axis=1)
            self.rates = [
                (at, row[0], row[1], row[2])
                for at, row in zip(self.sprung, rows.tolist(), strict=True)
            ]
        self.driven, self.forces = anatomy.joints[n:], anatomy.forces[n:]
        self.gains = (1.0,) * len(self.driven)  # to the target within one step
        self._values, self._offsets = anatomy.values[n:, n:], anatomy.offsets[n:]
        self._all_follow = len(self.driven) > len(mount.joints)

    def targets(self, joints: NDArray[np.float64]) -> list[float]:
        """Of all driven joints, from those of the mount (n,)."""
        values = self._values @ joints + self._offsets if self._all_follow else joints
        return [float(value) for value in values]


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
        Of `step`, seconds.

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
        if not len(mounts) == len(base_poses) <= MOST_VEHICLES:
            raise ValueError(
                f"{len(mounts)} mounts and {len(base_poses)} base poses: one of each for each of "
                f"at most {MOST_VEHICLES} vehicles"
            )
        anatomies = [Anatomy.of(mount) for mount in mounts]
        self.client = BulletClient()
        self.time_step = time_step
        self.names: dict[int, str] = {}
        """What a body, by PyBullet's number, is called."""
        self._substeps = 1
        self.boxes = np.concatenate([np.zeros((0, 2, 3)), *map(self._add_solid, solids)])
        self.vehicles = [
            self._add_vehicle(robot, *parts)
            for robot, parts in enumerate(zip(mounts, anatomies, base_poses, strict=True))
        ]
        self.client.p.setGravity(0, 0, -GRAVITY, physicsClientId=self.client.id)
        self.client.p.setPhysicsEngineParameter(
            fixedTimeStep=time_step / self._substeps, numSolverIterations=ITERATIONS,
            deterministicOverlappingPairs=1, physicsClientId=self.client.id,
        )  # fmt: skip
        self.q = [vehicle.home for vehicle in self.vehicles]
        """Where each vehicle is; `place` and `velocity` renew it."""
        self._spheres: list[NDArray[np.float64] | None] = [None] * len(mounts)
        for robot, vehicle in enumerate(self.vehicles):
            self.place(robot, vehicle.home)

    def close(self) -> None:
        """Let go of the physics; doing so twice does no harm."""
        self.client.close()

    def place(self, robot: int, q: NDArray[np.float64]) -> None:
        """Put a vehicle's joints to q (m,), at rest."""
        vehicle, anatomy = self.vehicles[robot], self.vehicles[robot].anatomy
        values = anatomy.values @ q + anatomy.offsets
        self.client.p.resetJointStatesMultiDof(
            vehicle.number, anatomy.joints, values[:, None].tolist(), physicsClientId=self.client.id
        )
        self.q[robot] = q
        self._spheres[robot] = None

    def velocity(self, robot: int) -> NDArray[np.float64]:
        """Velocity (m,) of q after a `step`; `q` itself is renewed as well."""
        vehicle = self.vehicles[robot]
        states = self.client.p.getJointStates(
            vehicle.number,
            vehicle.anatomy.joints[: len(vehicle.home)],
            physicsClientId=self.client.id,
        )
        self.q[robot] = np.array([state[0] for state in states])
        self._spheres[robot] = None
        return np.array([state[1] for state in states])

    def at_rest(self, robot: int, joints: NDArray[np.float64]) -> NDArray[np.float64]:
        """Joints (k, n) of a mount with the deflections in which its vehicle rests: q (k, m)."""
        springs = self.vehicles[robot].springs
        return joints if springs is None else springs.settled(joints)

    def find_contacts(self) -> None:
        """Look where vehicles are now, without moving anything; then ask `contacts`."""
        self.client.p.performCollisionDetection(physicsClientId=self.client.id)

    def contacts(self) -> list[tuple[float, str]]:
        """Of each vehicle, how deep its arm is in something, as a negative number, and in what.

        Those of the last `step` or `find_contacts`; (0, "") for an arm that touches nothing.
        """
        found = [(0.0, "")] * len(self.vehicles)
        for point in self.client.p.getContactPoints(physicsClientId=self.client.id):
            if point[8] < 0.0:
                _, a, b, link_a, link_b = point[:5]
                for robot, vehicle in enumerate(self.vehicles):
                    own, arm = vehicle.number, vehicle.anatomy.arm
                    mine = (a == own and link_a in arm) or (b == own and link_b in arm)
                    if mine and point[8] < found[robot][0]:
                        what = OWN_BODY if a == b else self.names[b if a == own else a]
                        found[robot] = point[8], what
        return found

    def stretches(
        self, robot: int, q: NDArray[np.float64]
    ) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
        """Between which of the configurations q (k, m) an arm might touch; how far each goes.

        Marks (k - 1,) and metres (k - 1,); the others stay where they are.
        """
        vehicle = self.vehicles[robot]
        others = [self._outlined(other) for other in range(len(self.vehicles)) if other != robot]
        return vehicle.anatomy.outline.stretches(
            vehicle.R, vehicle.t, q, self.boxes, np.concatenate([np.zeros((0, 4)), *others])
        )

    def aim(self, robot: int, joints: NDArray[np.float64]) -> None:
        """Set the targets (n,) that the motors of a mount's joints hold from now on."""
        vehicle = self.vehicles[robot]
        self.client.p.setJointMotorControlArray(
            vehicle.number, vehicle.driven, self.client.p.POSITION_CONTROL,
            vehicle.targets(joints), forces=vehicle.forces, positionGains=vehicle.gains,
            velocityGains=vehicle.gains, physicsClientId=self.client.id,
        )  # fmt: skip

    def step(self) -> None:
        """One time step of all vehicles."""
        client = self.client.id
        for _ in range(self._substeps):
            for vehicle in self.vehicles:
                self._push(vehicle, client)
            self.client.p.stepSimulation(physicsClientId=client)

    def _push(self, vehicle: LoadedVehicle, client: int) -> None:
        """Torques for one substep: of the springs, and of the motors what carries the weight.

        Without it the solver of the motors needs hundreds of iterations: they lift a whole arm.
        """
        p, number, joints = self.client.p, vehicle.number, vehicle.in_order
        states = p.getJointStates(number, joints, physicsClientId=client)
        q, v = [state[0] for state in states], [state[1] for state in states]
        forces = list(
            p.calculateInverseDynamics(number, q, v, vehicle.zeros, physicsClientId=client)
        )
        for at, preload, stiffness, damping in vehicle.rates:
            forces[at] = preload - stiffness * q[at] - damping * v[at]
        p.setJointMotorControlArray(
            number, joints, p.TORQUE_CONTROL, forces=forces, physicsClientId=client
        )

    def _outlined(self, robot: int) -> NDArray[np.float64]:
        """Spheres (s, 4) around all links of a vehicle where it is."""
        spheres = self._spheres[robot]
        if spheres is None:
            vehicle = self.vehicles[robot]
            spheres = vehicle.anatomy.outline.spheres(vehicle.R, vehicle.t, self.q[robot])
            self._spheres[robot] = spheres
        return spheres

    def _add_solid(self, solid: Solid) -> NDArray[np.float64]:
        """Its boxes (b, 2, 3)."""
        p, k = self.client.p, {"physicsClientId": self.client.id}
        shapes = [solid.vertices] if solid.is_concave else solid.parts
        for points in shapes:
            shape = self.client.mesh(points, solid.faces if solid.is_concave else None)
            # a plain rigid body, not one of Bullet's multi-bodies: half the price of a step
            number = p.createMultiBody(0, shape, useMaximalCoordinates=1, **k)
            p.setCollisionFilterGroupMask(number, -1, STATIC, ~(STATIC | BODY), **k)
            self.names[number] = solid.name
        return np.array([[points.min(axis=0), points.max(axis=0)] for points in shapes])

    def _add_vehicle(
        self, robot: int, mount: Mount, anatomy: Anatomy, T_world_base: Pose
    ) -> LoadedVehicle:
        p, k = self.client.p, {"physicsClientId": self.client.id}
        number = self.client.load(mount, T_world_base)
        self.names[number] = f"robot_{robot}"
        arm = FIRST_ARM << robot
        for j in range(-1, len(anatomy.link_names) - 1):
            group, mask = (arm, ~arm) if j in anatomy.arm else (BODY, ~(STATIC | BODY))
            p.setCollisionFilterGroupMask(number, j, group, mask, **k)
        for a, b in anatomy.neighbours:
            p.setCollisionFilterPair(number, number, a, b, 0, **k)
        vehicle = LoadedVehicle(number, mount, anatomy, T_world_base)
        if vehicle.rates:
            suspension = anatomy.joints[: anatomy.n_suspension]
            idle = [0.0] * len(suspension)  # or Bullet's own motors would brake it
            p.setJointMotorControlArray(number, suspension, p.VELOCITY_CONTROL, forces=idle, **k)
            values = anatomy.values @ vehicle.home + anatomy.offsets
            at_home = dict(zip(anatomy.joints, values.tolist(), strict=True))
            M = p.calculateMassMatrix(number, [at_home[j] for j in vehicle.in_order], **k)
            needed = n_substeps(self.time_step, vehicle.rates, np.diag(M)[vehicle.sprung])
            self._substeps = max(self._substeps, needed)
        return vehicle


def n_substeps(
    time_step: float,
    rates: Sequence[tuple[int, float, float, float]],
    inertias: NDArray[np.float64],
) -> int:
    """Into how many parts a step must be cut so that no spring or damper swings up.

    With h of a part and a mass m, an explicit step is stable while h^2 k / m + 2 h d / m < 4; at
    half of that it does not ring either.
    """
    parts = 1
    for (_, _, stiffness, damping), m in zip(rates, inertias.tolist(), strict=True):
        while True:
            h = time_step / parts
            if (h * h * stiffness + 2.0 * h * damping) / m <= 2.5:
                break
            parts += 1
    return parts
