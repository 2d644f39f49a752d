"""Belief of a field team: mounts on vehicles, moved through the known free space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.envs.belief import Belief
from coopmap_env.envs.field._joint_space import JointSpace
from coopmap_env.envs.field.reachability import MotionLimits, Reachability
from coopmap_env.envs.field.team_state import Joints, TeamState
from coopmap_env.envs.reasons import RejectedReason
from coopmap_env.geometry import Pose, Spheres
from coopmap_env.information import (
    CameraPoses,
    FieldRatingFunction,
    Ratings,
    RatingSettings,
    ReservedMask,
    ViewContext,
    joint_distance,
)
from coopmap_env.mapping import OccupancyMap
from coopmap_env.robots import PoseEstimate, Vehicle, filter_robot_points
from coopmap_env.sensing import PointCloud, RangeNoise


@dataclass(frozen=True)
class FieldBelief(Belief):
    """What a field team knows. A pose is the joints (n,) of a robot's mount."""

    team: TeamState
    """Vehicles and joints; maps of robots that are not located, which make no use of `map`."""
    estimates: tuple[PoseEstimate, ...]
    """Estimated pose and covariance of each camera."""
    rating_function: FieldRatingFunction
    """Rates camera poses with the constants of the environment."""
    limits: MotionLimits
    """What bounds the motions of the mounts."""
    reachability: Reachability
    """What the mounts can reach from these joints on the maps as they are."""
    position_bounds: tuple[float, ...] = ()
    """Three standard deviations of each camera's position by kinematics, and how far it is from
    where it would be on a suspension at rest, metres: bodies are assumed there."""
    coarse: bool = False
    """Whether views are evaluated on the map pooled to half its resolution, which is faster."""

    @property
    def vehicles(self) -> tuple[Vehicle, ...]:
        """Mounts and base poses; see `TeamState`."""
        return self.team.vehicles

    @property
    def joints(self) -> tuple[Joints, ...]:
        """Encoder readings of each mount."""
        return self.team.joints

    @property
    def joint_spaces(self) -> tuple[JointSpace, ...]:
        """Joint limits of each mount, and the grid that discretizes its configuration space."""
        return self.limits.joint_spaces

    @property
    def rating_settings(self) -> RatingSettings:
        """Constants of the environment's rating function."""
        return self.rating_function.settings

    @property
    def positions(self) -> NDArray[np.float64]:
        """Estimated camera positions, shape (n_robots, 3), metres; NaN if not located."""
        positions = np.array([estimate.pose.translation for estimate in self.estimates])
        positions[[not is_located for is_located in self.located]] = np.nan
        return positions

    @property
    def located(self) -> tuple[bool, ...]:
        """Which robots know their pose in the common frame, that of the target."""
        return self.team.located

    def planning_map(self, robot: int) -> OccupancyMap:
        """The map that a robot plans on: the team's, or its own until it is located."""
        return self.team.planning_map(robot)

    def located_teammates(self, robot: int) -> list[int]:
        """The other robots whose pose in the frame of a robot's map is known."""
        return self.team.located_teammates(robot)

    def occluder_spheres(self, robot: int) -> Spheres:
        """Spheres around a robot's located teammates."""
        return self.team.occluder_spheres(robot)

    def remove_robot_points(
        self, robot: int, cloud: PointCloud, estimate: PoseEstimate, noise: RangeNoise
    ) -> PointCloud:
        """A robot's point cloud without the points on robots whose poses are known.

        `estimate` is that of the camera when the cloud was measured.
        """
        spheres = self.robot_spheres(robot)
        return filter_robot_points(cloud, estimate.pose, *spheres, noise, estimate.covariance)

    def robot_spheres(self, robot: int) -> Spheres:
        """Spheres around the robots whose points are removed from a robot's point cloud."""
        return self.team.robot_spheres(robot, self.position_bounds)

    def infeasibility_reason(self, robot: int, q: Joints) -> str:
        """Why this pose is infeasible; empty if it is feasible."""
        contact = self.reachability.predicted_contact(robot, q)
        return "" if contact is None else str(contact)

    def rejected_reason(self, robot: int, q: Joints) -> RejectedReason:
        """The same as a code."""
        contact = self.reachability.predicted_contact(robot, q)
        if contact is None:
            return RejectedReason.NONE
        return RejectedReason(RejectedReason.MASKED + contact.kind)

    def feasible_poses(self, robot: int) -> Joints:
        """See `Reachability.feasible_poses`."""
        return self.reachability.feasible_poses(robot)

    def random_poses(self, robot: int, m: int, rng: np.random.Generator) -> Joints:
        """See `Reachability.random_poses`."""
        return self.reachability.random_poses(robot, m, rng)

    def rate(self, robot: int, poses: Joints, reserved_mask: ReservedMask | None = None) -> Ratings:
        """See `FieldRatingFunction.rate`."""
        return self.rate_with_unknown_fraction(robot, poses, reserved_mask)[0]

    def rate_with_unknown_fraction(
        self,
        robot: int,
        poses: Joints,
        reserved_mask: ReservedMask | None = None,
        cameras: CameraPoses | None = None,
    ) -> tuple[Ratings, NDArray[np.float64]]:
        """`rate` and `unknown_fraction`, from one evaluation of the views.

        `cameras` are the camera poses, if they are known already.
        """
        map_ = self.planning_map(robot)
        if cameras is None:
            cameras = self.vehicles[robot].camera_poses(poses)
        context = self.view_context(robot, reserved_mask)
        ni, unknown = self.rating_function.new_information_and_unknown(map_, cameras, context)
        rated = self.rating_function.rate_from_new_information(
            map_, cameras, self.distance(robot, poses), ni
        )
        return rated, unknown / self.rating_function.max_visible_cells

    def rate_team(self, poses: Sequence[Joints]) -> Ratings:
        """See `FieldRatingFunction.rate_team`; robots with local maps share no cells."""
        if all(self.located):
            return self._rate_together(list(range(len(poses))), poses)
        groups = [[robot for robot, is_located in enumerate(self.located) if is_located]]
        groups += [[robot] for robot, is_located in enumerate(self.located) if not is_located]
        rated = [(group, self._rate_together(group, poses)) for group in groups if group]
        columns = {part.name: np.empty(len(poses)) for part in fields(Ratings)}
        for group, ratings in rated:
            for name, column in columns.items():
                column[group] = getattr(ratings, name)
        return Ratings(**columns)

    def _rate_together(self, robots: list[int], poses: Sequence[Joints]) -> Ratings:
        """Ratings of one pose for each of some robots that plan on the same map."""
        cameras = [self.vehicles[robot].camera_poses(poses[robot]) for robot in robots]
        rotations = np.array([rotation for rotation, _ in cameras])
        translations = np.array([translation for _, translation in cameras])
        return self.rating_function.rate_team(
            self.planning_map(robots[0]),
            (rotations, translations),
            np.array([self.distance(robot, poses[robot][None])[0] for robot in robots]),
            [self.occluder_spheres(robot) for robot in robots],
        )

    def view_context(self, robot: int, reserved_mask: ReservedMask | None = None) -> ViewContext:
        """What decides about a robot's views; reserved cells mean nothing on a local map."""
        usable = reserved_mask if self.located[robot] else None
        return ViewContext(usable, self.occluder_spheres(robot), self.coarse)

    def distance(self, robot: int, poses: Joints) -> NDArray[np.float64]:
        """See `joint_distance`."""
        vehicle = self.vehicles[robot]
        joints, alpha = vehicle.chain.as_joint_values(poses), np.array(vehicle.mount.alpha)
        return joint_distance(joints, self.joints[robot], alpha)

    def motion_time(self, robot: int, poses: Joints) -> NDArray[np.float64]:
        """Of straight motions; see `Chain.motion_times`."""
        return self.vehicles[robot].chain.motion_times(self.joints[robot], poses)

    def unknown_fraction(
        self, robot: int, poses: Joints, reserved_mask: ReservedMask | None = None
    ) -> NDArray[np.float64]:
        """See `FieldRatingFunction.count_unknown_cells`."""
        return self.rate_with_unknown_fraction(robot, poses, reserved_mask)[1]

    def visible_cells(self, robot: int, pose: Joints) -> NDArray[np.int64]:
        """See `FieldRatingFunction.visible_cells`; none of the team's map if not located."""
        if not self.located[robot]:
            return np.empty(0, dtype=np.int64)
        camera = self.vehicles[robot].camera_poses(pose)
        cells = self.rating_function.visible_cells(self.map, camera, self.view_context(robot))
        return cells.astype(np.int64)

    def with_poses(self, poses: Sequence[Joints]) -> FieldBelief:
        """The same belief with other joints, and the cameras at their kinematic poses."""
        estimates = tuple(
            vehicle.camera_estimate(q) for vehicle, q in zip(self.vehicles, poses, strict=True)
        )
        bounds = [
            3.0 * estimate.position_std + vehicle.camera_deflection(q)
            for vehicle, q, estimate in zip(self.vehicles, poses, estimates, strict=True)
        ]
        team = replace(self.team, joints=tuple(poses))
        return replace(
            self,
            team=team,
            estimates=estimates,
            reachability=Reachability(self.limits, team),
            position_bounds=tuple(bounds),
            candidates=None,
        )

    def with_camera_estimate(self, robot: int, estimate: PoseEstimate) -> FieldBelief:
        """The same belief with another estimate of one camera's pose."""
        estimates = list(self.estimates)
        estimates[robot] = estimate
        return replace(self, estimates=tuple(estimates))

    def with_base_pose(
        self, robot: int, T_world_base: Pose, covariance: NDArray[np.float64] | None
    ) -> FieldBelief:
        """The same belief with a robot that is located; its local map is dropped."""
        vehicles, maps = list(self.vehicles), list(self.team.local_maps)
        vehicles[robot] = vehicles[robot].with_base_pose(T_world_base, covariance)
        maps[robot] = None
        team = replace(self.team, vehicles=tuple(vehicles), local_maps=tuple(maps))
        located = replace(self, team=team).with_poses(self.joints)
        for other, estimate in enumerate(self.estimates):
            if other != robot:
                located = located.with_camera_estimate(other, estimate)
        return located

    def with_candidates(self, candidates: Sequence[Any]) -> FieldBelief:
        """The same belief with candidates."""
        return replace(self, candidates=tuple(candidates))
