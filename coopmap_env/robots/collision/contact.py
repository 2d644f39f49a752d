"""The kernel that walks along a straight joint motion and finds its first contact."""

from __future__ import annotations

import numpy as np
from numba import njit

from coopmap_env.robots.collision.clearance import is_near_blocked, sphere_state
from coopmap_env.robots.kinematics.forward import body_poses

NO_CONTACT, MAP_CONTACT, SELF_CONTACT, TEAM_CONTACT = range(4)
"""What a sphere touches: nothing, a blocked voxel, an own link, a teammate."""

MAX_SEGMENT = 0.25
"""Radians or metres: within such a piece of a motion all paths are next to straight."""


@njit(cache=True, nogil=True)
def sphere_positions(body, spheres, q, work, first, out):
    """Centres of the spheres from `first` on, world frame, written to `out` (s, 3)."""
    R, t, turn = work
    body_poses(body, q, R, t, turn)
    of, local = spheres[0], spheres[1]
    for s in range(first, len(of)):
        b = of[s]
        x, y, z = local[s, 0], local[s, 1], local[s, 2]
        for i in range(3):
            out[s, i] = t[b, i] + R[b, i, 0] * x + R[b, i, 1] * y + R[b, i, 2] * z


@njit(cache=True, nogil=True)
def squared_distance(a, i, b, j):
    """Squared distance of point i of `a` (n, 3) and point j of `b` (m, 3)."""
    dx, dy, dz = a[i, 0] - b[j, 0], a[i, 1] - b[j, 1], a[i, 2] - b[j, 2]
    return dx * dx + dy * dy + dz * dz


@njit(cache=True, nogil=True)
def map_contact(at, s, radius, states, near, lower, scale, margin):
    """The worst state of the voxels that sphere s meets."""
    x = (at[s, 0] - lower[0]) * scale
    y = (at[s, 1] - lower[1]) * scale
    z = (at[s, 2] - lower[2]) * scale
    if is_near_blocked(near, x, y, z):
        return sphere_state(states, x, y, z, (radius + margin) * scale)
    return 0


@njit(cache=True, nogil=True)
def team_contact(at, s, radius, centers, radii, margin):
    """Number of a teammate's sphere that sphere s meets, -1 if there is none."""
    for m in range(len(centers)):
        apart = radius + radii[m] + margin
        if squared_distance(at, s, centers, m) < apart * apart:
            return m
    return -1


@njit(cache=True, nogil=True)
def pose_contact(spheres, at, start, known, team, ignored):
    """The first contact of a pose whose spheres stand `at` (s, 3): (kind, sphere, with what).

    `ignored` (s,) marks spheres that touched something where the motion starts: they may, until
    they are clear once. Own links that touch at the `start` may not come closer.
    """
    _, _, radii, first, rows, partners, ball = spheres
    states, near, lower, scale, margin = known
    centers, wide, team_margin = team
    # the outermost links first: they travel farthest into what is not known
    for s in range(len(radii) - 1, first - 1, -1):
        state = map_contact(at, s, radii[s], states, near, lower, scale, margin)
        mate = team_contact(at, s, radii[s], centers, wide, team_margin)
        if state == 0 and mate < 0:
            ignored[s] = False
        elif not ignored[s]:
            return (MAP_CONTACT, s, state) if state > 0 else (TEAM_CONTACT, s, mate)
    for i in range(first, len(radii)):
        begin = rows[i, 0]
        apart = radii[i] + ball[0, 3]
        if squared_distance(at, i, ball, 0) > apart * apart:  # away from all that does not move
            begin = rows[i, 1]
        for p in range(begin, rows[i, 2]):
            j = partners[p]
            apart = radii[i] + radii[j]
            gap = squared_distance(at, i, at, j)
            if gap < apart * apart and gap < squared_distance(start, i, start, j):
                return SELF_CONTACT, i, j
    return NO_CONTACT, -1, 0


@njit(cache=True, nogil=True)
def mark_initial_contacts(spheres, start, known, team, ignored):
    """Mark the spheres that touch something where the robot already stands."""
    radii, first = spheres[2], spheres[3]
    states, near, lower, scale, margin = known
    centers, wide, team_margin = team
    for s in range(first, len(radii)):
        state = map_contact(start, s, radii[s], states, near, lower, scale, margin)
        mate = team_contact(start, s, radii[s], centers, wide, team_margin)
        ignored[s] = state > 0 or mate >= 0


@njit(cache=True, nogil=True)
def ignore_unmoved_contacts(spheres, start, goal, step, ignored, out):
    """Of the excused spheres, those that are at the goal where they were at the start."""
    for s in range(spheres[3], len(start)):
        out[s] = ignored[s] and squared_distance(start, s, goal, s) < step * step


