"""How vehicles in a physics world move their mounts: set along the way, or stepped.

Both take straight motions in the space of the joints, stop a mount that touches something where it
is free, and leave each body at rest on its suspension.

Kinematic: one vehicle after the other is set to configurations along its way, so near to each
other that no part moves further than `WAYPOINT_SPACING` in between, its body at its static equilibrium.
Stepped: all move at once under their motors, bodies swing on their springs, until all is quiet.
Where nothing is near to any way, time steps are longer: less is known of the swinging in between,
but there is nothing to swing into, and where bodies come to rest does not depend on it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coopmap_env.simulation.physics.world import BulletWorld

WAYPOINT_SPACING = 0.03
"""Metres between configurations that are looked at: less than anything in the way is thick."""
COARSE_STEP = 0.15
"""Radians or metres: of the fastest joint, between the configurations of the quick check."""


@dataclass(frozen=True)
class SteppingSettings:
    """How stepped motions are made.

    Raises
    ------
    ValueError
        If a value is not positive.
    """

    time_step: float = 1.0 / 30.0
    """Seconds. The bodies swing at 2 to 4 Hz."""
    free_time_step: float = 1.0 / 12.0
    """Seconds: the step of motions that have `FREE_CLEARANCE` to all sides."""
    speed_factor: float = 3.0
    """Of the joints, as a multiple of their limits in the URDF: what counts is where a motion
    ends, and what is faster costs less."""
    rest_speed: float = 1e-3
    """m/s and rad/s: a body that is slower than this, with its springs in `REST_IMBALANCE`, has come to
    rest. Its camera is then within 0.2 mm and 0.01 degrees of where it will be."""
    settle_timeout: float = 5.0
    """Seconds after the end of the motion, by which all must be at rest and free."""

    def __post_init__(self) -> None:
        for name in ("time_step", "free_time_step", "speed_factor", "rest_speed", "settle_timeout"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"SteppingSettings.{name} must be finite and > 0, got {value}")


REST_IMBALANCE = 3e-5
"""Metres or radians between a spring's deflection and the one that would carry its load."""
FREE_CLEARANCE = 0.1
"""Metres: more than the swinging of its body moves a mount off its way (some 5 cm). Contacts are
looked for in any case."""
SPHERE_SPACING = 0.8
"""Metres of a way, at most, between the configurations that stand for it to other vehicles."""
TARGET_TOLERANCE = 1e-4
"""Radians or metres between a joint and its target."""
RAMP_FRACTION = 0.25
"""Share of a motion's time in which it speeds up, and in which it slows down."""
NO_SPHERES = np.zeros((0, 4))
RETREAT_STEP = 0.01
"""Metres by which a mount that touches something goes back in each step."""
MAX_JOINT_SPEED = 3.0
"""rad/s or m/s: no joint goes faster, whatever its limit."""


def move_kinematically(world: BulletWorld, robot: int, goal: NDArray[np.float64]) -> str:
    """Set a vehicle's mount along the straight way to its goal (n,); what it touched, or "".

    It ends at the last configuration before a contact. A mount that is in contact at the start
    moves as long as it does not get in deeper.
    """
    start = world.q[robot][-len(goal) :]
    fraction, joints = _coarse_path(start, goal)
    q = world.rest_configurations(robot, joints)
    may_collide, travel = world.swept_collisions(robot, q)
    if may_collide.any():
        fraction = _fine_fractions(fraction, may_collide, travel)
        q = world.rest_configurations(robot, start + fraction[:, None] * (goal - start))
        last, obstacle = _last_collision_free(world, robot, q)
        if obstacle:
            world.set_configuration(robot, q[last])
            return obstacle
    world.set_configuration(robot, q[-1])
    return ""


