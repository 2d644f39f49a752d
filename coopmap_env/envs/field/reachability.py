"""Which poses the mounts of a team can reach without a collision, and by which paths."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.envs.field._joint_space import JointSpace
from coopmap_env.envs.field.team_state import Joints, TeamState
from coopmap_env.robots import CollisionChecker, CollisionSettings, PredictedContact, plan_path

PLANNER_SEED = 1
"""Seed of the motion planner: the same query gets the same path."""
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
    """Poses that the mounts of a team can reach from where they are, and the paths that lead there.

    Collision checkers and paths are kept once they are made: they hold for one state of the maps.
    """

    def __init__(self, limits: MotionLimits, team: TeamState) -> None:
        self._limits = limits
        self._team = team
        self._checkers: dict[int, CollisionChecker] = {}
        self._paths: dict[tuple[int, bytes], Joints] = {}

    def collision_checker(self, robot: int) -> CollisionChecker:
        """Checker of the robot's mount on its map as it is now."""
        if robot not in self._checkers:
            self._checkers[robot] = CollisionChecker(
                self._team.vehicles[robot],
                self._team.planning_map(robot),
                self._team.teammate_spheres(robot),
                self._limits.collision,
            )
        return self._checkers[robot]

    def predicted_contact(self, robot: int, q: Joints) -> PredictedContact | None:
        """What keeps the robot from this pose; None if it is feasible."""
        start = self._team.joints[robot]
        contact = self.collision_checker(robot).first_contact(start, q, goal_first=True)
        planner_helps = contact and self._limits.use_motion_planner and len(self.path(robot, q))
        return None if planner_helps else contact

    def path(self, robot: int, q: Joints) -> Joints:
        """Waypoints (w, n) of a motion to a pose, without the start; none if there is no path."""
        if not self._limits.use_motion_planner:
            return q[None]
        query = robot, q.tobytes()  # asked when the action is decoded, and when it is executed
        if query not in self._paths:
            checker, start = self.collision_checker(robot), self._team.joints[robot]
            path = plan_path(checker, start, q, PLANNER_SEED)
            self._paths[query] = np.empty((0, len(q))) if path is None else path[1:]
        return self._paths[query]

    def collision_free(
        self, robot: int, poses: Joints, n_wanted: int | None = None
    ) -> NDArray[np.bool_]:
        """Which poses (k, n) are reached without a collision by a straight motion of the joints.

        With `n_wanted` only the first so many of them.
        """
        checker, start = self.collision_checker(robot), self._team.joints[robot]
        return checker.are_motions_free(start, poses, n_wanted)

    def feasible_poses(self, robot: int) -> Joints:
        """Poses (k, n) of the joint grid that are reached without a collision.

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
            found.append(poses[self.collision_free(robot, poses, missing)])
            missing -= len(found[-1])
            if not missing:
                break
        poses = np.concatenate(found)
        return poses if len(poses) else self._current_pose(robot)

    def _current_pose(self, robot: int) -> Joints:
        """The current pose (1, n), rounded as an action encodes it."""
        space = self._limits.joint_spaces[robot]
        return space.denormalize(space.normalize(self._team.joints[robot]))[None]
