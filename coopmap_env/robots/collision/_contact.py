"""The kernel that follows a straight joint motion and finds its first contact."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import kernel
from coopmap_env.robots.collision._arrays import (
    CollisionObstacles,
    FirstContacts,
    MapVoxels,
    Robot,
    RobotSpheres,
    TeamSpheres,
)
from coopmap_env.robots.collision.voxel_states import is_near_blocked, sphere_state
from coopmap_env.robots.kinematics.forward import BodyPoses, body_poses

NO_CONTACT, MAP_CONTACT, SELF_CONTACT, TEAM_CONTACT = range(4)
"""What a sphere touches: nothing, a blocked voxel, a link of its own robot, a teammate."""

MAX_SEGMENT = 0.25
"""Radians or metres: within a segment of this length paths of points are nearly straight."""


@kernel
def base_poses(robot: Robot) -> BodyPoses:
    """Buffers for the poses of all bodies; the root stands at the base."""
    n = len(robot.tree.parent)
    poses = BodyPoses(np.empty((n, 3, 3)), np.empty((n, 3)), np.empty((3, 3)))
    poses.rotations[0], poses.translations[0] = robot.base_rotation, robot.base_translation
    return poses


@kernel
def sphere_positions(
    robot: Robot, q: NDArray[np.float64], poses: BodyPoses, first: int, out: NDArray[np.float64]
) -> None:
    """Write the centers of the spheres from `first` on, world frame, to `out` (s, 3)."""
    body_poses(robot.tree, q, poses)
    R, t = poses.rotations, poses.translations
    body_index, local = robot.spheres.body_index, robot.spheres.local_centers
    for s in range(first, len(body_index)):
        b = body_index[s]
        x, y, z = local[s, 0], local[s, 1], local[s, 2]
        for i in range(3):
            out[s, i] = t[b, i] + R[b, i, 0] * x + R[b, i, 1] * y + R[b, i, 2] * z


@kernel
def squared_distance(a: NDArray[np.float64], i: int, b: NDArray[np.float64], j: int) -> float:
    """Squared distance of point i of `a` (n, 3) and point j of `b` (m, 3)."""
    dx, dy, dz = a[i, 0] - b[j, 0], a[i, 1] - b[j, 1], a[i, 2] - b[j, 2]
    return dx * dx + dy * dy + dz * dz


@kernel
def map_contact(at: NDArray[np.float64], s: int, radius: float, voxels: MapVoxels) -> int:
    """The worst state of the voxels that sphere s touches."""
    lower, scale = voxels.lower, voxels.scale
    x = (at[s, 0] - lower[0]) * scale
    y = (at[s, 1] - lower[1]) * scale
    z = (at[s, 2] - lower[2]) * scale
    if is_near_blocked(voxels.neighborhood, x, y, z):
        return sphere_state(voxels.states, x, y, z, (radius + voxels.margin) * scale)
    return 0


@kernel
def team_contact(at: NDArray[np.float64], s: int, radius: float, team: TeamSpheres) -> int:
    """Index of a teammate's sphere that sphere s touches; -1 if there is none."""
    for m in range(len(team.centers)):
        reach = radius + team.radii[m] + team.margin
        if squared_distance(at, s, team.centers, m) < reach * reach:
            return m
    return -1


@kernel
def self_contact(
    spheres: RobotSpheres, at: NDArray[np.float64], start: NDArray[np.float64]
) -> tuple[int, int]:
    """Two spheres of the robot that touch, and are closer than at the `start`; -1 if none do."""
    radii, ranges = spheres.radii, spheres.partner_ranges
    for i in range(spheres.n_static, len(radii)):
        begin = ranges.start[i]
        reach = radii[i] + spheres.static_radius
        if squared_distance(at, i, spheres.static_center, 0) > reach * reach:
            begin = ranges.first_moving[i]  # away from all static spheres
        for p in range(begin, ranges.end[i]):
            j = spheres.partners[p]
            reach = radii[i] + radii[j]
            square = squared_distance(at, i, at, j)
            if square < reach * reach and square < squared_distance(start, i, start, j):
                return i, j
    return -1, 0


@kernel
def pose_contact(
    spheres: RobotSpheres,
    at: NDArray[np.float64],
    start: NDArray[np.float64],
    obstacles: CollisionObstacles,
    ignored: NDArray[np.bool_],
) -> tuple[int, int, int]:
    """The first contact of a pose with its spheres `at` (s, 3): kind, sphere, other.

    `ignored` (s,) marks spheres that touch something where the motion starts. They may, until they
    are free once. Own spheres that touch at the `start` may not come closer.
    """
    radii, voxels, team = spheres.radii, obstacles.voxels, obstacles.team
    # the outermost links first: they travel farthest into unknown space
    for s in range(len(radii) - 1, spheres.n_static - 1, -1):
        state = map_contact(at, s, radii[s], voxels)
        mate = team_contact(at, s, radii[s], team)
        if state == 0 and mate < 0:
            ignored[s] = False
        elif not ignored[s]:
            return (MAP_CONTACT, s, state) if state > 0 else (TEAM_CONTACT, s, mate)
    i, j = self_contact(spheres, at, start)
    return (NO_CONTACT, -1, 0) if i < 0 else (SELF_CONTACT, i, j)


@kernel
def mark_initial_contacts(
    spheres: RobotSpheres,
    start: NDArray[np.float64],
    obstacles: CollisionObstacles,
    touching: NDArray[np.bool_],
) -> None:
    """Mark the spheres that touch something where the robot already stands."""
    radii = spheres.radii
    for s in range(spheres.n_static, len(radii)):
        state = map_contact(start, s, radii[s], obstacles.voxels)
        mate = team_contact(start, s, radii[s], obstacles.team)
        touching[s] = state > 0 or mate >= 0


