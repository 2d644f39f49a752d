"""Kernels that follow straight joint motions up to their first contact.

A motion is cut into segments and these into waypoints, so that no center of a sphere moves farther
than a step from one to the next. A waypoint that nothing can have reached since the one before is
not computed: how far each sphere is from a contact says how many these are.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import PlainTuple, borrowing_kernel, kernel
from coopmap_env.robots.collision._arrays import (
    CollisionObstacles,
    Contact,
    MotionBuffers,
    MotionContact,
    Robot,
    name_obstacles,
    name_robot,
)
from coopmap_env.robots.collision._contact import (
    NO_CONTACT,
    base_poses,
    ignore_unmoved_contacts,
    mark_initial_contacts,
    pose_contact,
    sphere_positions,
    squared_distance,
)

MAX_SEGMENT = 0.25
"""Radians or metres: within a segment of this length paths of points are nearly straight."""
ARC_FACTOR = 1.15
"""A little more than 1, because arcs are longer than chords and speeds along them vary."""


@kernel
def allocate_motion(robot: Robot, n_joints: int) -> MotionBuffers:
    """Scratch for the motions of a robot."""
    n, n_bodies = len(robot.spheres.radii), len(robot.tree.parent)
    return MotionBuffers(
        base_poses(robot),
        np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3)),
        np.zeros(n, dtype=np.bool_), np.zeros(n, dtype=np.bool_),
        np.zeros(n), np.zeros(n), np.empty(n_bodies), np.empty((n_bodies, 3)), np.empty(n_joints),
    )  # fmt: skip


@borrowing_kernel
def _copy_values(source: NDArray[Any], out: NDArray[Any]) -> None:
    """Write the values of an array (n,) to `out`."""
    for n in range(len(source)):
        out[n] = source[n]


@borrowing_kernel
def _copy_points(source: NDArray[np.float64], first: int, out: NDArray[np.float64]) -> None:
    """Write the points (n, 3) from the first on to `out`."""
    for n in range(first, len(source)):
        for i in range(3):
            out[n, i] = source[n, i]


@borrowing_kernel
def count_segments(q0: NDArray[np.float64], q1: NDArray[np.float64]) -> int:
    """Number of segments of a motion."""
    largest = 0.0
    for n in range(len(q0)):
        largest = max(largest, abs(q1[n] - q0[n]))
    return math.ceil(largest / MAX_SEGMENT)


@borrowing_kernel
def count_waypoints(
    n_static: int, begin: NDArray[np.float64], end: NDArray[np.float64], step: float
) -> int:
    """Steps in a segment between centers (s, 3), so that none moves more than `step` at a time."""
    farthest = 0.0
    for s in range(n_static, len(begin)):
        farthest = max(farthest, squared_distance(begin, s, end, s))
    return int(ARC_FACTOR * math.sqrt(farthest) / step) + 1


@borrowing_kernel
def write_travel(
    robot: Robot,
    q0: NDArray[np.float64],
    q1: NDArray[np.float64],
    n_segments: int,
    centers: NDArray[np.float64],
    work: MotionBuffers,
) -> None:
    """Write how far the centers (s, 3) of a pose move in a segment at its present speeds, at most.

    The pose is that of `work.poses`; how far they move is written to `work.travel`. Each center
    turns about the joints that carry it; their motions add up.
    """
    tree, spheres = robot.tree, robot.spheres
    R, t, turns, axes = work.poses.rotations, work.poses.translations, work.turns, work.axes
    for body in range(1, len(tree.parent)):
        b = np.uint64(body)
        n = np.uint64(tree.variable[b])
        turns[b] = abs(tree.multiplier[b] * (q1[n] - q0[n])) / n_segments
        x, y, z = tree.axis[b, 0], tree.axis[b, 1], tree.axis[b, 2]
        for i in range(3):
            axes[b, i] = R[b, i, 0] * x + R[b, i, 1] * y + R[b, i, 2] * z
    for sphere in range(spheres.n_static, len(spheres.radii)):
        s = np.uint64(sphere)
        x, y, z = centers[s, 0], centers[s, 1], centers[s, 2]
        travel, body = 0.0, spheres.body_index[s]
        while body > 0:
            b = np.uint64(body)
            lever = 1.0
            if not tree.prismatic[b]:
                dx, dy, dz = x - t[b, 0], y - t[b, 1], z - t[b, 2]
                cx = axes[b, 1] * dz - axes[b, 2] * dy
                cy = axes[b, 2] * dx - axes[b, 0] * dz
                cz = axes[b, 0] * dy - axes[b, 1] * dx
                lever = math.sqrt(cx * cx + cy * cy + cz * cz)
            travel += turns[b] * lever
            body = tree.parent[b]
        work.travel[s] = travel


@borrowing_kernel
def _interpolate(
    q0: NDArray[np.float64], q1: NDArray[np.float64], along: float, q: NDArray[np.float64]
) -> None:
    """Write the joints at a fraction of the motion to `q` (n,)."""
    for n in range(len(q)):
        q[n] = q0[n] + (q1[n] - q0[n]) * along


@borrowing_kernel
def _first_contact_on_path(
    robot: Robot,
    obstacles: CollisionObstacles,
    q0: NDArray[np.float64],
    q1: NDArray[np.float64],
    step: float,
    work: MotionBuffers,
) -> tuple[Contact, float]:
    """First contact before the goal, and the fraction of the motion before it.

    Without a contact the fraction is that of the last step before the goal.
    """
    spheres, at, end = robot.spheres, work.at, work.next_end
    n_static, n_segments = spheres.n_static, count_segments(q0, q1)
    if n_segments == 0:
        return Contact(NO_CONTACT, -1, 0), 0.0
    sphere_positions(robot, q0, work.poses, n_static, at)
    write_travel(robot, q0, q1, n_segments, at, work)
    count, fraction = 1, 0.0
    for segment in range(n_segments):
        _interpolate(q0, q1, (segment + 1.0) / n_segments, work.q)
        sphere_positions(robot, work.q, work.poses, n_static, end)
        before = (segment - 1 + (count - 1) / count) / n_segments
        count = count_waypoints(n_static, at, end, step)
        _copy_values(work.travel, work.speeds)
        write_travel(robot, q0, q1, n_segments, end, work)
        for s in range(n_static, len(end)):
            travel = max(max(work.speeds[s], work.travel[s]), 1e-9)
            work.speeds[s] = ARC_FACTOR * travel / count
        w = 0
        while w < count:
            along = (segment + w / count) / n_segments
            if w > 0:
                before = (segment + (w - 1) / count) / n_segments
                _interpolate(q0, q1, along, work.q)
                sphere_positions(robot, work.q, work.poses, n_static, at)
            contact, n_ahead = pose_contact(
                spheres, at, work.start, obstacles, work.ignored, work.speeds, float(count)
            )
            if contact.kind != NO_CONTACT:
                return contact, before
            w += 1 + int(n_ahead)
        _copy_points(end, n_static, at)
        fraction = (segment + (count - 1) / count) / n_segments
    return Contact(NO_CONTACT, -1, 0), fraction


@borrowing_kernel
def _prepare(
    robot: Robot, obstacles: CollisionObstacles, q0: NDArray[np.float64], work: MotionBuffers
) -> None:
    """Fill what all motions from q0 (n,) have in common."""
    sphere_positions(robot, q0, work.poses, 0, work.start)
    _copy_points(work.start, 0, work.goal)  # those that no joint moves stay there
    _copy_points(work.start, 0, work.at)
    work.speeds[robot.spheres.n_static :] = 1.0
    mark_initial_contacts(robot.spheres, work.start, obstacles, work.touching)


@borrowing_kernel
def _motion_contact(
    robot: Robot,
    obstacles: CollisionObstacles,
    q0: NDArray[np.float64],
    q1: NDArray[np.float64],
    step: float,
    goal_first: bool,
    work: MotionBuffers,
) -> MotionContact:
    """The first contact on the straight motion from q0 to q1 (n,), both inside the limits.

    With `goal_first` the goal comes before the path; the free fraction is 0 if it is in contact.
    """
    spheres = robot.spheres
    sphere_positions(robot, q1, work.poses, spheres.n_static, work.goal)
    ignore_unmoved_contacts(spheres, work.start, work.goal, step, work.touching, work.ignored)
    at_goal, _ = pose_contact(
        spheres, work.goal, work.start, obstacles, work.ignored, work.speeds, 0.0
    )
    if at_goal.kind != NO_CONTACT and goal_first:
        return MotionContact(at_goal, 0.0, True)
    _copy_values(work.touching, work.ignored)
    contact, fraction = _first_contact_on_path(robot, obstacles, q0, q1, step, work)
    if contact.kind != NO_CONTACT:
        return MotionContact(contact, fraction, False)
    if at_goal.kind != NO_CONTACT:
        return MotionContact(at_goal, fraction, True)
    return MotionContact(contact, 1.0, False)


@kernel
def first_contact(
    plain_robot: PlainTuple,
    plain_obstacles: PlainTuple,
    q0: NDArray[np.float64],
    q1: NDArray[np.float64],
    step: float,
    goal_first: bool,
    position: NDArray[np.float64],
) -> MotionContact:
    """The first contact on one motion; `position` (3,) receives the center of its sphere.

    Robot and obstacles are plain tuples here and in `are_motions_free`.
    """
    robot, obstacles = name_robot(plain_robot), name_obstacles(plain_obstacles)
    work = allocate_motion(robot, len(q0))
    _prepare(robot, obstacles, q0, work)
    found = _motion_contact(robot, obstacles, q0, q1, step, goal_first, work)
    centers, sphere = work.goal if found.at_goal else work.at, found.contact.sphere
    for i in range(3):
        position[i] = centers[sphere, i]
    return found


@kernel
def are_motions_free(
    plain_robot: PlainTuple,
    plain_obstacles: PlainTuple,
    q0: NDArray[np.float64],
    q1: NDArray[np.float64],
    step: float,
    n_wanted: int,
    out: NDArray[np.bool_],
) -> None:
    """Write whether the motions from q0 (n,) to each of q1 (k, n) are free, up to `n_wanted` ones.

    Motions after those count as not free.
    """
    robot, obstacles = name_robot(plain_robot), name_obstacles(plain_obstacles)
    work = allocate_motion(robot, len(q0))
    _prepare(robot, obstacles, q0, work)
    n_found = 0
    for m in range(len(q1)):
        out[m] = False
        if n_found < n_wanted:
            found = _motion_contact(robot, obstacles, q0, q1[m], step, True, work)
            out[m] = found.contact.kind == NO_CONTACT
            n_found += out[m]
