"""What a team knows of where it is, and how it comes to know more (2.2, 2.5).

A robot that has not found the target maps in a frame of its own: its base stands in the middle of
a grid as large as the world's. When it is located, all of its looks are placed anew, in the frame
of the target, and the team's map is made again from the looks of all that are located: measurements
are shared, not posteriors, so nothing is counted twice, and what is known by then of teammates is
kept out of every one of them.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.envs.field.belief import FieldBelief
from coopmap_env.envs.field.settings import FieldSettings
from coopmap_env.envs.field.starts import initial_free_voxels
from coopmap_env.geometry import Pose, displacement_between
from coopmap_env.localization import (
    PoseCorrection,
    PoseCorrector,
    Registration,
    TargetModel,
    View,
    in_equivalent_frame,
    register,
    resolve_symmetry,
)
from coopmap_env.localization.registration.search import SearchSettings
from coopmap_env.mapping import OccupancyMap, VoxelGrid
from coopmap_env.robots import PoseEstimate, filter_robot_points
from coopmap_env.sensing import PointCloud, Scan, transform_cloud
from coopmap_env.simulation.scenes.field import FieldWorld

Joints = NDArray[np.float64]

ZERO_COVARIANCE = np.zeros((6, 6))
BASE_COVARIANCE_INFLATION = 2.0
"""Times the covariance with which registration has found a base: what motion correction begins
with. The looks that found it are corrected by the same pixels, which tell less a second time."""
MAX_SEARCHED_SCANS = 8
"""Looks at most that are searched for the target at once, the last ones: 40 ms each."""
MIN_HITS = 50
"""Points of a look that is searched at all."""


class RecordedScan(NamedTuple):
    """One look as it was made, to be fused again when more is known."""

    robot: int
    cloud: PointCloud
    """As measured, with robots in it."""
    joints: tuple[Joints, ...]
    """What the encoders of all mounts said."""
    true_camera: Pose
    """T_world_camera, for the setting "exact" only."""
    estimate: PoseEstimate
    """In the world frame, or in the robot's own one until it is located."""


class LocalizedScan(NamedTuple):
    """A look in the frame in which its robot maps."""

    estimate: PoseEstimate
    scan: Scan
    correction: PoseCorrection | None
    """None if no fiducials were asked."""


def local_base_pose(grid: VoxelGrid) -> Pose:
    """Where a robot puts itself before it is located: on the ground, in the middle of a grid."""
    low = np.array(grid.origin)
    middle = low + 0.5 * np.array(grid.shape) * grid.resolution
    return Pose(np.array([*middle[:2], 0.0]), np.eye(3))


def check_bases_in_search_range(world: FieldWorld, search: SearchSettings) -> None:
    """Raise ValueError if a vehicle stands where registration does not look for it."""
    low, high = world.target_triangles.min(axis=(0, 1)), world.target_triangles.max(axis=(0, 1))
    for robot, base in enumerate(world.base_poses):
        distance = float(np.linalg.norm((base.translation - 0.5 * (low + high))[:2]))
        if not search.min_distance <= distance <= search.max_distance:
            raise ValueError(
                f"robot_{robot} stands {distance:.2f} m from the middle of the target, and is looked "
                f"for {search.min_distance:g} to {search.max_distance:g} m from it: set min_distance or max_distance "
                "of FieldSettings.registration.search, or take initialization='located'"
            )