@kernel
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
def count_waypoints(
    robot: Robot,
    q0: NDArray[np.float64],
    q1: NDArray[np.float64],
    step: float,
    poses: BodyPoses,
    counts: NDArray[np.int64],
    previous: NDArray[np.float64],
    current: NDArray[np.float64],
) -> int:
    """Cut a motion into segments, and those so that no center moves more than `step` at a time.

    Returns the number of segments and writes the steps in each to `counts`. `previous` and
    `current` (s, 3) are scratch.
    """
    first = robot.spheres.n_static
    largest = 0.0
    for n in range(len(q0)):
        largest = max(largest, abs(q1[n] - q0[n]))
    segments = min(int(np.ceil(largest / MAX_SEGMENT)), len(counts))
    sphere_positions(robot, q0, poses, first, previous)
    for segment in range(segments):
        q = q0 + (q1 - q0) * ((segment + 1.0) / segments)
        sphere_positions(robot, q, poses, first, current)
        farthest = 0.0
        for s in range(first, len(current)):
            farthest = max(farthest, squared_distance(previous, s, current, s))
            for i in range(3):
                previous[s, i] = current[s, i]
        # a little more, because arcs are longer than chords and speeds along them vary
        counts[segment] = int(1.15 * np.sqrt(farthest) / step) + 1
    return segments


@kernel
def first_contact_on_path(
    robot: Robot,
    obstacles: CollisionObstacles,
    q0: NDArray[np.float64],
    q1: NDArray[np.float64],
    step: float,
    start: NDArray[np.float64],
    ignored: NDArray[np.bool_],
    at: NDArray[np.float64],
) -> tuple[int, int, int, float]:
    """First contact before the goal: kind, sphere, other, and the fraction of the motion before it.

    Without a contact the fraction is that of the last step before the goal.
    """
    spheres, poses = robot.spheres, base_poses(robot)
    counts = np.empty(int(np.abs(q1 - q0).max() / MAX_SEGMENT) + 1, np.int64)
    segments = count_waypoints(robot, q0, q1, step, poses, counts, start.copy(), at)
    q, fraction = np.empty(len(q0)), 0.0
    for segment in range(segments):
        for w in range(1, counts[segment] + (segment < segments - 1)):
            along = (segment + w / counts[segment]) / segments
            for n in range(len(q)):
                q[n] = q0[n] + (q1[n] - q0[n]) * along
            sphere_positions(robot, q, poses, spheres.n_static, at)
            kind, s, other = pose_contact(spheres, at, start, obstacles, ignored)
            if kind != NO_CONTACT:
                return kind, s, other, fraction
            fraction = along
    return NO_CONTACT, -1, 0, fraction


@kernel
def first_contacts(
    robot: Robot,
    obstacles: CollisionObstacles,
    q0: NDArray[np.float64],
    q1: NDArray[np.float64],
    step: float,
    goal_first: bool,
    found: FirstContacts,
) -> None:
    """Write the first contacts on the straight joint motions from q0 (n,) to each of q1 (k, n).

    With `goal_first` the goal comes before the path; the free fraction is 0 if it is in contact.
    """
    spheres, poses = robot.spheres, base_poses(robot)
    n_spheres = len(spheres.radii)
    start, goal = np.empty((n_spheres, 3)), np.empty((n_spheres, 3))
    touching = np.zeros(n_spheres, dtype=np.bool_)
    ignored = np.zeros(n_spheres, dtype=np.bool_)
    sphere_positions(robot, q0, poses, 0, start)
    goal[:] = start
    mark_initial_contacts(spheres, start, obstacles, touching)
    for m in range(len(q1)):
        at = found.positions[m]
        sphere_positions(robot, q1[m], poses, spheres.n_static, goal)
        ignore_unmoved_contacts(spheres, start, goal, step, touching, ignored)
        kind, s, other = pose_contact(spheres, goal, start, obstacles, ignored)
        fraction, at_goal = 0.0, kind != NO_CONTACT
        if not (at_goal and goal_first):
            ignored[:] = touching
            at[:] = start
            path_kind, path_sphere, path_other, fraction = first_contact_on_path(
                robot, obstacles, q0, q1[m], step, start, ignored, at
            )
            if path_kind != NO_CONTACT:
                kind, s, other, at_goal = path_kind, path_sphere, path_other, False
            elif not at_goal:
                fraction = 1.0
        if at_goal:
            at[:] = goal
        found.kind[m], found.sphere[m], found.other[m] = kind, s, other
        found.free_fraction[m], found.at_goal[m] = fraction, at_goal


@kernel
def are_poses_free(
    robot: Robot, obstacles: CollisionObstacles, q: NDArray[np.float64], out: NDArray[np.bool_]
) -> None:
    """Write whether poses q (k, n) are free, wherever the robot comes from, to `out` (k,)."""
    spheres, poses = robot.spheres, base_poses(robot)
    n_spheres = len(spheres.radii)
    at = np.empty((n_spheres, 3))
    nowhere = np.zeros((n_spheres, 3))
    nowhere[:, 0] = 1e9 * np.arange(n_spheres)  # far apart, so that no contact is ignored
    ignored = np.zeros(n_spheres, dtype=np.bool_)
    for k in range(len(q)):
        sphere_positions(robot, q[k], poses, 0, at)
        out[k] = pose_contact(spheres, at, nowhere, obstacles, ignored)[0] == NO_CONTACT