@njit(cache=True, nogil=True)
def count_waypoints(body, spheres, q0, q1, work, step, counts, here, there):
    """Cut a motion into pieces, and those so that no centre moves more than `step` at a time.

    Returns the number of pieces; `counts` tells the steps in each. `here` and `there` (s, 3) are
    scratch.
    """
    first = spheres[3]
    largest = 0.0
    for n in range(len(q0)):
        largest = max(largest, abs(q1[n] - q0[n]))
    pieces = min(int(np.ceil(largest / MAX_SEGMENT)), len(counts))
    sphere_positions(body, spheres, q0, work, first, here)
    for piece in range(pieces):
        q = q0 + (q1 - q0) * ((piece + 1.0) / pieces)
        sphere_positions(body, spheres, q, work, first, there)
        farthest = 0.0
        for s in range(first, len(there)):
            farthest = max(farthest, squared_distance(here, s, there, s))
            for i in range(3):
                here[s, i] = there[s, i]
        # a little more, for arcs are longer than chords and not run through evenly
        counts[piece] = int(1.15 * np.sqrt(farthest) / step) + 1
    return pieces


@njit(cache=True, nogil=True)
def first_contact_on_path(
    body, spheres, known, team, q0, q1, work, step, counts, start, ignored, at
):
    """First contact before the goal: (kind, sphere, with what, share of the motion before it).

    Without a contact the share is that of the last step before the goal.
    """
    pieces = count_waypoints(body, spheres, q0, q1, work, step, counts, start.copy(), at)
    q, fraction = np.empty(len(q0)), 0.0
    for piece in range(pieces):
        for w in range(1, counts[piece] + (piece < pieces - 1)):
            there = (piece + w / counts[piece]) / pieces
            for n in range(len(q)):
                q[n] = q0[n] + (q1[n] - q0[n]) * there
            sphere_positions(body, spheres, q, work, spheres[3], at)
            kind, s, other = pose_contact(spheres, at, start, known, team, ignored)
            if kind != NO_CONTACT:
                return kind, s, other, fraction
            fraction = there
    return NO_CONTACT, -1, 0, fraction


@njit(cache=True, nogil=True)
def first_contacts(body, base, spheres, known, team, q0, q1, step, goal_first, counts, found, at):
    """First contacts on the straight joint motions from q0 (n,) to each of q1 (k, n).

    Writes per motion `found` (k, 5): kind, sphere, with what, share of the motion that is free,
    whether it is the goal's contact; and where the spheres are then, `at` (k, s, 3). With
    `goal_first` the goal is asked about before the way there; the share is 0 if it is in contact.
    """
    n_bodies, n_spheres, first = len(body.parent), len(spheres[0]), spheres[3]
    R, t = np.empty((n_bodies, 3, 3)), np.empty((n_bodies, 3))
    R[0], t[0] = base[0], base[1]
    work = (R, t, np.empty((3, 3)))
    start, goal = np.empty((n_spheres, 3)), np.empty((n_spheres, 3))
    touching = np.zeros(n_spheres, dtype=np.bool_)
    ignored = np.zeros(n_spheres, dtype=np.bool_)
    sphere_positions(body, spheres, q0, work, 0, start)
    goal[:] = start
    mark_initial_contacts(spheres, start, known, team, touching)
    for m in range(len(q1)):
        sphere_positions(body, spheres, q1[m], work, first, goal)
        ignore_unmoved_contacts(spheres, start, goal, step, touching, ignored)
        kind, s, other = pose_contact(spheres, goal, start, known, team, ignored)
        fraction, at_goal = 0.0, kind != NO_CONTACT
        if not (at_goal and goal_first):
            ignored[:] = touching
            at[m] = start
            path_kind, path_sphere, path_other, fraction = first_contact_on_path(
                body, spheres, known, team, q0, q1[m], work, step, counts, start, ignored, at[m]
            )
            if path_kind != NO_CONTACT:
                kind, s, other, at_goal = path_kind, path_sphere, path_other, False
            elif not at_goal:
                fraction = 1.0
        if at_goal:
            at[m] = goal
        found[m, 0], found[m, 1], found[m, 2] = kind, s, other
        found[m, 3], found[m, 4] = fraction, at_goal


@njit(cache=True, nogil=True)
def are_poses_free(body, base, spheres, known, team, q, out):
    """Whether poses q (k, n) are clear, wherever the robot comes from: out (k,)."""
    n_bodies, n_spheres = len(body.parent), len(spheres[0])
    R, t = np.empty((n_bodies, 3, 3)), np.empty((n_bodies, 3))
    R[0], t[0] = base[0], base[1]
    work = (R, t, np.empty((3, 3)))
    at = np.empty((n_spheres, 3))
    nowhere = np.zeros((n_spheres, 3))
    nowhere[:, 0] = 1e9 * np.arange(n_spheres)  # far apart, so that no touching is excused
    ignored = np.zeros(n_spheres, dtype=np.bool_)
    for k in range(len(q)):
        sphere_positions(body, spheres, q[k], work, 0, at)
        out[k] = pose_contact(spheres, at, nowhere, known, team, ignored)[0] == NO_CONTACT