class TeamLocalizer:
    """Where the cameras and bases of a team are taken to be; one object for each episode.

    Parameters
    ----------
    settings : FieldSettings
    target : ndarray, shape (m, 3, 3)
        Triangles of the target in the world frame.
    true_bases : sequence of Pose
        T_world_base: for the setting "exact", and to name one of the frames that a symmetric
        target has.
    """

    def __init__(
        self,
        settings: FieldSettings,
        motion_correction: str,
        target: NDArray[np.float64],
        belief: FieldBelief,
        true_bases: Sequence[Pose],
    ) -> None:
        self._settings = settings
        self._motion_correction = motion_correction
        self._true_bases = tuple(true_bases)
        self._triangles = target
        self._corrector = (
            PoseCorrector(
                belief.vehicles, settings.camera, settings.noise, self._target,
                settings.correction, settings.fiducials, settings.tracking,
            )
            if motion_correction == "fiducials"
            else None
        )  # fmt: skip
        self._recorded_scans: list[RecordedScan] = []
        self.corrections: list[PoseCorrection | None] = [None] * len(belief.agents)
        """Of each robot's last look, if fiducials were asked."""
        self._last_scans: dict[int, Scan] = {}
        self.correction_times = [0.0] * len(belief.agents)
        """Seconds that these took; they differ from run to run."""
        self.registrations: list[Registration | None] = [None] * len(belief.agents)
        """The last attempt of each robot."""
        self.registration_times: list[float] = []
        """Seconds that those of the last step took."""

    @cached_property
    def _target(self) -> TargetModel:
        """The known target, made ready where it is asked for: not if poses are known anyway."""
        return _target_model(self._triangles.tobytes())

    def localize_scan(
        self, belief: FieldBelief, robot: int, cloud: PointCloud, true_camera: Pose
    ) -> tuple[PoseEstimate, Scan]:
        """Where the camera is taken to be, and what it measured, placed by that.

        In the world frame, or in that of the robot's own map.
        """
        localized = self._localize(belief, robot, cloud, true_camera)
        self.corrections[robot] = localized.correction
        if not all(belief.located):
            self._recorded_scans.append(
                RecordedScan(robot, cloud, belief.joints, true_camera, localized.estimate)
            )
        return localized.estimate, localized.scan

    def search_target(self, belief: FieldBelief) -> FieldBelief:
        """Let each robot that is not located look for the target in all that it has seen.

        Those that find it are moved into the team's map.
        """
        self.registration_times = []
        for robot, known in enumerate(belief.located):
            if not known and self._has_new_hits(robot):
                start_time = time.perf_counter()
                found = self._register(belief, robot)
                self.registration_times.append(time.perf_counter() - start_time)
                self.registrations[robot] = found
                if found.located and found.T_target_base is not None:
                    belief = self._merge_into_team(belief, robot, found)
        if all(belief.located):
            self._recorded_scans = []
        return belief

    def _localize(
        self, belief: FieldBelief, robot: int, cloud: PointCloud, true_camera: Pose
    ) -> LocalizedScan:
        """A look, placed by the setting, without what is known to be robots."""
        estimate, corrected = belief.estimates[robot], None
        if self._motion_correction == "exact":
            pose = true_camera
            if not belief.located[robot]:
                own = belief.vehicles[robot].T_world_base
                pose = own @ self._true_bases[robot].inverse() @ true_camera
            estimate = PoseEstimate(pose, ZERO_COVARIANCE)
        filtered = self._filter_robots(belief, robot, cloud, estimate)
        if self._corrector is not None and belief.located[robot]:
            start_time = time.perf_counter()
            corrected = self._corrector.correct(robot, belief.joints[robot], filtered, belief.map)
            self.correction_times[robot] = time.perf_counter() - start_time
            estimate = corrected.estimate
        scan = transform_cloud(filtered, estimate.pose, self._settings.noise, estimate.covariance)
        return LocalizedScan(estimate, scan, corrected)

    def _filter_robots(
        self, belief: FieldBelief, robot: int, cloud: PointCloud, estimate: PoseEstimate
    ) -> PointCloud:
        return filter_robot_points(
            cloud, estimate.pose, *belief.robot_spheres(robot), self._settings.noise,
            estimate.covariance,
        )  # fmt: skip

    def last_scan(self, robot: int) -> Scan:
        """The last look of a robot that was just located, placed in the team's frame."""
        return self._last_scans[robot]

    def failure_reason(self, robot: int) -> str:
        """Why a robot has not been located yet."""
        last = self.registrations[robot]
        return "too little was in view so far" if last is None else last.reason

    def _has_new_hits(self, robot: int) -> bool:
        """Whether the robot's last look can have told anything new of the target."""
        own = [record for record in self._recorded_scans if record.robot == robot]
        return bool(own) and int(own[-1].cloud.hit.sum()) >= MIN_HITS

    def _register(self, belief: FieldBelief, robot: int) -> Registration:
        own = belief.vehicles[robot].T_world_base
        s, to_base = self._settings, own.inverse()
        records = [
            record
            for record in self._recorded_scans
            if record.robot == robot and record.cloud.hit.sum() >= MIN_HITS
        ]
        views = []
        for record in records[-MAX_SEARCHED_SCANS:]:
            filtered = self._filter_robots(
                belief.with_poses(record.joints), robot, record.cloud, record.estimate
            )
            pose, covariance = record.estimate
            views.append(View(filtered, PoseEstimate(to_base @ pose, covariance)))
        found = register(self._target, views, s.camera, s.noise, s.registration)
        if found.located and len(found.equivalent_poses) > 1:
            found = self._resolve_symmetry(belief, robot, found, views)
        return self._reject_outside_map(belief.map.grid, found, views)

    @staticmethod
    def _reject_outside_map(
        grid: VoxelGrid, found: Registration, views: list[View]
    ) -> Registration:
        """The registration, refused if it would put a camera outside of the map."""
        if found.T_target_base is None:
            return found
        cameras = [found.T_target_base.transform(v.estimate.pose.translation) for v in views]
        if grid.contains(grid.index(cameras)).all():
            return found
        reason = "what could be the target would put the camera outside of the map"
        return replace(found, located=False, T_target_base=None, covariance=None, reason=reason)

    def _resolve_symmetry(
        self, belief: FieldBelief, robot: int, found: Registration, views: list[View]
    ) -> Registration:
        """Of the poses that a symmetric target leaves, the one in the team's common frame.

        The first robot is right with each of them, so the frame takes the name that the truth has
        for it. The others go by what they see of the team's map besides the target.
        """
        if not any(belief.located):
            true = self._true_bases[robot]
            return in_equivalent_frame(
                found, min(found.equivalent_poses, key=lambda T: _pose_distance(T, true))
            )
        return resolve_symmetry(belief.map, found, views, self._target)

    def _merge_into_team(self, belief: FieldBelief, robot: int, found: Registration) -> FieldBelief:
        """Move a robot and its looks into the team's frame; make the team's map again."""
        assert found.T_target_base is not None
        assert found.covariance is not None
        belief = belief.with_base_pose(robot, found.T_target_base, found.covariance)
        if self._corrector is not None:
            base_estimate = PoseEstimate(
                found.T_target_base, BASE_COVARIANCE_INFLATION * found.covariance
            )
            self._corrector.set_base(robot, base_estimate)
        own = [k for k, record in enumerate(self._recorded_scans) if record.robot == robot]
        # what sees the target best comes first: later looks are predicted by it
        for k in sorted(
            own, key=lambda k: -self._count_target_points(belief, self._recorded_scans[k])
        ):
            record, past_belief = (
                self._recorded_scans[k],
                belief.with_poses(self._recorded_scans[k].joints),
            )
            localized = self._localize(past_belief, robot, record.cloud, record.true_camera)
            self._recorded_scans[k] = record._replace(estimate=localized.estimate)
            if k == own[-1]:
                self.corrections[robot] = localized.correction
                self._last_scans[robot] = localized.scan
            belief.map.integrate(localized.scan)  # for the looks that follow to find fiducials in
        self._rebuild_team_map(belief)
        return belief.with_camera_estimate(robot, self._recorded_scans[own[-1]].estimate)

    def _count_target_points(self, belief: FieldBelief, record: RecordedScan) -> int:
        """Points of a look that lie about the target, by the mount's kinematics."""
        pose = belief.vehicles[record.robot].camera_pose(record.joints[record.robot])
        points = pose.transform(record.cloud.points[record.cloud.hit])
        low, high = self._target.bounds
        return int(((points > low) & (points < high)).all(axis=1).sum())

    def _rebuild_team_map(self, belief: FieldBelief) -> None:
        """Make the team's map from the looks of all robots that are located."""
        located = belief.located
        bases = [v.T_world_base for v, known in zip(belief.vehicles, located, strict=True) if known]
        belief.map.clear()
        belief.map.mark_free(
            initial_free_voxels(belief.map.grid, bases, self._settings.initial_free_radius)
        )
        for record in self._recorded_scans:
            if located[record.robot]:
                past_belief, (pose, covariance) = belief.with_poses(record.joints), record.estimate
                filtered = self._filter_robots(
                    past_belief, record.robot, record.cloud, record.estimate
                )
                belief.map.integrate(
                    transform_cloud(filtered, pose, self._settings.noise, covariance)
                )


@lru_cache(maxsize=8)
def _target_model(target: bytes) -> TargetModel:
    """The model of a target's triangles: what is prepared of it serves in every world."""
    return TargetModel(np.frombuffer(target).reshape(-1, 3, 3))


def _pose_distance(one: Pose, other: Pose) -> float:
    return float(np.linalg.norm(displacement_between(one, other)))


def reset_local_maps(maps: Sequence[OccupancyMap], initial_free_radius: float) -> None:
    """Clear the maps of robots in frames of their own, but for the room where each was parked."""
    for map_ in maps:
        map_.clear()
        map_.mark_free(
            initial_free_voxels(map_.grid, [local_base_pose(map_.grid)], initial_free_radius)
        )
