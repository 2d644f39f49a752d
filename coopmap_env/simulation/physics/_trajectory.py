"""A path in time: how far along it a mount is, step by step, and what stopped it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from coopmap_env.simulation.physics._path import StraightPath
from coopmap_env.simulation.physics.world import BulletWorld

RAMP_FRACTION = 0.25
"""Fraction of a motion's time for which it accelerates, and for which it decelerates."""
RETREAT_STEP = 0.01
"""Metres by which a mount that touches something goes back in each step."""
MAX_JOINT_SPEED = 3.0
"""rad/s or m/s: no joint goes faster, whatever its limit."""


class TrajectoryTracker:
    """One vehicle's trajectory, how far along it the mount is, and what stopped it."""

    def __init__(
        self, path: StraightPath, fractions: NDArray[np.float64], time_step: float
    ) -> None:
        self.q = path.q[0]
        """Initial configuration, the body at rest."""
        self.start, self.goal = self.q[-len(path.goal) :], path.goal
        self.target = self.start
        self.acceleration: NDArray[np.float64] | None = None
        """That of the next step (n,), if it is known."""
        self.obstacle = ""
        self.fractions: list[float] = [*fractions.tolist(), 1.0]
        """Fractions of the path after each time step; in the last of them the mount comes to a
        halt."""
        before = [0.0, 0.0, *self.fractions]
        self._second_differences = [
            c - 2.0 * b + a for a, b, c in zip(before, before[1:], self.fractions, strict=False)
        ]
        self._to_goal = self.goal - self.start
        self._to_goal_per_step_squared = self._to_goal / time_step**2
        self._length = float(path.travel.sum())
        self._fraction = 0.0
        self._next_step = 0
        self._retreat_fraction = 0.0
        self._in_contact = self._retreating = False

    @classmethod
    def along(
        cls, world: BulletWorld, path: StraightPath, speed_factor: float, time_step: float
    ) -> TrajectoryTracker:
        """Move all joints together, each at most at `speed_factor` times its limit."""
        joint_map = world.vehicles[path.robot].joint_map
        speeds = np.minimum(speed_factor * joint_map.speed_limits, MAX_JOINT_SPEED)
        start = path.q[0, -len(path.goal) :]
        duration = float((np.abs(path.goal - start) / speeds).max()) / (1.0 - RAMP_FRACTION)
        n = max(1, math.ceil(duration / time_step))
        return cls(path, trapezoidal_profile(np.arange(1, n + 1) / n), time_step)

    @property
    def is_done(self) -> bool:
        """Whether it stays: at its goal, or free of what stopped it."""
        return not self._retreating if self.obstacle else self._next_step == len(self.fractions)

    def step(self) -> bool:
        """One step along the path, or back after a contact; whether the target is new."""
        if self.is_done:
            return False
        if self.obstacle:
            self._retreating = self._in_contact  # one step more than needed, to be safe
            self._in_contact = False
            self._fraction = max(0.0, self._fraction - self._retreat_fraction)
            self.acceleration = None
        else:
            self._fraction = self.fractions[self._next_step]
            self.acceleration = (
                self._second_differences[self._next_step] * self._to_goal_per_step_squared
            )
            self._next_step += 1
        self.target = self.start + self._fraction * self._to_goal
        return True

    def record_contact(self, obstacle: str) -> None:
        """End the motion by a contact."""
        if not self.obstacle:
            self.obstacle = obstacle
            self._retreat_fraction = RETREAT_STEP / max(self._length, RETREAT_STEP)
        self._in_contact = self._retreating = True


def trapezoidal_profile(time: NDArray[np.float64]) -> NDArray[np.float64]:
    """Fractions of the path at fractions of the time: constant speed between two ramps."""
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
