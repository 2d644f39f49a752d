"""How vehicles in a physics world move their mounts: set along the way, or stepped.

Both take straight motions in the space of the joints, stop a mount that touches something where it
is free, and leave each body at rest on its suspension.

Kinematic: one vehicle after the other is set to configurations along its way, so near to each
other that no part moves further than `WAYPOINT` in between, its body at its static equilibrium.
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

WAYPOINT = 0.03
"""Metres between configurations that are looked at: less than anything in the way is thick."""
COARSE = 0.15
"""Radians or metres: of the fastest joint, between the configurations of the quick check."""


@dataclass(frozen=True)
class Stepping:
    """How stepped motions are made.

    Raises
    ------
    ValueError
        If a value is not positive.
    """

    time_step: float = 1.0 / 30.0
    """Seconds. The bodies swing at 2 to 4 Hz."""
    free_step: float = 1.0 / 12.0
    """Seconds: the step of motions that have `FREE` to all sides."""
    speed: float = 3.0
    """Of the joints, as a multiple of their limits in the URDF: what counts is where a motion
    ends, and what is faster costs less."""
    still: float = 1e-3
    """m/s and rad/s: a body that is slower than this, with its springs in `BALANCE`, has come to
    rest. Its camera is then within 0.2 mm and 0.01 degrees of where it will be."""
    patience: float = 5.0
    """Seconds after the end of the motion, by which all must be at rest and free."""

    def __post_init__(self) -> None:
        for name in ("time_step", "free_step", "speed", "still", "patience"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"Stepping.{name} must be finite and > 0, got {value}")


BALANCE = 3e-5
"""Metres or radians between a spring's deflection and the one that would carry its load."""
FREE = 0.1
"""Metres: more than the swinging of its body moves a mount off its way (some 5 cm). Contacts are
looked for in any case."""
APART = 0.8
"""Metres of a way, at most, between the configurations that stand for it to other vehicles."""
REACHED = 1e-4
"""Radians or metres between a joint and its target."""
RAMP = 0.25
"""Share of a motion's time in which it speeds up, and in which it slows down."""
NO_SPHERES = np.zeros((0, 4))
RETREAT = 0.01
"""Metres by which a mount that touches something goes back in each step."""
FASTEST = 3.0
"""rad/s or m/s: no joint goes faster, whatever its limit."""


def move_kinematically(world: BulletWorld, robot: int, goal: NDArray[np.float64]) -> str:
    """Set a vehicle's mount along the straight way to its goal (n,); what it touched, or "".

    It ends at the last configuration before a contact. A mount that is in contact at the start
    moves as long as it does not get in deeper.
    """
    start = world.q[robot][-len(goal) :]
    share, joints = _coarse(start, goal)
    q = world.at_rest(robot, joints)
    marked, moved = world.stretches(robot, q)
    if marked.any():
        share = _waypoints(share, marked, moved)
        q = world.at_rest(robot, start + share[:, None] * (goal - start))
        last, what = _last_free(world, robot, q)
        if what:
            world.place(robot, q[last])
            return what
    world.place(robot, q[-1])
    return ""


