"""How a team estimates the poses of its cameras and bases (Sections 2.2 and 2.5).

A robot that has not found the target maps in a frame of its own: its base stands in the middle of
a grid as large as the world's. When it is located, all of its scans are transformed to the frame of
the target, and the team's map is rebuilt from the scans of all located robots. Measurements are
shared and not posteriors, so that nothing is counted twice, and points on robots whose poses are
known by then are removed from every scan.

What a scan observes of base, encoders and springs revises the poses of earlier scans too. Once one
of them has moved enough, the team's map is made again of the revised scans, so that it is the map
that would have been made with these camera poses from the start (`CorrectionSettings.smoothing`):
points on robots are removed by the revised poses. Cells on the border of a view may then become
unknown again.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.envs.field._recorded_scan import RecordedScan, fuse_recorded_scans, revise
from coopmap_env.envs.field.belief import FieldBelief
from coopmap_env.envs.field.settings import FieldSettings
from coopmap_env.envs.field.target_search import TargetSearch
from coopmap_env.envs.field.transition import FusedScans
from coopmap_env.envs.field.true_poses import TruePoses
from coopmap_env.geometry import Pose
from coopmap_env.localization import (
    LocalizationFailure,
    PoseCorrection,
    PoseCorrector,
    Registration,
    TargetModel,
)
from coopmap_env.mapping import ScanGain
from coopmap_env.robots import PoseEstimate
from coopmap_env.sensing import PointCloud, Scan, transform_cloud

BASE_COVARIANCE_INFLATION = 2.0
"""Factor on the covariance of a registered base, with which motion correction starts: the scans
that registered it are corrected by the same pixels, which carry less information a second time."""


class LocalizedScan(NamedTuple):
    """A scan in the frame in which its robot maps."""

    estimate: PoseEstimate
    scan: Scan
    """Without the points on robots."""
    correction: PoseCorrection | None
    """None if fiducials were not used."""

    @property
    def pose_index(self) -> int | None:
        """See `RecordedScan.pose_index`."""
        return None if self.correction is None else self.correction.pose_index


class TeamLocalizer:
    """Estimates camera and base poses of a team; one object for each episode.

    Parameters
    ----------
    settings : FieldSettings
    motion_correction : {"encoders", "kinematic", "fiducials", "exact"}
        Encoders and kinematics differ in the vehicles of `belief`.
    target : ndarray, shape (m, 3, 3)
        Triangles of the target in the world frame.
    belief : FieldBelief
        At the start of the episode.
    true_poses : TruePoses
        For the setting "exact", and to select one of the frames that a symmetric target has.
    """

    def __init__(
        self,
        settings: FieldSettings,
        motion_correction: str,
        target: NDArray[np.float64],
        belief: FieldBelief,
        true_poses: TruePoses,
    ) -> None:
        self._settings = settings
        self._motion_correction = motion_correction
        self._true_poses = true_poses
        self._triangles = target
        self._corrector = (
            PoseCorrector(
                belief.vehicles, settings.camera, settings.noise, self._target,
                settings.correction, settings.fiducials, settings.tracking,
            )
            if motion_correction == "fiducials"
            else None
        )  # fmt: skip
        self._smooths = self._corrector is not None and settings.correction.smoothing
        self._recorded_scans: list[RecordedScan] = []
        self._n_batches = 0
        n_robots = len(belief.agents)
        self.corrections: list[PoseCorrection | None] = [None] * n_robots
        """Correction of each robot's last scan, if fiducials were used."""
        self.correction_times = [0.0] * n_robots
        """Seconds of a processor that each correction took; they differ from run to run."""
        self.registrations: list[Registration | None] = [None] * n_robots
        """Result of each robot's last search for the target."""
        self.registration_times: list[float] = []
        """Seconds of a processor that each search of the last step took."""

    @cached_property
    def _target(self) -> TargetModel:
        """The known target, prepared when it is needed first: not if all poses are known."""
        return _target_model(self._triangles.tobytes())

    @cached_property
    def _target_search(self) -> TargetSearch:
        return TargetSearch(self._settings, self._target, self._true_poses)

    def failure(self, robot: int) -> tuple[LocalizationFailure, str]:
        """Why a robot has not been located yet, and the same in words, with the figures."""
        last, blank = self.registrations[robot], LocalizationFailure.NOT_SEARCHED
        return (blank, blank.words) if last is None else (last.failure, last.reason)

    def revised_estimates(self) -> list[PoseEstimate] | None:
        """Camera pose of each corrected scan by all scans until now; None without fiducials."""
        return None if self._corrector is None else self._corrector.revised_estimates()

    def fuse(
        self, belief: FieldBelief, clouds: Sequence[PointCloud], true_cameras: Sequence[Pose]
    ) -> FusedScans:
        """Estimate the pose of each robot's scan, fuse it into the robot's map, locate robots.

        A robot that is located by this step has its scan in the team's frame afterwards.
        """
        belief, scans = self._localize_scans(belief, clouds, true_cameras)
        gains = _integrate(belief, scans)
        if not all(belief.located):
            belief, last_scans = self._search_target(belief)
            scans = [last_scans.get(robot, scan) for robot, scan in enumerate(scans)]
        if self._smooths:
            belief, scans = self._revise_team_map(belief, scans)
        return FusedScans(belief, scans, gains)

    def _localize_scans(
        self, belief: FieldBelief, clouds: Sequence[PointCloud], true_cameras: Sequence[Pose]
    ) -> tuple[FieldBelief, list[Scan]]:
        scans = []
        for robot, (cloud, true_camera) in enumerate(zip(clouds, true_cameras, strict=True)):
            localized = self._localize(belief, robot, cloud, true_camera)
            self.corrections[robot] = localized.correction
            if self._smooths or not all(belief.located):
                self._recorded_scans.append(
                    RecordedScan(
                        robot, cloud, belief.joints, true_camera, localized.estimate,
                        belief.robot_spheres(robot), self._n_batches, localized.pose_index,
                    )
                )  # fmt: skip
                # in v0, which did not smooth, they were fused again one by one
                self._n_batches += not self._settings.correction.smoothing
            if localized.estimate is not belief.estimates[robot]:
                belief = belief.with_camera_estimate(robot, localized.estimate)
            scans.append(localized.scan)
        self._n_batches += 1
        return belief, scans

    def _localize(
        self, belief: FieldBelief, robot: int, cloud: PointCloud, true_camera: Pose
    ) -> LocalizedScan:
        """A scan with the camera pose of the setting, without points on robots."""
        noise, estimate, correction = self._settings.noise, belief.estimates[robot], None
        if self._motion_correction == "exact":
            estimate = self._true_poses.exact_camera(belief, robot, true_camera)
        cloud = belief.remove_robot_points(robot, cloud, estimate, noise)
        if self._corrector is not None and belief.located[robot]:
            start_time = time.thread_time()
            correction = self._corrector.correct(robot, belief.joints[robot], cloud, belief.map)
            self.correction_times[robot] = time.thread_time() - start_time
            estimate = correction.estimate
        scan = transform_cloud(cloud, estimate.pose, noise, estimate.covariance)
        return LocalizedScan(estimate, scan, correction)

    def _search_target(self, belief: FieldBelief) -> tuple[FieldBelief, dict[int, Scan]]:
        """Search for the target in the scans of each robot that is not located.

        Robots that find it join the team's map: their last scans in its frame are returned.
        """
        self.registration_times = []
        last_scans = {}
        for robot, is_located in enumerate(belief.located):
            if is_located:
                continue
            start_time = time.thread_time()
            own = [record for record in self._recorded_scans if record.robot == robot]
            found = self._target_search.register(belief, robot, own)
            if found is None:
                continue
            self.registration_times.append(time.thread_time() - start_time)
            self.registrations[robot] = found
            if found.located and found.T_target_base is not None:
                belief, last_scans[robot] = self._merge_into_team(belief, robot, found)
        if all(belief.located) and not self._smooths:
            self._recorded_scans = []
        return belief, last_scans

    def _merge_into_team(
        self, belief: FieldBelief, robot: int, found: Registration
    ) -> tuple[FieldBelief, Scan]:
        """Transform a robot and its scans to the team's frame; rebuild the team's map.

        Also returns the robot's last scan in that frame.
        """
        assert found.T_target_base is not None
        assert found.covariance is not None
        belief = belief.with_base_pose(robot, found.T_target_base, found.covariance)
        if self._corrector is not None:
            inflated = BASE_COVARIANCE_INFLATION * found.covariance
            self._corrector.set_base(robot, PoseEstimate(found.T_target_base, inflated))
        own = [k for k, record in enumerate(self._recorded_scans) if record.robot == robot]
        hits = {k: self._count_target_points(belief, self._recorded_scans[k]) for k in own}
        # scans that see most of the target come first: they help to predict the others
        for k in sorted(own, key=lambda k: -hits[k]):
            record = self._recorded_scans[k]
            past_belief = belief.with_poses(record.joints)
            localized = self._localize(past_belief, robot, record.cloud, record.true_camera)
            self._recorded_scans[k] = record._replace(
                estimate=localized.estimate, pose_index=localized.pose_index
            )
            if k == own[-1]:
                self.corrections[robot] = localized.correction
                last_scan = localized.scan
            belief.map.integrate(localized.scan)  # later scans take fiducials from it
        self._rebuild_team_map(belief)
        estimate = self._recorded_scans[own[-1]].estimate
        return belief.with_camera_estimate(robot, estimate), last_scan

    def _count_target_points(self, belief: FieldBelief, record: RecordedScan) -> int:
        """Points of a scan within the bounds of the target, by the mount's kinematics."""
        pose = belief.vehicles[record.robot].camera_pose(record.joints[record.robot])
        points = pose.transform(record.cloud.points[record.cloud.hit])
        low, high = self._target.bounds
        return int(((points > low) & (points < high)).all(axis=1).sum())

    def _rebuild_team_map(self, belief: FieldBelief) -> None:
        """Make the team's map from the scans of all located robots."""
        for k, record in enumerate(self._recorded_scans):
            if belief.located[record.robot]:
                spheres = belief.with_poses(record.joints).robot_spheres(record.robot)
                self._recorded_scans[k] = record._replace(robot_spheres=spheres)
        fuse_recorded_scans(belief, self._recorded_scans, self._settings)

    def _revise_team_map(
        self, belief: FieldBelief, scans: list[Scan]
    ) -> tuple[FieldBelief, list[Scan]]:
        """Make the team's map again if the pose of a scan has been revised by enough.

        The cameras, and the last scans `scans`, are then where the map has them.
        """
        limit = self._settings.correction.min_revision
        estimates = self.revised_estimates() or []
        revised = revise(self._recorded_scans, estimates, limit, belief.map.grid)
        if revised is None:
            return belief, scans
        self._recorded_scans = revised
        fuse_recorded_scans(belief, revised, self._settings)
        last = revised[-len(scans) :]
        for record in last:
            belief = belief.with_camera_estimate(record.robot, record.estimate)
        return belief, [record.scan(self._settings.noise) for record in last]


def _integrate(belief: FieldBelief, scans: Sequence[Scan]) -> list[ScanGain]:
    """Fuse each scan into the map that its robot plans on, all of the team's map at once."""
    if all(belief.located):
        return belief.map.integrate(scans)
    shared = [robot for robot, is_located in enumerate(belief.located) if is_located]
    shared_gains = belief.map.integrate([scans[robot] for robot in shared])
    gains = dict(zip(shared, shared_gains, strict=True))
    return [
        gains[robot] if is_located else belief.planning_map(robot).integrate(scan)[0]
        for robot, (scan, is_located) in enumerate(zip(scans, belief.located, strict=True))
    ]


@lru_cache(maxsize=8)
def _target_model(target: bytes) -> TargetModel:
    """The model of a target's triangles: its preparation serves in every world."""
    return TargetModel(np.frombuffer(target).reshape(-1, 3, 3))
