"""Belief of a team in the field: mounts on vehicles, reached through the known free space."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.envs.belief import Belief, ReservedMask
from coopmap_env.envs.field.joint_space import JointSpace
from coopmap_env.geometry import Pose
from coopmap_env.information import (
    FieldMutualInformation,
    FieldRatingFunction,
    Ratings,
    adjacent_to_unknown,
    entropy,
    first_visible_point,
    joint_distance,
)
from coopmap_env.mapping import OccupancyMap
from coopmap_env.robots import CollisionChecker, CollisionSettings, PoseEstimate, Vehicle, plan_path

Joints = NDArray[np.float64]
Spheres = tuple[NDArray[np.float64], NDArray[np.float64]]
N_REFINED = 30
"""Candidates that are scored at the map's own resolution after a ranking at half of it: of 300, the
best ten are among them."""
PLANNER_SEED = 1
"""Of the search for ways around: the same question gets the same answer."""
MAX_SAMPLING_ROUNDS = 20
"""Random poses are drawn this many times as many as asked for before it is settled for fewer."""
MIN_BATCH_SIZE = 16
"""Poses that are drawn at once, so that a single one is found in narrow places too."""


@dataclass(frozen=True)
class FieldBelief(Belief):
    """What a team in the field knows. A pose is the joints (n,) of a robot's mount."""

    prior = 0.02

    vehicles: tuple[Vehicle, ...]
    """Mounts and where their vehicles stand: in the world frame, or in its own one for a robot that
    has not found the target yet."""
    joints: tuple[Joints, ...]
    """What each mount's encoders say."""
    estimates: tuple[PoseEstimate, ...]
    """Where each camera is taken to be, and how well that is known."""
    rating: FieldRatingFunction
    """Rates camera poses with the constants of the environment."""
    joint_spaces: tuple[JointSpace, ...]
    """The limits of each mount, and the grid that stands for its configuration space."""
    motion: CollisionSettings
    """How far links keep from what is not known to be free."""
    local_maps: tuple[OccupancyMap | None, ...] = ()
    """Of each robot that has not found the target yet, its map in a frame of its own; `map` and
    the teammates mean nothing to it then."""
    position_bounds: tuple[float, ...] = ()
    """Three standard deviations of where each robot's camera is by its encoders, metres."""
    use_motion_planner: bool = False
    """Whether OMPL looks for a way where the straight motion is blocked."""
    coarse: bool = False
    """Whether views are taken on the map pooled to half its resolution, which is faster."""
    _collision_checkers: dict[int, CollisionChecker] = field(default_factory=dict, repr=False)
    _paths: dict[tuple[int, bytes], Joints] = field(default_factory=dict, repr=False)

    @property
    def positions(self) -> NDArray[np.float64]:
        """Where the cameras are taken to be, shape (n_robots, 3), metres.

        NaN for a robot that does not know where it is.
        """
        at = np.array([estimate.pose.translation for estimate in self.estimates])
        at[[not known for known in self.located]] = np.nan
        return at

    @property
    def located(self) -> tuple[bool, ...]:
        """Which robots know where they stand in the common frame, that of the target."""
        return tuple(own is None for own in self.local_maps) or (True,) * len(self.agents)

    def planning_map(self, robot: int) -> OccupancyMap:
        """The map that a robot plans on: the team's, or its own until it is located."""
        own = self.local_maps[robot] if self.local_maps else None
        return self.map if own is None else own

    def located_teammates(self, robot: int) -> list[int]:
        """The other robots of which a robot knows where they stand."""
        located = self.located
        if not located[robot]:
            return []
        return [other for other, known in enumerate(located) if known and other != robot]

    def occluder_spheres(self, robot: int) -> Spheres:
        """Spheres around the known teammates of a robot: centres (s, 3), radii (s,), metres."""
        return _concatenate_spheres(
            [self._vehicle_spheres[other] for other in self.located_teammates(robot)]
        )

    def robot_spheres(self, robot: int) -> Spheres:
        """Spheres around a robot and its known teammates wherever they sway, as of `bodies`.

        No link sways more than the camera, which is the farthest out.
        """
        known = sorted([robot, *self.located_teammates(robot)])
        bodies = [self._vehicle_spheres[other] for other in known]
        position_bounds = [self.position_bounds[other] for other in known]
        return _concatenate_spheres(
            [
                (at, radii + bound)
                for (at, radii), bound in zip(bodies, position_bounds, strict=True)
            ]
        )

    @cached_property
    def _vehicle_spheres(self) -> list[Spheres]:
        pairs = zip(self.vehicles, self.joints, strict=True)
        return [vehicle.spheres(q) for vehicle, q in pairs]

    def collision_checker(self, robot: int) -> CollisionChecker:
        """What the robot's mount could touch, on the map as it is now."""
        if robot not in self._collision_checkers:
            team = [self._vehicle_spheres[other] for other in self.located_teammates(robot)]
            self._collision_checkers[robot] = CollisionChecker(
                self.vehicles[robot], self.planning_map(robot), team, self.motion
            )
        return self._collision_checkers[robot]

    def infeasibility_reason(self, robot: int, q: Joints) -> str:
        """Why the robot cannot take this pose; empty if it can."""
        reason = self.collision_checker(robot).infeasibility_reason(self.joints[robot], q)
        return "" if reason and self.use_motion_planner and len(self.path(robot, q)) else reason

    def path(self, robot: int, q: Joints) -> Joints:
        """Waypoints (w, n) of a motion to a pose, without the start; none if there is no way."""
        if not self.use_motion_planner:
            return q[None]
        asked = robot, q.tobytes()  # first when the action is read, then when it is done
        if asked not in self._paths:
            path = plan_path(self.collision_checker(robot), self.joints[robot], q, PLANNER_SEED)
            self._paths[asked] = np.empty((0, len(q))) if path is None else path[1:]
        return self._paths[asked]

    def collision_free(self, robot: int, poses: Joints) -> NDArray[np.bool_]:
        """Which poses (k, n) satisfy constraint i, and ii by a straight motion of the joints."""
        return self.collision_checker(robot).are_motions_free(self.joints[robot], poses)

    def feasible_poses(self, robot: int) -> Joints:
        """The poses of the grid over the joints that satisfy constraints i and ii.

        Staying, if there is none.
        """
        grid = self.joint_spaces[robot].grid()
        feasible = grid[self.collision_free(robot, grid)]
        return feasible if len(feasible) else self._current_pose(robot)

    def random_poses(self, robot: int, m: int, rng: np.random.Generator) -> Joints:
        """Up to m feasible poses, uniformly at random; staying where nothing else is found."""
        space, missing = self.joint_spaces[robot], m
        found = [np.empty((0, space.n))]
        for _ in range(MAX_SAMPLING_ROUNDS):
            poses = space.sample(max(m, MIN_BATCH_SIZE), rng)
            while missing and len(poses):  # no more are asked about than may be needed
                asked, poses = poses[:missing], poses[missing:]
                found.append(asked[self.collision_free(robot, asked)])
                missing -= len(found[-1])
            if not missing:
                break
        poses = np.concatenate(found)
        return poses if len(poses) else self._current_pose(robot)

    def rate(self, robot: int, poses: Joints, reserved_mask: ReservedMask = None) -> Ratings:
        """See `FieldRatingFunction.rate`."""
        return self.rate_with_unknown_fraction(robot, poses, reserved_mask)[0]

    def rate_with_unknown_fraction(
        self, robot: int, poses: Joints, reserved_mask: ReservedMask = None
    ) -> tuple[Ratings, NDArray[np.float64]]:
        """`rate` and `unknown_fraction`, from one look at the map."""
        rotations, translations = self.vehicles[robot].camera_poses(poses)
        map_ = self.planning_map(robot)
        ni, unknown = self.rating.information_and_unknown(
            map_, rotations, translations, self._reserved_mask(robot, reserved_mask), self.occluder_spheres(robot),
            self.coarse,
        )  # fmt: skip
        rated = self.rating.rate_from_information(
            map_, translations, self.distance(robot, poses), ni
        )
        return rated, unknown / self.rating.max_visible_cells

    def rate_team(self, poses: Sequence[Joints]) -> Ratings:
        """See `FieldRatingFunction.rate_team`; robots with a map of their own share nothing."""
        if all(self.located):
            return self._rate_together(list(range(len(poses))), poses)
        groups = [[robot for robot, known in enumerate(self.located) if known]]
        groups += [[robot] for robot, known in enumerate(self.located) if not known]
        rated = [(group, self._rate_together(group, poses)) for group in groups if group]
        columns = {part.name: np.empty(len(poses)) for part in fields(Ratings)}
        for group, ratings in rated:
            for name, column in columns.items():
                column[group] = getattr(ratings, name)
        return Ratings(**columns)

    def _rate_together(self, robots: list[int], poses: Sequence[Joints]) -> Ratings:
        """Ratings of one pose for each of some robots that plan on the same map."""
        cameras = [self.vehicles[robot].camera_poses(poses[robot]) for robot in robots]
        return self.rating.rate_team(
            self.planning_map(robots[0]),
            np.array([rotation for rotation, _ in cameras]),
            np.array([translation for _, translation in cameras]),
            np.array([self.distance(robot, poses[robot][None])[0] for robot in robots]),
            occluder_spheres=[self.occluder_spheres(robot) for robot in robots],
        )

    def _reserved_mask(self, robot: int, reserved_mask: ReservedMask) -> ReservedMask:
        """What teammates are about to see means nothing on a map of one's own."""
        return reserved_mask if self.located[robot] else None

    def distance(self, robot: int, poses: Joints) -> NDArray[np.float64]:
        """See `joint_distance`."""
        alpha = np.array(self.vehicles[robot].mount.alpha)
        return joint_distance(poses, self.joints[robot], alpha)

    def unknown_fraction(
        self, robot: int, poses: Joints, reserved_mask: ReservedMask = None
    ) -> NDArray[np.float64]:
        """See `FieldRatingFunction.count_unknown_cells`."""
        return self.rate_with_unknown_fraction(robot, poses, reserved_mask)[1]

    def information_fraction(
        self, robot: int, poses: Joints, prior: float, reserved_mask: ReservedMask = None
    ) -> NDArray[np.float64]:
        """See `FieldMutualInformation`; a cell at the clamp cannot become more certain."""
        map_ = self.planning_map(robot)
        beams = _mutual_information(self.rating, prior, map_.log_odds_range.max_probability)
        rotations, translations = self.vehicles[robot].camera_poses(poses)
        information = beams.mutual_information(
            map_, rotations, translations, self._reserved_mask(robot, reserved_mask), self.occluder_spheres(robot),
            self.coarse,
        )  # fmt: skip
        return information / (self.rating.max_visible_cells * entropy([prior, 1.0 - prior]))

    def prescreen(
        self, poses: Joints, score: Callable[[Any, Joints], NDArray[np.float64]]
    ) -> Joints:
        """The best `N_REFINED` poses by their score on the pooled map."""
        if len(poses) <= N_REFINED:
            return poses
        coarse_belief = replace(self, coarse=True)
        return poses[np.argsort(-score(coarse_belief, poses), kind="stable")[:N_REFINED]]

    def visible_cells(self, robot: int, pose: Joints) -> NDArray[np.int64]:
        """See `FieldRatingFunction.visible_cells`; none of the team's map, if it is not located."""
        if not self.located[robot]:
            return np.empty(0, dtype=np.int64)
        rotation, translation = self.vehicles[robot].camera_poses(pose)
        cells = self.rating.visible_cells(
            self.map, rotation, translation, self.occluder_spheres(robot)
        )
        return cells.astype(np.int64)

    def raster_offset(self, robot: int, poses: Joints) -> NDArray[np.int64]:
        """Counting through the joints, the last one fastest; parts as of `JointSpace.grid`."""
        space = self.joint_spaces[robot]
        here = space.grid_index(self.joints[robot])
        return (space.grid_index(poses) - here - 1) % space.grid_steps**space.n

    def nearest_frontier_mask(
        self, robot: int, poses: Joints, shows_unknown: NDArray[np.bool_]
    ) -> NDArray[np.bool_]:
        """Poses that look at the frontier voxel (free, beside unknown ones) nearest to the camera.

        Of the frontier voxels that any of the poses sees.
        """
        map_ = self.planning_map(robot)
        known_free = map_.sampled_mask.view(np.bool_) & (map_.log_odds_fixed < 0)
        (cells,) = np.nonzero(adjacent_to_unknown(map_) & known_free)
        grid = map_.grid
        centers = grid.center(np.stack(np.unravel_index(cells, grid.shape), axis=-1))
        distances = np.linalg.norm(centers - self.estimates[robot].pose.translation, axis=1)
        rotations, translations = self.vehicles[robot].camera_poses(poses[shows_unknown])
        _, sees_point = first_visible_point(
            map_, centers[np.argsort(distances, kind="stable")], rotations, translations,
            self.rating.fine.frustum,
        )  # fmt: skip
        there = np.zeros(len(poses), dtype=np.bool_)
        there[shows_unknown] = sees_point
        return there

    def with_poses(self, poses: Sequence[Joints]) -> FieldBelief:
        """The same belief with the mounts elsewhere, the cameras where the encoders say."""
        estimates = tuple(
            vehicle.camera_estimate(q) for vehicle, q in zip(self.vehicles, poses, strict=True)
        )
        variances = [float(np.trace(covariance[:3, :3])) for _, covariance in estimates]
        return replace(
            self,
            joints=tuple(poses),
            estimates=estimates,
            position_bounds=tuple(3.0 * math.sqrt(variance) for variance in variances),
            candidates=None,
            _collision_checkers={},
            _paths={},
        )

    def with_camera_estimate(self, robot: int, estimate: PoseEstimate) -> FieldBelief:
        """The same belief with a better estimate of one camera's pose."""
        estimates = list(self.estimates)
        estimates[robot] = estimate
        return replace(self, estimates=tuple(estimates))

    def with_base_pose(
        self, robot: int, T_world_base: Pose, covariance: NDArray[np.float64] | None
    ) -> FieldBelief:
        """The same belief with a robot that knows where it stands; its own map is given up."""
        vehicles, maps = list(self.vehicles), list(self.local_maps)
        vehicles[robot] = vehicles[robot].with_base_pose(T_world_base, covariance)
        maps[robot] = None
        estimates = self.estimates
        known = replace(self, vehicles=tuple(vehicles), local_maps=tuple(maps)).with_poses(
            self.joints
        )
        for other, estimate in enumerate(estimates):
            if other != robot:
                known = known.with_camera_estimate(other, estimate)
        return known

    def with_candidates(self, candidates: Sequence[Any]) -> FieldBelief:
        """The same belief with candidates on offer."""
        return replace(self, candidates=tuple(candidates))

    def _current_pose(self, robot: int) -> Joints:
        """The pose as it is, as an action can say it."""
        space = self.joint_spaces[robot]
        return space.denormalize(space.normalize(self.joints[robot]))[None]


def _concatenate_spheres(bodies: Sequence[Spheres]) -> Spheres:
    if not bodies:
        return np.empty((0, 3)), np.empty(0)
    return (
        np.concatenate([centers for centers, _ in bodies]),
        np.concatenate([radii for _, radii in bodies]),
    )


@lru_cache(maxsize=4)
def _mutual_information(
    rating: FieldRatingFunction, prior: float, known: float
) -> FieldMutualInformation:
    return FieldMutualInformation(rating, prior, known)