def _coarse(
    start: NDArray[np.float64], goal: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Shares (k,) of a way and the joints (k, n) there, for the quick check."""
    n = max(1, math.ceil(np.abs(goal - start).max() / COARSE))
    share = np.linspace(0.0, 1.0, n + 1)
    return share, start + share[:, None] * (goal - start)


def _waypoints(
    share: NDArray[np.float64], marked: NDArray[np.bool_], moved: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Shares of the way to look at: the ends of marked stretches and, within, every `WAYPOINT`."""
    fine = []
    for k in np.flatnonzero(marked):
        parts = math.ceil(1.1 * moved[k] / WAYPOINT) + 1
        fine.append(np.linspace(share[k], share[k + 1], parts))
    return np.unique(np.concatenate([*fine, share[-1:]]))


def _last_free(world: BulletWorld, robot: int, q: NDArray[np.float64]) -> tuple[int, str]:
    """Index of the last configuration of q (k, m) before a contact, and with what."""
    allowed = -math.inf
    for k, at in enumerate(q):
        world.place(robot, at)
        world.find_contacts()
        depth, what = world.contacts()[robot]
        if k == 0:
            allowed = depth
        if depth < allowed:
            return k - 1, what
        allowed = depth
    return len(q) - 1, ""


def move_stepped(
    world: BulletWorld, goals: Sequence[NDArray[np.float64]], stepping: Stepping
) -> list[str]:
    """Let all vehicles move their mounts to their goals (n,) at once; what each touched, or "".

    A mount that touches something goes back along its way until it is free, and stays. If all are
    not free and at rest in time, those that are not free are put back to where they began.
    """
    ways = [Way.of(world, robot, goal) for robot, goal in enumerate(goals)]
    time_step = stepping.free_step if _are_free(world, ways) else stepping.time_step
    world.pace(time_step)
    tracks = [Track.of(world, way, stepping.speed, time_step) for way in ways]
    longest = max(len(track.shares) for track in tracks)
    for _ in range(longest + math.ceil(stepping.patience / time_step)):
        for robot, track in enumerate(tracks):
            if track.advance():
                world.aim(robot, track.target, track.acceleration)
        world.step()
        for robot, (depth, what) in enumerate(world.contacts()):
            if depth < 0.0:
                tracks[robot].stop(what)
        if all(track.arrived for track in tracks) and _is_still(world, tracks, stepping.still):
            break
    else:
        for robot, track in enumerate(tracks):
            world.velocity(robot)
            joints = world.q[robot][-len(track.target) :]
            world.place(robot, world.at_rest(robot, joints[None])[0])
    _undo_what_touches(world, tracks)
    return [track.what for track in tracks]


def _is_still(world: BulletWorld, tracks: Sequence[Track], slow: float) -> bool:
    """Whether all bodies have come to rest, and all joints to their targets."""
    speeds = [world.velocity(robot) for robot in range(len(tracks))]
    for robot, track in enumerate(tracks):
        n = len(track.target)
        swing = np.abs(speeds[robot][:-n])
        missing = np.abs(world.q[robot][-n:] - track.target)
        if (swing > slow).any() or (missing > REACHED).any() or world.unbalanced(robot) > BALANCE:
            return False
    return True


@dataclass(frozen=True)
class Way:
    """A straight way of one mount, and what is known of it in advance."""

    robot: int
    q: NDArray[np.float64]
    """Shape (k, m): configurations on it, each body at rest."""
    goal: NDArray[np.float64]
    """Shape (n,)."""
    touches: bool
    """Whether the mount may come as near as `FREE` to any solid, or touch its own vehicle."""
    moved: NDArray[np.float64]
    """Shape (k - 1,): metres that the fastest part of the mount goes in between."""

    @classmethod
    def of(cls, world: BulletWorld, robot: int, goal: NDArray[np.float64]) -> Way:
        """From where a vehicle is; `goal` (n,)."""
        q = world.at_rest(robot, _coarse(world.q[robot][-len(goal) :], goal)[1])
        marked, moved = world.stretches(robot, q, NO_SPHERES, FREE)
        return cls(robot, q, goal, bool(marked.any()), moved)

    def spheres(self, world: BulletWorld) -> NDArray[np.float64]:
        """Centres and radii (s, 4) around all that the vehicle takes up, with twice `FREE`."""
        at, gone, furthest = [0], 0.0, 0.0
        for k, moved in enumerate(self.moved.tolist()):
            if gone > 0.0 and gone + moved > APART:
                at.append(k)
                gone = 0.0
            gone += moved
            furthest = max(furthest, gone)
        at.append(len(self.moved))
        spheres = np.concatenate([world.spheres(self.robot, self.q[k]) for k in at])
        # half of what a part goes between two of them; arcs are a little longer than their chords
        spheres[:, 3] += 0.55 * furthest + 2.0 * FREE
        return spheres


def _are_free(world: BulletWorld, ways: Sequence[Way]) -> bool:
    """Whether nothing is near to any way, other vehicles on theirs included."""
    if any(way.touches for way in ways):
        return False
    taken = [way.spheres(world) for way in ways] if len(ways) > 1 else []
    for way in ways:
        near = [
            other
            for robot, other in enumerate(taken)
            if robot != way.robot and _may_meet(taken[way.robot], other)
        ]
        if near and world.stretches(way.robot, way.q, np.concatenate(near), FREE)[0].any():
            return False
    return True


def _may_meet(a: NDArray[np.float64], b: NDArray[np.float64]) -> bool:
    """Whether boxes around two sets of spheres (s, 4) overlap."""
    lower = [(spheres[:, :3] - spheres[:, 3:]).min(axis=0) for spheres in (a, b)]
    upper = [(spheres[:, :3] + spheres[:, 3:]).max(axis=0) for spheres in (a, b)]
    return bool((lower[0] <= upper[1]).all() and (lower[1] <= upper[0]).all())


class Track:
    """One vehicle's way in time, how far along it the mount is, and what stopped it."""

    def __init__(self, way: Way, shares: NDArray[np.float64], time_step: float) -> None:
        self.q = way.q[0]
        """Where the vehicle began, its body at rest."""
        self.start, self.goal = self.q[-len(way.goal) :], way.goal
        self.target = self.start
        self.acceleration: NDArray[np.float64] | None = None
        """That of the next step (n,), if it is known."""
        self.what = ""
        self.shares: list[float] = [*shares.tolist(), 1.0]
        """Of the way, after each time step; in the last of them the mount comes to a halt."""
        before = [0.0, 0.0, *self.shares]
        self._changes = [
            c - 2.0 * b + a for a, b, c in zip(before, before[1:], self.shares, strict=False)
        ]
        self._to_goal = self.goal - self.start
        self._per_step = self._to_goal / time_step**2
        self._length = float(way.moved.sum())
        self._share = 0.0
        self._next = 0
        self._back = 0.0
        self._touches = self._returns = False

    @classmethod
    def of(cls, world: BulletWorld, way: Way, speed: float, time_step: float) -> Track:
        """All joints together, at a pace that keeps each below `speed` times its limit."""
        speeds = np.minimum(speed * world.vehicles[way.robot].anatomy.speeds, FASTEST)
        start = way.q[0, -len(way.goal) :]
        duration = float((np.abs(way.goal - start) / speeds).max()) / (1.0 - RAMP)
        n = max(1, math.ceil(duration / time_step))
        return cls(way, progress(np.arange(1, n + 1) / n), time_step)

    @property
    def arrived(self) -> bool:
        """Whether it stays: at its goal, or free of what stopped it."""
        return not self._returns if self.what else self._next == len(self.shares)

    def advance(self) -> bool:
        """One step along the way, or back if something is touched; whether the target is new."""
        if self.arrived:
            return False
        if self.what:
            self._returns = self._touches  # one step more than needed, for good measure
            self._touches = False
            self._share = max(0.0, self._share - self._back)
            self.acceleration = None
        else:
            self._share = self.shares[self._next]
            self.acceleration = self._changes[self._next] * self._per_step
            self._next += 1
        self.target = self.start + self._share * self._to_goal
        return True

    def stop(self, what: str) -> None:
        """Take note of a contact: it ends the motion."""
        if not self.what:
            self.what = what
            self._back = RETREAT / max(self._length, RETREAT)
        self._touches = self._returns = True


def progress(time: NDArray[np.float64]) -> NDArray[np.float64]:
    """Shares of the way at shares of the time: constant speed between two ramps."""
    early = np.minimum(time, 1.0 - time)
    top = 1.0 / (1.0 - RAMP)
    gone = np.where(early < RAMP, early**2 / (2.0 * RAMP), early - RAMP / 2.0) * top
    return np.where(time < 0.5, gone, 1.0 - gone)


def _undo_what_touches(world: BulletWorld, tracks: Sequence[Track]) -> None:
    """Put back, first those that touch something, in the end all: they began free."""
    for everyone in (False, True):
        world.find_contacts()
        touching = [bool(what) for _, what in world.contacts()]
        stuck = [robot for robot, track in enumerate(tracks) if track.what and touching[robot]]
        for robot in range(len(tracks)) if everyone and stuck else stuck:
            world.place(robot, tracks[robot].q)
