"""Kernels that find what a pose touches, and how far from any contact it is."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import PlainTuple, borrowing_kernel, inlined_kernel, kernel
from coopmap_env.robots.collision._arrays import (
    CollisionObstacles,
    Contact,
    Robot,
    RobotSpheres,
    TeamSpheres,
    name_obstacles,
    name_robot,
)
from coopmap_env.robots.collision.blocked_voxels import free_distance, is_sphere_blocked
from coopmap_env.robots.kinematics.forward import BodyPoses, body_poses

NO_CONTACT, MAP_CONTACT, SELF_CONTACT, TEAM_CONTACT = range(4)
"""What a sphere touches: nothing, a blocked voxel, a link of its own robot, a teammate."""


@kernel
def base_poses(robot: Robot) -> BodyPoses:
    """Buffers for the poses of all bodies; the root stands at the base."""
    n = len(robot.tree.parent)
    poses = BodyPoses(np.empty((n, 3, 3)), np.empty((n, 3)))
    poses.rotations[0], poses.translations[0] = robot.base_rotation, robot.base_translation
    return poses


@borrowing_kernel
def sphere_positions(
    robot: Robot, q: NDArray[np.float64], poses: BodyPoses, first: int, out: NDArray[np.float64]
) -> None:
    """Write the centers of the spheres from `first` on, world frame, to `out` (s, 3)."""
    body_poses(robot.tree, q, poses)
    R, t = poses.rotations, poses.translations
    body_index, local = robot.spheres.body_index, robot.spheres.local_centers
    for sphere in range(first, len(body_index)):
        s = np.uint64(sphere)
        b = np.uint64(body_index[s])
        x, y, z = local[s, 0], local[s, 1], local[s, 2]
        for i in range(3):
            out[s, i] = t[b, i] + R[b, i, 0] * x + R[b, i, 1] * y + R[b, i, 2] * z


@inlined_kernel
def squared_distance(a: NDArray[np.float64], i: int, b: NDArray[np.float64], j: int) -> float:
    """Squared distance of point i of `a` (n, 3) and point j of `b` (m, 3)."""
    dx, dy, dz = a[i, 0] - b[j, 0], a[i, 1] - b[j, 1], a[i, 2] - b[j, 2]
    return dx * dx + dy * dy + dz * dz


@inlined_kernel  # a call with so many arrays takes long
def map_clearance(
    at: NDArray[np.float64], s: int, radius: float, obstacles: CollisionObstacles
) -> float:
    """Metres that sphere s can move without touching a blocked voxel; -1 if it touches one.

    0 if it is near one: no more is known then.
    """
    blocked, margin, _ = obstacles
    lower, scale = blocked.lower, blocked.scale
    x = (at[s, 0] - lower[0]) * scale
    y = (at[s, 1] - lower[1]) * scale
    z = (at[s, 2] - lower[2]) * scale
    inflated = (radius + margin) * scale
    room = free_distance(blocked, x, y, z) - inflated
    if room >= 0.0:
        return room / scale
    return -1.0 if is_sphere_blocked(blocked, x, y, z, inflated) else 0.0


@inlined_kernel  # a call with so many arrays takes long
def nearest_teammate(
    at: NDArray[np.float64], s: int, radius: float, team: TeamSpheres
) -> tuple[int, float]:
    """The first teammate's sphere that sphere s touches, -1 if none; else metres to the nearest."""
    nearest = math.inf
    for m in range(len(team.centers)):
        reach = radius + team.radii[m] + team.margin
        square = squared_distance(at, s, team.centers, m)
        if square < reach * reach:
            return m, 0.0
        nearest = min(nearest, math.sqrt(square) - reach)
    return -1, nearest


