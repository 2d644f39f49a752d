"""The search of robots that are not located for the target, in all scans that they took (2.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from coopmap_env.envs.field.belief import FieldBelief
from coopmap_env.envs.field.reachability import Joints
from coopmap_env.envs.field.settings import FieldSettings
from coopmap_env.geometry import Pose, displacement_between
from coopmap_env.localization import (
    Registration,
    SearchSettings,
    TargetModel,
    View,
    in_equivalent_frame,
    register,
    resolve_symmetry,
)
from coopmap_env.mapping import VoxelGrid
from coopmap_env.robots import PoseEstimate, filter_robot_points
from coopmap_env.sensing import PointCloud, RangeNoise
from coopmap_env.simulation.scenes.field import FieldWorld

MAX_SEARCHED_SCANS = 8
"""Scans at most in which the target is searched for at once, the last ones: 40 ms each."""
MIN_HITS = 50
"""Points at least of a scan that takes part in the search."""


class RecordedScan(NamedTuple):
    """One scan as it was measured, to be fused again when more is known."""

    robot: int
    cloud: PointCloud
    """As measured, including points on robots."""
    joints: tuple[Joints, ...]
    """Encoder readings of all mounts."""
    true_camera: Pose
    """T_world_camera, for the setting "exact" only."""
    estimate: PoseEstimate
    """Camera pose in the world frame, or in the robot's own frame until it is located."""


def check_bases_in_search_range(world: FieldWorld, search: SearchSettings) -> None:
    """Raise ValueError if a vehicle stands where registration does not search."""
    low, high = world.target_triangles.min(axis=(0, 1)), world.target_triangles.max(axis=(0, 1))
    for robot, base in enumerate(world.base_poses):
        distance = float(np.linalg.norm((base.translation - 0.5 * (low + high))[:2]))
        if not search.min_distance <= distance <= search.max_distance:
            raise ValueError(
                f"robot_{robot} stands {distance:.2f} m from the middle of the target, outside of "
                f"the searched {search.min_distance:g} to {search.max_distance:g} m: set "
                "min_distance or max_distance of FieldSettings.registration.search, or use "
                "initialization='located'"
            )


def without_robots(
    belief: FieldBelief,
    robot: int,
    cloud: PointCloud,
    estimate: PoseEstimate,
    noise: RangeNoise,
) -> PointCloud:
    """A robot's point cloud without the points on robots whose poses are known."""
    spheres = belief.robot_spheres(robot)
    return filter_robot_points(cloud, estimate.pose, *spheres, noise, estimate.covariance)


class TargetSearch:
    """Registers the scans of one robot to the target model.

    Parameters
    ----------
    settings : FieldSettings
    target : TargetModel
    true_bases : sequence of Pose
        T_world_base: they select one of the frames that a symmetric target has, for the first robot
        that is located. Every choice would be right; this one makes the maps comparable with the
        true world.
    """

    def __init__(
        self, settings: FieldSettings, target: TargetModel, true_bases: Sequence[Pose]
    ) -> None:
        self._settings = settings
        self._target = target
        self._true_bases = tuple(true_bases)

    def register(
        self, belief: FieldBelief, robot: int, recorded: Sequence[RecordedScan]
    ) -> Registration | None:
        """Base pose of a robot in the frame of the target; None without new points to search.

        `recorded` are the scans of this robot so far.
        """
        if not recorded or int(recorded[-1].cloud.hit.sum()) < MIN_HITS:
            return None
        own = belief.vehicles[robot].T_world_base
        s, to_base = self._settings, own.inverse()
        usable = [record for record in recorded if record.cloud.hit.sum() >= MIN_HITS]
        views = []
        for record in usable[-MAX_SEARCHED_SCANS:]:
            past_belief, (pose, covariance) = belief.with_poses(record.joints), record.estimate
            cloud = without_robots(past_belief, robot, record.cloud, record.estimate, s.noise)
            views.append(View(cloud, PoseEstimate(to_base @ pose, covariance)))
        found = register(self._target, views, s.camera, s.noise, s.registration)
        if found.located and len(found.equivalent_poses) > 1:
            found = self._resolve_symmetry(belief, robot, found, views)
        return _reject_outside_map(belief.map.grid, found, views)

    def _resolve_symmetry(
        self, belief: FieldBelief, robot: int, found: Registration, views: list[View]
    ) -> Registration:
        """Of the poses that a symmetric target leaves, the one in the team's common frame.

        The first robot defines that frame. The others compare what they see besides the target
        with the team's map.
        """
        if any(belief.located):
            return resolve_symmetry(belief.map, found, views, self._target)
        true = self._true_bases[robot]
        nearest = min(found.equivalent_poses, key=lambda pose: _pose_distance(pose, true))
        return in_equivalent_frame(found, nearest)


def _reject_outside_map(grid: VoxelGrid, found: Registration, views: list[View]) -> Registration:
    """The registration, rejected if it would put a camera outside of the map."""
    if found.T_target_base is None:
        return found
    cameras = [found.T_target_base.transform(v.estimate.pose.translation) for v in views]
    if grid.contains(grid.index(cameras)).all():
        return found
    reason = "what could be the target would put the camera outside of the map"
    return replace(found, located=False, T_target_base=None, covariance=None, reason=reason)


def _pose_distance(one: Pose, other: Pose) -> float:
    return float(np.linalg.norm(displacement_between(one, other)))
