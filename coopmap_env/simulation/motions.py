"""How vehicles in a physics world move their mounts: set along the way, or stepped.

Both take straight motions in the space of the joints, stop a mount that touches something where it
is free, and leave each body at rest on its suspension.

Kinematic: one vehicle after the other is set to configurations along its way, so near to each
other that no part moves further than `WAYPOINT` in between, its body at its static equilibrium.
Stepped: all move at once under their motors, bodies swing on their springs, until all is quiet.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coopmap_env.simulation.bullet_world import BulletWorld

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
    """Seconds. The bodies swing at 2 to 4 Hz; springs that need less get it."""
    speed: float = 3.0
    """Of the joints, as a multiple of their limits in the URDF: what counts is where a motion
    ends, and what is faster costs less."""
    still: float = 1e-3
    """m/s and rad/s: a body that is slower than this for `STILL_STEPS` has come to rest. It is
    then within 0.1 mm and 0.01 degrees of where it will be."""
    patience: float = 5.0
    """Seconds after the end of the motion, by which all must be at rest and free."""

    def __post_init__(self) -> None:
        for name in ("time_step", "speed", "still", "patience"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"Stepping.{name} must be finite and > 0, got {value}")


STILL_STEPS = 3
REACHED = 1e-4
"""Radians or metres between a joint and its target."""
RAMP = 0.25
"""Share of a motion's time in which it speeds up, and in which it slows down."""
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
    tracks = [Track.of(world, robot, goal, stepping) for robot, goal in enumerate(goals)]
    longest = max(len(track.shares) for track in tracks)
    quiet = 0
    for _ in range(longest + math.ceil(stepping.patience / stepping.time_step)):
        for robot, track in enumerate(tracks):
            if track.advance():
                world.aim(robot, track.target)
        world.step()
        for robot, (depth, what) in enumerate(world.contacts()):
            if depth < 0.0:
                tracks[robot].stop(world, robot, what)
        settling = all(track.arrived for track in tracks)
        quiet = quiet + 1 if settling and _is_still(world, tracks, stepping.still) else 0
        if quiet == STILL_STEPS:
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
        if (swing > slow).any() or (missing > REACHED).any():
            return False
    return True


class Track:
    """One vehicle's straight way, how far along it the mount is, and what stopped it."""

    def __init__(
        self, q: NDArray[np.float64], goal: NDArray[np.float64], shares: list[float]
    ) -> None:
        self.q = q
        """Where the vehicle began."""
        self.start, self.goal = q[-len(goal) :], goal
        self.target = self.start
        self.what = ""
        self.shares = shares
        """Of the way, after each time step."""
        self._share = 0.0
        self._next = 0
        self._back = 0.0
        self._touches = self._returns = False

    @classmethod
    def of(
        cls, world: BulletWorld, robot: int, goal: NDArray[np.float64], stepping: Stepping
    ) -> Track:
        """All joints together, at a pace that keeps each below its limit."""
        q = world.q[robot]
        speeds = np.minimum(stepping.speed * world.vehicles[robot].anatomy.speeds, FASTEST)
        duration = float((np.abs(goal - q[-len(goal) :]) / speeds).max()) / (1.0 - RAMP)
        n = max(1, math.ceil(duration / stepping.time_step))
        return cls(q, goal, progress(np.arange(1, n + 1) / n).tolist())

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
        else:
            self._share = self.shares[self._next]
            self._next += 1
        self.target = self.start + self._share * (self.goal - self.start)
        return True

    def stop(self, world: BulletWorld, robot: int, what: str) -> None:
        """Take note of a contact: it ends the motion."""
        if not self.what:
            self.what = what
            self._back = RETREAT / max(_length(world, robot, self.start, self.goal), RETREAT)
        self._touches = self._returns = True


def _length(
    world: BulletWorld, robot: int, start: NDArray[np.float64], goal: NDArray[np.float64]
) -> float:
    """Metres that the fastest part of a mount goes on its straight way."""
    q = world.at_rest(robot, _coarse(start, goal)[1])
    return float(world.stretches(robot, q)[1].sum())


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
