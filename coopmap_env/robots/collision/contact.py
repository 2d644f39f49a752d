"""The kernel that walks along a straight joint motion and finds its first contact."""

from __future__ import annotations

import numpy as np
from numba import njit

from coopmap_env.robots.collision.clearance import is_near, sphere_state
from coopmap_env.robots.kinematics.forward import body_poses

NOTHING, MAP, SELF, TEAM = range(4)
"""What a sphere touches: nothing, a blocked voxel, an own link, a teammate."""

PIECE = 0.25
"""Radians or metres: within such a piece of a motion all paths are next to straight."""


@njit(cache=True, nogil=True)
def place_spheres(body, spheres, q, work, first, out):
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
def square_gap(a, i, b, j):
    """Squared distance of point i of `a` (n, 3) and point j of `b` (m, 3)."""
    dx, dy, dz = a[i, 0] - b[j, 0], a[i, 1] - b[j, 1], a[i, 2] - b[j, 2]
    return dx * dx + dy * dy + dz * dz


@njit(cache=True, nogil=True)
def map_contact(at, s, radius, states, near, lower, scale, margin):
    """The worst state of the voxels that sphere s meets."""
    x = (at[s, 0] - lower[0]) * scale
    y = (at[s, 1] - lower[1]) * scale
    z = (at[s, 2] - lower[2]) * scale
    if is_near(near, x, y, z):
        return sphere_state(states, x, y, z, (radius + margin) * scale)
    return 0


@njit(cache=True, nogil=True)
def team_contact(at, s, radius, centers, radii, margin):
    """Number of a teammate's sphere that sphere s meets, -1 if there is none."""
    for m in range(len(centers)):
        apart = radius + radii[m] + margin
        if square_gap(at, s, centers, m) < apart * apart:
            return m
    return -1


@njit(cache=True, nogil=True)
def pose_contact(spheres, at, start, known, team, excused):
    """The first contact of a pose whose spheres stand `at` (s, 3): (kind, sphere, with what).

    `excused` (s,) marks spheres that touched something where the motion starts: they may, until
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
            excused[s] = False
        elif not excused[s]:
            return (MAP, s, state) if state > 0 else (TEAM, s, mate)
    for i in range(first, len(radii)):
        begin = rows[i, 0]
        apart = radii[i] + ball[0, 3]
        if square_gap(at, i, ball, 0) > apart * apart:  # away from all that does not move
            begin = rows[i, 1]
        for p in range(begin, rows[i, 2]):
            j = partners[p]
            apart = radii[i] + radii[j]
            gap = square_gap(at, i, at, j)
            if gap < apart * apart and gap < square_gap(start, i, start, j):
                return SELF, i, j
    return NOTHING, -1, 0


@njit(cache=True, nogil=True)
def excuse(spheres, start, known, team, excused):
    """Mark the spheres that touch something where the robot already stands."""
    radii, first = spheres[2], spheres[3]
    states, near, lower, scale, margin = known
    centers, wide, team_margin = team
    for s in range(first, len(radii)):
        state = map_contact(start, s, radii[s], states, near, lower, scale, margin)
        mate = team_contact(start, s, radii[s], centers, wide, team_margin)
        excused[s] = state > 0 or mate >= 0


@njit(cache=True, nogil=True)
def excuse_at_rest(spheres, start, goal, step, excused, out):
    """Of the excused spheres, those that are at the goal where they were at the start."""
    for s in range(spheres[3], len(start)):
        out[s] = excused[s] and square_gap(start, s, goal, s) < step * step


@njit(cache=True, nogil=True)
def n_waypoints(body, spheres, q0, q1, work, step, counts, here, there):
    """Cut a motion into pieces, and those so that no centre moves more than `step` at a time.

    Returns the number of pieces; `counts` tells the steps in each. `here` and `there` (s, 3) are
    scratch.
    """
    first = spheres[3]
    largest = 0.0
    for n in range(len(q0)):
        largest = max(largest, abs(q1[n] - q0[n]))
    pieces = min(int(np.ceil(largest / PIECE)), len(counts))
    place_spheres(body, spheres, q0, work, first, here)
    for piece in range(pieces):
        q = q0 + (q1 - q0) * ((piece + 1.0) / pieces)
        place_spheres(body, spheres, q, work, first, there)
        farthest = 0.0
        for s in range(first, len(there)):
            farthest = max(farthest, square_gap(here, s, there, s))
            for i in range(3):
                here[s, i] = there[s, i]
        # a little more, for arcs are longer than chords and not run through evenly
        counts[piece] = int(1.15 * np.sqrt(farthest) / step) + 1
    return pieces


@njit(cache=True, nogil=True)
def along_the_way(body, spheres, known, team, q0, q1, work, step, counts, start, excused, at):
    """First contact before the goal: (kind, sphere, with what, share of the motion before it).

    Without a contact the share is that of the last step before the goal.
    """
    pieces = n_waypoints(body, spheres, q0, q1, work, step, counts, start.copy(), at)
    q, share = np.empty(len(q0)), 0.0
    for piece in range(pieces):
        for w in range(1, counts[piece] + (piece < pieces - 1)):
            there = (piece + w / counts[piece]) / pieces
            for n in range(len(q)):
                q[n] = q0[n] + (q1[n] - q0[n]) * there
            place_spheres(body, spheres, q, work, spheres[3], at)
            kind, s, other = pose_contact(spheres, at, start, known, team, excused)
            if kind != NOTHING:
                return kind, s, other, share
            share = there
    return NOTHING, -1, 0, share


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
    excused = np.zeros(n_spheres, dtype=np.bool_)
    place_spheres(body, spheres, q0, work, 0, start)
    goal[:] = start
    excuse(spheres, start, known, team, touching)
    for m in range(len(q1)):
        place_spheres(body, spheres, q1[m], work, first, goal)
        excuse_at_rest(spheres, start, goal, step, touching, excused)
        kind, s, other = pose_contact(spheres, goal, start, known, team, excused)
        share, at_goal = 0.0, kind != NOTHING
        if not (at_goal and goal_first):
            excused[:] = touching
            at[m] = start
            on_way, s_way, other_way, share = along_the_way(
                body, spheres, known, team, q0, q1[m], work, step, counts, start, excused, at[m]
            )
            if on_way != NOTHING:
                kind, s, other, at_goal = on_way, s_way, other_way, False
            elif not at_goal:
                share = 1.0
        if at_goal:
            at[m] = goal
        found[m, 0], found[m, 1], found[m, 2] = kind, s, other
        found[m, 3], found[m, 4] = share, at_goal


@njit(cache=True, nogil=True)
def are_clear(body, base, spheres, known, team, q, out):
    """Whether poses q (k, n) are clear, wherever the robot comes from: out (k,)."""
    n_bodies, n_spheres = len(body.parent), len(spheres[0])
    R, t = np.empty((n_bodies, 3, 3)), np.empty((n_bodies, 3))
    R[0], t[0] = base[0], base[1]
    work = (R, t, np.empty((3, 3)))
    at = np.empty((n_spheres, 3))
    nowhere = np.zeros((n_spheres, 3))
    nowhere[:, 0] = 1e9 * np.arange(n_spheres)  # far apart, so that no touching is excused
    excused = np.zeros(n_spheres, dtype=np.bool_)
    for k in range(len(q)):
        place_spheres(body, spheres, q[k], work, 0, at)
        out[k] = pose_contact(spheres, at, nowhere, known, team, excused)[0] == NOTHING