def _coarse_path(
    start: NDArray[np.float64], goal: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Shares (k,) of a way and the joints (k, n) there, for the quick check."""
    n = max(1, math.ceil(np.abs(goal - start).max() / COARSE_STEP))
    fraction = np.linspace(0.0, 1.0, n + 1)
    return fraction, start + fraction[:, None] * (goal - start)


def _fine_fractions(
    fraction: NDArray[np.float64], may_collide: NDArray[np.bool_], travel: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Shares of the way to look at: the ends of marked stretches and, within, every `WAYPOINT_SPACING`."""
    fine = []
    for k in np.flatnonzero(may_collide):
        parts = math.ceil(1.1 * travel[k] / WAYPOINT_SPACING) + 1
        fine.append(np.linspace(fraction[k], fraction[k + 1], parts))
    return np.unique(np.concatenate([*fine, fraction[-1:]]))


def _last_collision_free(world: BulletWorld, robot: int, q: NDArray[np.float64]) -> tuple[int, str]:
    """Index of the last configuration of q (k, m) before a contact, and with what."""
    allowed = -math.inf
    for k, at in enumerate(q):
        world.set_configuration(robot, at)
        world.find_contacts()
        depth, obstacle = world.contacts()[robot]
        if k == 0:
            allowed = depth
        if depth < allowed:
            return k - 1, obstacle
        allowed = depth
    return len(q) - 1, ""


def move_stepped(
    world: BulletWorld, goals: Sequence[NDArray[np.float64]], stepping: SteppingSettings
) -> list[str]:
    """Let all vehicles move their mounts to their goals (n,) at once; what each touched, or "".

    A mount that touches something goes back along its way until it is free, and stays. If all are
    not free and at rest in time, those that are not free are put back to where they began.
    """
    paths = [StraightPath.to_goal(world, robot, goal) for robot, goal in enumerate(goals)]
    time_step = stepping.free_time_step if _paths_are_free(world, paths) else stepping.time_step
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
        if all(tracker.is_done for tracker in trackers) and _is_at_rest(
            world, trackers, stepping.rest_speed
        ):
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
    """Whether all bodies have come to rest, and all joints to their targets."""
    speeds = [world.velocity(robot) for robot in range(len(trackers))]
    for robot, tracker in enumerate(trackers):
        n = len(tracker.target)
        swing = np.abs(speeds[robot][:-n])
        missing = np.abs(world.q[robot][-n:] - tracker.target)
        if (
            (swing > rest_speed).any()
            or (missing > TARGET_TOLERANCE).any()
            or world.spring_imbalance(robot) > REST_IMBALANCE
        ):
            return False
    return True


@dataclass(frozen=True)
class StraightPath:
    """A straight way of one mount, and what is known of it in advance."""

    robot: int
    q: NDArray[np.float64]
    """Shape (k, m): configurations on it, each body at rest."""
    goal: NDArray[np.float64]
    """Shape (n,)."""
    may_collide: bool
    """Whether the mount may come as near as `FREE_CLEARANCE` to any solid, or touch its own vehicle."""
    travel: NDArray[np.float64]
    """Shape (k - 1,): metres that the fastest part of the mount goes in between."""

    @classmethod
    def to_goal(cls, world: BulletWorld, robot: int, goal: NDArray[np.float64]) -> StraightPath:
        """From where a vehicle is; `goal` (n,)."""
        q = world.rest_configurations(robot, _coarse_path(world.q[robot][-len(goal) :], goal)[1])
        may_collide, travel = world.swept_collisions(robot, q, NO_SPHERES, FREE_CLEARANCE)
        return cls(robot, q, goal, bool(may_collide.any()), travel)

    def spheres(self, world: BulletWorld) -> NDArray[np.float64]:
        """Centres and radii (s, 4) around all that the vehicle takes up, with twice `FREE_CLEARANCE`."""
        at, travelled, furthest = [0], 0.0, 0.0
        for k, travel in enumerate(self.travel.tolist()):
            if travelled > 0.0 and travelled + travel > SPHERE_SPACING:
                at.append(k)
                travelled = 0.0
            travelled += travel
            furthest = max(furthest, travelled)
        at.append(len(self.travel))
        spheres = np.concatenate([world.spheres(self.robot, self.q[k]) for k in at])
        # half of what a part goes between two of them; arcs are a little longer than their chords
        spheres[:, 3] += 0.55 * furthest + 2.0 * FREE_CLEARANCE
        return spheres


def _paths_are_free(world: BulletWorld, paths: Sequence[StraightPath]) -> bool:
    """Whether nothing is near to any way, other vehicles on theirs included."""
    if any(path.may_collide for path in paths):
        return False
    occupied_spheres = [path.spheres(world) for path in paths] if len(paths) > 1 else []
    for path in paths:
        near = [
            other
            for robot, other in enumerate(occupied_spheres)
            if robot != path.robot and _bounds_overlap(occupied_spheres[path.robot], other)
        ]
        if (
            near
            and world.swept_collisions(path.robot, path.q, np.concatenate(near), FREE_CLEARANCE)[
                0
            ].any()
        ):
            return False
    return True


def _bounds_overlap(a: NDArray[np.float64], b: NDArray[np.float64]) -> bool:
    """Whether boxes around two sets of spheres (s, 4) overlap."""
    lower = [(spheres[:, :3] - spheres[:, 3:]).min(axis=0) for spheres in (a, b)]
    upper = [(spheres[:, :3] + spheres[:, 3:]).max(axis=0) for spheres in (a, b)]
    return bool((lower[0] <= upper[1]).all() and (lower[1] <= upper[0]).all())


class TrajectoryTracker:
    """One vehicle's way in time, how far along it the mount is, and what stopped it."""

    def __init__(
        self, path: StraightPath, fractions: NDArray[np.float64], time_step: float
    ) -> None:
        self.q = path.q[0]
        """Where the vehicle began, its body at rest."""
        self.start, self.goal = self.q[-len(path.goal) :], path.goal
        self.target = self.start
        self.acceleration: NDArray[np.float64] | None = None
        """That of the next step (n,), if it is known."""
        self.obstacle = ""
        self.fractions: list[float] = [*fractions.tolist(), 1.0]
        """Of the way, after each time step; in the last of them the mount comes to a halt."""
        before = [0.0, 0.0, *self.fractions]
        self._changes = [
            c - 2.0 * b + a for a, b, c in zip(before, before[1:], self.fractions, strict=False)
        ]
        self._to_goal = self.goal - self.start
        self._per_step = self._to_goal / time_step**2
        self._length = float(path.travel.sum())
        self._fraction = 0.0
        self._next_step = 0
        self._retreat_fraction = 0.0
        self._in_contact = self._retreating = False

    @classmethod
    def along(
        cls, world: BulletWorld, path: StraightPath, speed_factor: float, time_step: float
    ) -> TrajectoryTracker:
        """All joints together, at a pace that keeps each below `speed_factor` times its limit."""
        speeds = np.minimum(
            speed_factor * world.vehicles[path.robot].joint_map.speed_limits, MAX_JOINT_SPEED
        )
        start = path.q[0, -len(path.goal) :]
        duration = float((np.abs(path.goal - start) / speeds).max()) / (1.0 - RAMP_FRACTION)
        n = max(1, math.ceil(duration / time_step))
        return cls(path, trapezoidal_profile(np.arange(1, n + 1) / n), time_step)

    @property
    def is_done(self) -> bool:
        """Whether it stays: at its goal, or free of what stopped it."""
        return not self._retreating if self.obstacle else self._next_step == len(self.fractions)

    def step(self) -> bool:
        """One step along the way, or back if something is touched; whether the target is new."""
        if self.is_done:
            return False
        if self.obstacle:
            self._retreating = self._in_contact  # one step more than needed, for good measure
            self._in_contact = False
            self._fraction = max(0.0, self._fraction - self._retreat_fraction)
            self.acceleration = None
        else:
            self._fraction = self.fractions[self._next_step]
            self.acceleration = self._changes[self._next_step] * self._per_step
            self._next_step += 1
        self.target = self.start + self._fraction * self._to_goal
        return True

    def record_contact(self, obstacle: str) -> None:
        """Take note of a contact: it ends the motion."""
        if not self.obstacle:
            self.obstacle = obstacle
            self._retreat_fraction = RETREAT_STEP / max(self._length, RETREAT_STEP)
        self._in_contact = self._retreating = True


def trapezoidal_profile(time: NDArray[np.float64]) -> NDArray[np.float64]:
    """Shares of the way at shares of the time: constant speed between two ramps."""
    ramp_time = np.minimum(time, 1.0 - time)
    top_speed = 1.0 / (1.0 - RAMP_FRACTION)
    travelled = (
        np.where(
            ramp_time < RAMP_FRACTION,
            ramp_time**2 / (2.0 * RAMP_FRACTION),
            ramp_time - RAMP_FRACTION / 2.0,
        )
        * top_speed
    )
    return np.where(time < 0.5, travelled, 1.0 - travelled)


def _revert_collisions(world: BulletWorld, trackers: Sequence[TrajectoryTracker]) -> None:
    """Put back, first those that touch something, in the end all: they began free."""
    for revert_all in (False, True):
        world.find_contacts()
        touching = [bool(obstacle) for _, obstacle in world.contacts()]
        colliding = [
            robot for robot, tracker in enumerate(trackers) if tracker.obstacle and touching[robot]
        ]
        for robot in range(len(trackers)) if revert_all and colliding else colliding:
            world.set_configuration(robot, trackers[robot].q)
