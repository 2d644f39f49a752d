"""Straight paths in the joint space of a mount, and whether anything is near to them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import kernel
from coopmap_env.geometry import NO_SPHERES, Spheres, join_spheres
from coopmap_env.simulation.physics.world import BulletWorld

COARSE_STEP = 0.15
"""Radians or metres of the fastest joint, between the configurations of the fast test."""
FREE_CLEARANCE = 0.1
"""Metres: more than the oscillation of its body moves a mount off its path (some 5 cm). Contacts
are checked in any case."""
SPHERE_SPACING = 0.8
"""Metres of a path, at most, between the configurations that represent it to other vehicles."""


@kernel
def coarse_path(
    start: NDArray[np.float64], goal: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Fractions (k,) of the path between joints (n,), for the fast test, and the joints there."""
    farthest = 0.0
    for i in range(len(start)):
        farthest = max(farthest, abs(goal[i] - start[i]))
    n = max(1, math.ceil(farthest / COARSE_STEP))
    fractions, part = np.empty(n + 1), 1.0 / n
    for k in range(n):
        fractions[k] = k * part
    fractions[n] = 1.0
    return fractions, interpolate(start, goal, fractions)


@kernel
def interpolate(
    start: NDArray[np.float64], goal: NDArray[np.float64], fractions: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Joints (k, n) at fractions (k,) of the path between joints (n,)."""
    joints = np.empty((len(fractions), len(start)))
    for k in range(len(fractions)):
        for i in range(len(start)):
            joints[k, i] = start[i] + fractions[k] * (goal[i] - start[i])
    return joints


@dataclass(frozen=True)
class StraightPath:
    """A straight path of one mount, and what is known about it in advance."""

    robot: int
    q: NDArray[np.float64]
    """Shape (k, m): configurations on it, each with the body at rest."""
    goal: NDArray[np.float64]
    """Shape (n,)."""
    may_collide: bool
    """Whether the mount may come within `FREE_CLEARANCE` of a solid, or touch its own vehicle."""
    travel: NDArray[np.float64]
    """Shape (k - 1,): metres that the fastest part of the mount goes in between."""

    @classmethod
    def to_goal(cls, world: BulletWorld, robot: int, goal: NDArray[np.float64]) -> StraightPath:
        """From the current configuration of a vehicle to joints (n,)."""
        start = world.q[robot][-len(goal) :]
        q = world.rest_configurations(robot, coarse_path(start, goal)[1])
        may_collide, travel = world.swept_collisions(robot, q, NO_SPHERES, FREE_CLEARANCE)
        return cls(robot, q, goal, bool(may_collide.any()), travel)

    def spheres(self, world: BulletWorld) -> Spheres:
        """Spheres around all that the vehicle occupies on it, enlarged by twice the clearance."""
        indices, travelled, furthest = [0], 0.0, 0.0
        for k, travel in enumerate(self.travel.tolist()):
            if travelled > 0.0 and travelled + travel > SPHERE_SPACING:
                indices.append(k)
                travelled = 0.0
            travelled += travel
            furthest = max(furthest, travelled)
        indices.append(len(self.travel))
        spheres = join_spheres([world.spheres(self.robot, self.q[k]) for k in indices])
        # half of what a part goes between two of them; arcs are a little longer than their chords
        return Spheres(spheres.centers, spheres.radii + (0.55 * furthest + 2.0 * FREE_CLEARANCE))


def are_paths_free(world: BulletWorld, paths: Sequence[StraightPath]) -> bool:
    """Whether nothing is near to any path, other vehicles on theirs included."""
    if any(path.may_collide for path in paths):
        return False
    occupied = [path.spheres(world) for path in paths] if len(paths) > 1 else []
    for path in paths:
        near = [
            other
            for robot, other in enumerate(occupied)
            if robot != path.robot and _bounds_overlap(occupied[path.robot], other)
        ]
        if near:
            may_collide, _ = world.swept_collisions(
                path.robot, path.q, join_spheres(near), FREE_CLEARANCE
            )
            if may_collide.any():
                return False
    return True


def _bounds_overlap(a: Spheres, b: Spheres) -> bool:
    """Whether the boxes around two sets of spheres overlap."""
    lower = [(s.centers - s.radii[:, None]).min(axis=0) for s in (a, b)]
    upper = [(s.centers + s.radii[:, None]).max(axis=0) for s in (a, b)]
    return bool((lower[0] <= upper[1]).all() and (lower[1] <= upper[0]).all())