@borrowing_kernel
def self_contact(
    spheres: RobotSpheres,
    at: NDArray[np.float64],
    start: NDArray[np.float64],
    speeds: NDArray[np.float64],
    n_ahead: float,
) -> tuple[int, int, float]:
    """Two spheres of the robot that touch, and are closer than at the `start`; -1 if none do.

    The last value is that of the next `n_ahead` waypoints up to which none can touch, where each
    center moves by its speed (s,) in between.
    """
    radii, ranges = spheres.radii, spheres.partner_ranges
    for i in range(spheres.n_static, len(radii)):
        begin = ranges.start[i]
        reach = radii[i] + spheres.static_radius + n_ahead * speeds[i]
        if squared_distance(at, i, spheres.static_center, 0) > reach * reach:
            begin = ranges.first_moving[i]  # away from all static spheres
        for p in range(begin, ranges.end[i]):
            j = spheres.partners[p]
            reach = radii[i] + radii[j]
            speed = speeds[i] + speeds[j]
            square = squared_distance(at, i, at, j)
            near = reach + n_ahead * speed
            if square < near * near:
                if square < reach * reach and square < squared_distance(start, i, start, j):
                    return i, j, 0.0
                n_ahead = min(n_ahead, max(math.sqrt(square) - reach, 0.0) / speed)
    return -1, 0, n_ahead


@borrowing_kernel
def pose_contact(
    spheres: RobotSpheres,
    at: NDArray[np.float64],
    start: NDArray[np.float64],
    obstacles: CollisionObstacles,
    ignored: NDArray[np.bool_],
    speeds: NDArray[np.float64],
    n_ahead: float,
) -> tuple[Contact, float]:
    """The first contact of a pose with its spheres `at` (s, 3).

    `ignored` (s,) marks spheres that touch something where the motion starts. They may, until they
    are free once. Own spheres that touch at the `start` may not come closer.

    Also returns how many of the next `n_ahead` waypoints no contact can reach, if each center moves
    by its speed (s,) in between.
    """
    radii = spheres.radii
    # the outermost links first: they travel farthest into unknown space
    for s in range(len(radii) - 1, spheres.n_static - 1, -1):
        room = map_clearance(at, s, radii[s], obstacles)
        mate, gap = nearest_teammate(at, s, radii[s], obstacles.team)
        if room >= 0.0 and mate < 0:
            ignored[s] = False
            n_ahead = min(n_ahead, min(room, gap) / speeds[s])
        elif not ignored[s]:
            found = Contact(MAP_CONTACT, s, 0) if room < 0.0 else Contact(TEAM_CONTACT, s, mate)
            return found, 0.0
        else:
            n_ahead = 0.0
    i, j, n_ahead = self_contact(spheres, at, start, speeds, n_ahead)
    return Contact(NO_CONTACT if i < 0 else SELF_CONTACT, i, j), n_ahead


@borrowing_kernel
def mark_initial_contacts(
    spheres: RobotSpheres,
    start: NDArray[np.float64],
    obstacles: CollisionObstacles,
    touching: NDArray[np.bool_],
) -> None:
    """Mark the spheres that touch something where the robot already stands."""
    radii = spheres.radii
    for s in range(spheres.n_static, len(radii)):
        room = map_clearance(start, s, radii[s], obstacles)
        mate, _ = nearest_teammate(start, s, radii[s], obstacles.team)
        touching[s] = room < 0.0 or mate >= 0


@borrowing_kernel
def ignore_unmoved_contacts(
    spheres: RobotSpheres,
    start: NDArray[np.float64],
    goal: NDArray[np.float64],
    step: float,
    touching: NDArray[np.bool_],
    out: NDArray[np.bool_],
) -> None:
    """Mark those of the touching spheres that are at the goal where they are at the start."""
    for s in range(spheres.n_static, len(start)):
        out[s] = touching[s] and squared_distance(start, s, goal, s) < step * step


@kernel
def are_poses_free(
    plain_robot: PlainTuple,
    plain_obstacles: PlainTuple,
    q: NDArray[np.float64],
    out: NDArray[np.bool_],
) -> None:
    """Write whether poses q (k, n) are free, wherever the robot comes from, to `out` (k,).

    Robot and obstacles are plain tuples.
    """
    robot, obstacles = name_robot(plain_robot), name_obstacles(plain_obstacles)
    spheres, poses = robot.spheres, base_poses(robot)
    n_spheres = len(spheres.radii)
    at, speeds = np.empty((n_spheres, 3)), np.ones(n_spheres)
    nowhere = np.zeros((n_spheres, 3))
    nowhere[:, 0] = 1e9 * np.arange(n_spheres)  # far apart, so that no contact is ignored
    ignored = np.zeros(n_spheres, dtype=np.bool_)
    for k in range(len(q)):
        sphere_positions(robot, q[k], poses, 0, at)
        contact, _ = pose_contact(spheres, at, nowhere, obstacles, ignored, speeds, 0.0)
        out[k] = contact.kind == NO_CONTACT
