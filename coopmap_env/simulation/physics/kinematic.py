"""Kinematic motion: one vehicle after the other is set to configurations along its path.

The configurations are so near to each other that no part of the mount moves further than
`WAYPOINT_SPACING` in between; the body is at its static equilibrium in each. A mount that touches
something ends at the last configuration before the contact.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from coopmap_env.simulation.physics._path import coarse_path, interpolate
from coopmap_env.simulation.physics.world import BulletWorld

WAYPOINT_SPACING = 0.03
"""Metres between configurations that are checked: less than the thickness of any obstacle."""


def move_kinematically(world: BulletWorld, robot: int, goal: NDArray[np.float64]) -> str:
    """Move a vehicle's mount along the straight path to joints (n,).

    A mount that is in contact at the start moves as long as it does not get in deeper.

    Returns
    -------
    str
        What it touched; empty if nothing.
    """
    start = world.q[robot][-len(goal) :]
    fractions, joints = coarse_path(start, goal)
    q = world.rest_configurations(robot, joints)
    may_collide, travel = world.swept_collisions(robot, q)
    if may_collide.any():
        fractions = _fine_fractions(fractions, may_collide, travel)
        q = world.rest_configurations(robot, interpolate(start, goal, fractions))
        last, obstacle = _last_collision_free(world, robot, q)
        if obstacle:
            world.set_configuration(robot, q[last])
            return obstacle
    world.set_configuration(robot, q[-1])
    return ""


def _fine_fractions(
    fractions: NDArray[np.float64],
    may_collide: NDArray[np.bool_],
    travel: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Fractions of the path to check: one every `WAYPOINT_SPACING` in each marked segment."""
    fine = []
    for k in np.flatnonzero(may_collide):
        parts = math.ceil(1.1 * travel[k] / WAYPOINT_SPACING) + 1
        fine.append(np.linspace(fractions[k], fractions[k + 1], parts))
    return np.unique(np.concatenate([*fine, fractions[-1:]]))


def _last_collision_free(world: BulletWorld, robot: int, q: NDArray[np.float64]) -> tuple[int, str]:
    """Index of the last configuration of q (k, m) before a contact, and the obstacle."""
    allowed = -math.inf
    for k, configuration in enumerate(q):
        world.set_configuration(robot, configuration)
        world.find_contacts()
        depth, obstacle = world.contacts()[robot]
        if k == 0:
            allowed = depth
        if depth < allowed:
            return k - 1, obstacle
        allowed = depth
    return len(q) - 1, ""
