"""Where the robots of a team are, and which poses their mounts can reach without a collision."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.envs.field.joint_space import JointSpace
from coopmap_env.mapping import OccupancyMap
from coopmap_env.robots import CollisionChecker, CollisionSettings, Vehicle, plan_path

Joints = NDArray[np.float64]
Spheres = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Centres (s, 3) and radii (s,), metres."""
PLANNER_SEED = 1
"""Of the motion planner: the same query gets the same path."""
MAX_SAMPLING_ROUNDS = 20
"""Batches of random poses at most, before fewer feasible poses than requested are returned."""
MIN_BATCH_SIZE = 16
"""Poses in a batch at least, so that a single one is found in narrow places too."""


class MotionLimits(NamedTuple):
    """What bounds the motions of a team's mounts during an episode."""

    joint_spaces: tuple[JointSpace, ...]
    """Joint limits of each mount, and the grid that discretizes its configuration space."""
    collision: CollisionSettings
    """How far links keep from what is not known to be free."""
    use_motion_planner: bool
    """Whether OMPL plans a path where the straight motion is blocked."""


class Reachability:
    """Bodies of a team at given joints, and the poses that its mounts can reach from there.

    Collision checkers and paths are kept once they are made: they hold for one state of the maps.

    Parameters
    ----------
    limits : MotionLimits
    vehicles : sequence of Vehicle
    joints : sequence of ndarray (n,)
        Encoder readings of each mount.
    map_ : OccupancyMap
        The team's map.
    local_maps : sequence of OccupancyMap or None
        Of each robot that is not located, its own map; empty if all robots are located.
    """

    def __init__(
        self,
        limits: MotionLimits,
        vehicles: Sequence[Vehicle],
        joints: Sequence[Joints],
        map_: OccupancyMap,
        local_maps: Sequence[OccupancyMap | None],
    ) -> None:
        self._limits = limits
        self._vehicles = vehicles
        self._joints = joints
        self._maps = [map_ if own is None else own for own in local_maps or [None] * len(joints)]
        self.located = tuple(own is None for own in local_maps) or (True,) * len(joints)
        """Which robots know their pose in the common frame, that of the target."""
        self._checkers: dict[int, CollisionChecker] = {}
        self._paths: dict[tuple[int, bytes], Joints] = {}

    def planning_map(self, robot: int) -> OccupancyMap:
        """The map that a robot plans on: the team's, or its own until it is located."""
        return self._maps[robot]

    def located_teammates(self, robot: int) -> list[int]:
        """The other robots whose pose in the frame of a robot's map is known."""
        if not self.located[robot]:
            return []
        return [other for other, known in enumerate(self.located) if known and other != robot]

    @cached_property
    def _vehicle_spheres(self) -> list[Spheres]:
        pairs = zip(self._vehicles, self._joints, strict=True)
        return [vehicle.spheres(q) for vehicle, q in pairs]

    def occluder_spheres(self, robot: int) -> Spheres:
        """Spheres around a robot's located teammates."""
        return _concatenate_spheres(
            [self._vehicle_spheres[other] for other in self.located_teammates(robot)]
        )

    def robot_spheres(self, robot: int, position_bounds: Sequence[float]) -> Spheres:
        """Spheres around a robot and its located teammates, each inflated by its position bound.

        No link deviates further than the camera, which is the farthest out.
        """
        known = sorted([robot, *self.located_teammates(robot)])
        return _concatenate_spheres(
            [
                (centers, radii + position_bounds[other])
                for other in known
                for centers, radii in [self._vehicle_spheres[other]]
            ]
        )

    def collision_checker(self, robot: int) -> CollisionChecker:
        """Checker of the robot's mount on its map as it is now."""
        if robot not in self._checkers:
            team = [self._vehicle_spheres[other] for other in self.located_teammates(robot)]
            self._checkers[robot] = CollisionChecker(
                self._vehicles[robot], self._maps[robot], team, self._limits.collision
            )
        return self._checkers[robot]

    def infeasibility_reason(self, robot: int, q: Joints) -> str:
        """Why this pose is infeasible; empty if it is feasible."""
        reason = self.collision_checker(robot).infeasibility_reason(self._joints[robot], q)
        planner_helps = reason and self._limits.use_motion_planner and len(self.path(robot, q))
        return "" if planner_helps else reason

    def path(self, robot: int, q: Joints) -> Joints:
        """Waypoints (w, n) of a motion to a pose, without the start; none if there is no path."""
        if not self._limits.use_motion_planner:
            return q[None]
        query = robot, q.tobytes()  # asked when the action is decoded, and when it is executed
        if query not in self._paths:
            checker, start = self.collision_checker(robot), self._joints[robot]
            path = plan_path(checker, start, q, PLANNER_SEED)
            self._paths[query] = np.empty((0, len(q))) if path is None else path[1:]
        return self._paths[query]

    def collision_free(self, robot: int, poses: Joints) -> NDArray[np.bool_]:
        """Which poses (k, n) satisfy constraint i, and ii by a straight motion of the joints."""
        return self.collision_checker(robot).are_motions_free(self._joints[robot], poses)

    def feasible_poses(self, robot: int) -> Joints:
        """Poses (k, n) of the joint grid that satisfy constraints i and ii.

        The current pose, if there is none.
        """
        grid = self._limits.joint_spaces[robot].grid()
        feasible = grid[self.collision_free(robot, grid)]
        return feasible if len(feasible) else self._current_pose(robot)

    def random_poses(self, robot: int, m: int, rng: np.random.Generator) -> Joints:
        """Up to m feasible poses, uniformly at random; the current pose if none is found."""
        space, missing = self._limits.joint_spaces[robot], m
        found = [np.empty((0, space.n))]
        for _ in range(MAX_SAMPLING_ROUNDS):
            poses = space.sample(max(m, MIN_BATCH_SIZE), rng)
            while missing and len(poses):  # no more are checked than may be needed
                batch, poses = poses[:missing], poses[missing:]
                found.append(batch[self.collision_free(robot, batch)])
                missing -= len(found[-1])
            if not missing:
                break
        poses = np.concatenate(found)
        return poses if len(poses) else self._current_pose(robot)

    def _current_pose(self, robot: int) -> Joints:
        """The current pose (1, n), rounded as an action encodes it."""
        space = self._limits.joint_spaces[robot]
        return space.denormalize(space.normalize(self._joints[robot]))[None]


def _concatenate_spheres(spheres: Sequence[Spheres]) -> Spheres:
    if not spheres:
        return np.empty((0, 3)), np.empty(0)
    return (
        np.concatenate([centers for centers, _ in spheres]),
        np.concatenate([radii for _, radii in spheres]),
    )
