"""Stepped motion: all vehicles move at once under their motors, until all are at rest.

Bodies swing on their springs meanwhile. A mount that touches something goes back along its path
until it is free. Where nothing is near to any path, time steps are longer: the oscillation is
resolved less well, but there is nothing to collide with, and where bodies come to rest does not
depend on it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.settings import Bounds, Positive, Settings
from coopmap_env.simulation.physics._path import StraightPath, are_paths_free
from coopmap_env.simulation.physics._trajectory import TrajectoryTracker
from coopmap_env.simulation.physics.world import BulletWorld

REST_IMBALANCE = 3e-5
"""Metres or radians between a spring's deflection and the one that would carry its load."""
TARGET_TOLERANCE = 1e-4
"""Radians or metres between a joint and its target."""


@dataclass(frozen=True)
class SteppingSettings(Settings):
    """How stepped motions are made."""

    time_step: Annotated[float, Bounds(above=0, smallest=1e-4, largest=1)] = 1.0 / 30.0
    """Seconds. The bodies swing at 2 to 4 Hz."""
    free_time_step: Annotated[float, Bounds(above=0, smallest=1e-4, largest=1)] = 1.0 / 12.0
    """Seconds: the step of motions with `FREE_CLEARANCE` on all sides."""
    speed_factor: Annotated[float, Bounds(above=0, smallest=0.01, largest=1000)] = 3.0
    """Speed of the joints as a multiple of their limits in the URDF: only where a motion ends
    matters, and a faster one costs less."""
    rest_speed: Positive = 1e-3
    """m/s and rad/s: a body that is slower than this, with its springs within `REST_IMBALANCE`, is
    at rest. Its camera is then within 0.2 mm and 0.01 degrees of its final pose."""
    settle_timeout: Annotated[float, Bounds(above=0, largest=100)] = 5.0
    """Seconds after the end of the motion, by which all must be at rest and free."""


def move_stepped(
    world: BulletWorld, goals: Sequence[NDArray[np.float64]], stepping: SteppingSettings
) -> list[str]:
    """Move the mounts of all vehicles to their goals (n,) at once.

    A mount that touches something goes back along its path until it is free, and stays. If all
    are not free and at rest in time, those that are not free return to where they began.

    Returns
    -------
    list of str
        What each mount touched; empty if nothing.
    """
    paths = [StraightPath.to_goal(world, robot, goal) for robot, goal in enumerate(goals)]
    time_step = stepping.free_time_step if are_paths_free(world, paths) else stepping.time_step
    world.set_time_step(time_step)
    trackers = [
        TrajectoryTracker.along(world, path, stepping.speed_factor, time_step) for path in paths
    ]
    longest = max(len(tracker.fractions) for tracker in trackers)
    for _ in range(longest + math.ceil(stepping.settle_timeout / time_step)):
        for robot, tracker in enumerate(trackers):
            if tracker.step():
                world.set_motor_targets(robot, tracker.target, tracker.acceleration)
        world.step()
        for robot, (depth, obstacle) in enumerate(world.contacts()):
            if depth < 0.0:
                trackers[robot].record_contact(obstacle)
        is_done = all(tracker.is_done for tracker in trackers)
        if is_done and _is_at_rest(world, trackers, stepping.rest_speed):
            break
    else:
        for robot, tracker in enumerate(trackers):
            world.velocity(robot)
            joints = world.q[robot][-len(tracker.target) :]
            world.set_configuration(robot, world.rest_configurations(robot, joints[None])[0])
    _revert_collisions(world, trackers)
    return [tracker.obstacle for tracker in trackers]


def _is_at_rest(
    world: BulletWorld, trackers: Sequence[TrajectoryTracker], rest_speed: float
) -> bool:
    """Whether all bodies are at rest, and all joints at their targets."""
    velocities = [world.velocity(robot) for robot in range(len(trackers))]
    for robot, tracker in enumerate(trackers):
        n = len(tracker.target)
        body_speed = np.abs(velocities[robot][:-n])
        error = np.abs(world.q[robot][-n:] - tracker.target)
        if (body_speed > rest_speed).any() or (error > TARGET_TOLERANCE).any():
            return False
        if world.spring_imbalance(robot) > REST_IMBALANCE:
            return False
    return True


def _revert_collisions(world: BulletWorld, trackers: Sequence[TrajectoryTracker]) -> None:
    """Put back first those that touch something, in the end all: they began free."""
    for revert_all in (False, True):
        world.find_contacts()
        in_contact = [bool(obstacle) for _, obstacle in world.contacts()]
        colliding = [
            robot
            for robot, tracker in enumerate(trackers)
            if tracker.obstacle and in_contact[robot]
        ]
        for robot in range(len(trackers)) if revert_all and colliding else colliding:
            world.set_configuration(robot, trackers[robot].q)
