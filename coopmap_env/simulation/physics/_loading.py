"""Solids and vehicles loaded into a physics engine, with what may collide with what."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.linear_algebra import product
from coopmap_env.geometry import Pose
from coopmap_env.robots import Mount
from coopmap_env.simulation.physics._joint_map import JointMap
from coopmap_env.simulation.physics._vehicle import LoadedVehicle
from coopmap_env.simulation.physics.client import BulletClient
from coopmap_env.simulation.scenes.field.solid import Solid

STATIC, BODY, FIRST_ARM_BIT = 1, 2, 4
"""Bits of collision groups: solids, bodies of vehicles, and one for each vehicle's arm. Only arms
move, so that all pairs contain one; joint limits keep the links of one arm apart."""
MAX_VEHICLES = 28
"""Bits that are left."""


def collision_shapes(solid: Solid) -> tuple[NDArray[np.float64], ...]:
    """Points (n, 3) of each shape that represents a solid."""
    return (solid.vertices,) if solid.is_concave else solid.parts


def part_boxes(solid: Solid) -> NDArray[np.float64]:
    """Boxes (b, 2, 3) around the collision shapes of a solid."""
    return np.array([[p.min(axis=0), p.max(axis=0)] for p in collision_shapes(solid)])


def load_solid(client: BulletClient, solid: Solid) -> list[int]:
    """Load a solid; PyBullet's numbers of its parts."""
    p, k = client.p, {"physicsClientId": client.id}
    numbers = []
    for points in collision_shapes(solid):
        shape = client.create_shape(points, solid.faces if solid.is_concave else None)
        # a plain rigid body, not one of Bullet's multi-bodies: a step takes half the time
        number = p.createMultiBody(0, shape, useMaximalCoordinates=1, **k)
        p.setCollisionFilterGroupMask(number, -1, STATIC, ~(STATIC | BODY), **k)
        numbers.append(number)
    return numbers


def load_vehicle(
    client: BulletClient, robot: int, mount: Mount, joint_map: JointMap, T_world_base: Pose
) -> LoadedVehicle:
    """Load a vehicle; its number `robot` chooses the collision group of its arm."""
    p, k = client.p, {"physicsClientId": client.id}
    number = client.load_mount(mount, T_world_base)
    arm = FIRST_ARM_BIT << robot
    for j in range(-1, len(joint_map.link_names) - 1):
        group, mask = (arm, ~arm) if j in joint_map.arm else (BODY, ~(STATIC | BODY))
        p.setCollisionFilterGroupMask(number, j, group, mask, **k)
    for a, b in joint_map.ignored_pairs:
        p.setCollisionFilterPair(number, number, a, b, 0, **k)
    vehicle = LoadedVehicle(number, mount, joint_map, T_world_base)
    if vehicle.spring_rates:
        suspension = joint_map.joints[: joint_map.n_suspension]
        idle = [0.0] * len(suspension)  # or Bullet's default motors would brake it
        p.setJointMotorControlArray(number, suspension, p.VELOCITY_CONTROL, forces=idle, **k)
        values = product(joint_map.joint_matrix, vehicle.home) + joint_map.joint_offsets
        at_home = dict(zip(joint_map.joints, values.tolist(), strict=True))
        M = p.calculateMassMatrix(number, [at_home[j] for j in vehicle.dof_joints], **k)
        vehicle.inertias = [M[dof][dof] for dof in vehicle.suspension_dofs]
    return vehicle
