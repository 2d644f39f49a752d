"""Correction of the camera pose after a motion, by fiducials (Section 2.5).

Mounts have calibration errors and suspensions give way, so encoders predict a camera's pose only
roughly. Earlier scans and the known target measure it better. Fiducials are selected in the map and
tracked in the new depth image. Each measures the error of the predicted pose, in the directions
that its surface determines (`patches`). All of them together, with the prediction, give the pose of
maximum likelihood and its covariance (`pose_state`), without outliers.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.linear_algebra import cholesky, eigh, product
from coopmap_env.geometry import Pose, apply_displacement, skew
from coopmap_env.localization.correction._keyframes import ScanSurfaces
from coopmap_env.localization.correction._patch_matcher import PatchMatcher
from coopmap_env.localization.correction._patches import Patches
from coopmap_env.localization.correction._pose_history import PastScan, PoseHistory
from coopmap_env.localization.correction._pose_state import PoseState
from coopmap_env.localization.correction.fiducials import (
    Fiducials,
    FiducialSettings,
    select_fiducials,
)
from coopmap_env.localization.correction.settings import CorrectionSettings
from coopmap_env.localization.correction.tracking import TrackingSettings, track_fiducials
from coopmap_env.localization.failures import CorrectionFailure
from coopmap_env.localization.target import TargetModel
from coopmap_env.mapping import OccupancyMap
from coopmap_env.robots import PoseEstimate, Vehicle
from coopmap_env.sensing import DepthCamera, PointCloud, RangeNoise

Array = NDArray[np.float64]

GATE_FRACTIONS = (1.0, 0.5, 0.2, 0.0)
"""Fractions of the prediction's uncertainty that are added to the residuals' deviations, one for
each iteration, while associations still change; the last one holds from then on. Without it, pixels
that are paired with a wrong face keep the pose away from where all would fit."""
REFERENCE_DEPTH = 3.0
"""Metres: the uncertainty is three standard deviations of a point at this depth."""
MAX_GATE_STD = 0.1
"""Metres of that at most. A base that registration has just found is better than its covariance,
which is inflated so that nothing counts twice."""


class FiducialMatches(NamedTuple):
    """m patches as pairs of points, as in Eqs. 10 to 13."""

    base_points: Array
    """Shape (m, 3): r_i in the world frame, by earlier scans or the known target. In directions
    that a patch does not determine, as predicted."""
    observed_points: Array
    """Shape (m, 3): k_i (f, u_i, v_i) in the camera frame."""
    information: Array
    """Shape (m, 3, 3): inverse covariance of r_i - T u_i, world frame; singular in directions that
    are not determined."""
    inlier_mask: NDArray[np.bool_]
    """Shape (m,): False for outliers."""

    @classmethod
    def empty(cls) -> FiducialMatches:
        """No matches."""
        points = np.zeros((0, 3))
        return cls(points, points, np.zeros((0, 3, 3)), np.zeros(0, dtype=np.bool_))

    @classmethod
    def from_patches(
        cls, patches: Patches, T_world_camera: Pose, inlier_mask: NDArray[np.bool_]
    ) -> FiducialMatches:
        """The matches of patches that were measured with the camera at a pose."""
        observed = T_world_camera.inverse().transform(patches.positions)
        base_points = patches.positions + patches.displacements
        return cls(base_points, observed, patches.information, inlier_mask)


class PoseCorrection(NamedTuple):
    """Result of a correction."""

    estimate: PoseEstimate
    """T_world_camera, corrected, or as predicted where `reason` says why."""
    predicted: PoseEstimate
    """T_world_camera by the encoders, with the estimates of base and offsets so far."""
    n_directions: int
    """How many of the pose's six directions the fiducials determine better than the prediction."""
    reason: str
    """Why nothing was corrected; empty if it was."""
    matches: FiducialMatches
    """The patches from which the pose was estimated."""
    tracked_fiducials: tuple[Array, Array]
    """Shapes (m, 3), (m, 3): r_i in the world and k_i (f, u_i, v_i) in the camera frame of the
    map's fiducials that were found in the image, as in the paper's Eq. 10: peaks of the map, and
    mean points of their regions. They are not used here: along a surface, a region's mean point
    says little of the fiducial's position."""
    pose_index: int
    """Index of the scan among `PoseCorrector.revised_estimates`."""

    @property
    def failure(self) -> CorrectionFailure:
        """Why nothing was corrected."""
        return CorrectionFailure.FEW_FIDUCIALS if self.reason else CorrectionFailure.NONE


class PoseCorrector:
    """Corrects the camera poses of a team; one object for each episode.

    Parameters
    ----------
    vehicles : sequence of Vehicle
        At their estimated base poses; see also `set_base`.
    camera : DepthCamera
    noise : RangeNoise
    target : TargetModel, optional
        In the world frame; without it, only the map has fiducials.
    settings, fiducials, tracking : optional
    """

    def __init__(
        self,
        vehicles: tuple[Vehicle, ...],
        camera: DepthCamera,
        noise: RangeNoise,
        target: TargetModel | None = None,
        settings: CorrectionSettings | None = None,
        fiducials: FiducialSettings | None = None,
        tracking: TrackingSettings | None = None,
    ) -> None:
        self.settings = settings or CorrectionSettings()
        self.poses = PoseState(vehicles)
        self._camera, self._noise = camera, noise
        self._fiducial_settings = fiducials or FiducialSettings()
        self._tracking_settings = tracking or TrackingSettings()
        self._matcher = PatchMatcher(camera, noise, target, self.settings)
        self._fiducials: list[Fiducials | None] = [None] * len(vehicles)
        self._history = PoseHistory(self.poses)

    def set_base(self, robot: int, base: PoseEstimate) -> None:
        """Set the estimate of a robot's base, see `PoseState.set_base`."""
        self.poses.set_base(robot, base)

    def correct(
        self, robot: int, reading: Array, cloud: PointCloud, map_: OccupancyMap
    ) -> PoseCorrection:
        """Correct the camera pose of a scan, and keep the scan for later ones.

        Parameters
        ----------
        robot : int
        reading : ndarray, shape (n,)
            Of its encoders.
        cloud : PointCloud
            In the camera frame; points on robots are filtered.
        map_ : OccupancyMap
            Before this scan, in which fiducials are selected.
        """
        scan = ScanSurfaces.from_cloud(cloud, self._camera, self._noise)
        camera_index = self.poses.add(robot, reading)
        predicted = self.poses.estimate(camera_index)
        labels, n_tracked, tracked = self._track(robot, predicted, cloud, map_)
        result = self._estimate_pose(scan, camera_index, labels, n_tracked)
        estimate = self.poses.estimate(camera_index)
        pose_index, was_measured = len(self._history), result[1] == ""
        is_keyframe = self._matcher.add_keyframe(scan)
        self._history.add(PastScan(robot, reading, estimate, was_measured), is_keyframe)
        if not is_keyframe:
            self.poses.remove_camera(camera_index)
        elif self._matcher.drop_oldest():
            self._history.finish_oldest_keyframe()
            self.poses.remove_camera(0)
        return PoseCorrection(estimate, predicted, *result, tracked, pose_index)

    def revised_estimates(self) -> list[PoseEstimate]:
        """Camera pose of each scan, in the order of `correct`, by all that was measured since."""
        return self._history.estimates()

    def _track(
        self, robot: int, predicted: PoseEstimate, cloud: PointCloud, map_: OccupancyMap
    ) -> tuple[NDArray[np.int32], int, tuple[Array, Array]]:
        """The map's fiducial of each pixel (n,), their number, and pairs of those found."""
        pose, covariance = predicted
        fiducials = select_fiducials(
            map_, pose, self._camera, self._fiducial_settings, self._fiducials[robot]
        )
        self._fiducials[robot] = fiducials
        if not len(fiducials):
            none = np.zeros((0, 3))
            return np.full(len(cloud.points), -1, dtype=np.int32), 0, (none, none)
        expected = pose.inverse().transform(fiducials.positions)
        squares = (expected**2).sum(axis=1)
        variances = np.trace(covariance[:3, :3]) + np.trace(covariance[3:, 3:]) * squares
        tracks = track_fiducials(
            cloud, self._camera, self._noise, expected, fiducials.radii, np.sqrt(variances),
            self._tracking_settings,
        )  # fmt: skip
        found = tracks.found
        return tracks.labels, len(fiducials), (fiducials.positions[found], tracks.points[found])

    def _estimate_pose(
        self, scan: ScanSurfaces, camera_index: int, tracked: NDArray[np.int32], n_tracked: int
    ) -> tuple[int, str, FiducialMatches]:
        """Estimate the pose of a scan, and update the state if there are enough fiducials.

        Returns the number of directions that are determined, why nothing was updated, and the
        matches.
        """
        s, poses = self.settings, self.poses
        prior = poses.estimate(camera_index).covariance
        self._matcher.set_camera_poses(poses.cameras[:camera_index])
        keyframe_ids = self._matcher.overlapping_keyframes(scan, poses.cameras[camera_index])
        state_indices = poses.state_indices([camera_index, *keyframe_ids])
        x = np.zeros(len(state_indices))
        max_gate_std = _max_gate_std(prior)
        for iteration in range(s.iterations):
            gate_std = max_gate_std * GATE_FRACTIONS[min(iteration, len(GATE_FRACTIONS) - 1)]
            camera = apply_displacement(poses.cameras[camera_index], x[:6])
            patches = self._matcher.measure(
                scan, camera, keyframe_ids, tracked, n_tracked, gate_std
            )
            if patches.n_fiducials < s.min_fiducials:
                return 0, self._too_few(patches.n_fiducials), FiducialMatches.empty()
            J = self._jacobian(patches, camera, keyframe_ids)
            z = patches.displacements + product(J[:, :, :6], x[:6])
            weighted = product(patches.information, J)
            # first no outlier is known, then outliers count less, at last not at all
            weights = np.ones(len(z))
            for pass_index in range(1 if iteration == 0 else 2):
                rows = (weights[:, None, None] * weighted).reshape(-1, len(state_indices))
                A = product(rows.T, J.reshape(-1, len(state_indices)))
                b = product(rows.T, z.ravel())
                x = poses.posterior_displacement(state_indices, A, b)
                outlier_scores = _outlier_scores(patches, z - product(J, x), s)
                weights = 1.0 / (1.0 + outlier_scores**2)
                if iteration == s.iterations - 1 and pass_index == 0:
                    weights = (outlier_scores < 1.0).astype(np.float64)
        inliers = outlier_scores < 1.0
        matches = FiducialMatches.from_patches(patches, camera, inliers)
        if (n := len(set(patches.labels[inliers].tolist()))) < s.min_fiducials:
            return 0, self._too_few(n), matches
        poses.update(state_indices, A, b)
        # a direction counts where the fiducials alone are more certain than the prediction
        L = cholesky(prior)
        gain = eigh(product(product(L.T, A[:6, :6]), L))[0]
        return int((gain > 1.0).sum()), "", matches

    def _jacobian(self, patches: Patches, camera: Pose, keyframe_ids: list[int]) -> Array:
        """Jacobian (f, 3, c) of the patches' displacements by those of the cameras.

        A patch's displacement is that of this camera, less that of the keyframe's camera.
        """
        J = np.zeros((len(patches.labels), 3, 6 * (1 + len(keyframe_ids))))
        J[:, :, :3] = np.eye(3)
        J[:, :, 3:6] = -skew(patches.positions - camera.translation)
        for source, keyframe in enumerate(keyframe_ids):
            of_source = patches.sources == source
            at = 6 * (source + 1)
            J[of_source, :, at : at + 3] = -np.eye(3)
            origin = self.poses.cameras[keyframe].translation
            J[of_source, :, at + 3 : at + 6] = skew(patches.positions[of_source] - origin)
        return J

    def _too_few(self, n: int) -> str:
        return f"fiducials in view: {n}, needed: {self.settings.min_fiducials}"


def _max_gate_std(prior: Array) -> float:
    """Three standard deviations of a point at the reference depth, by a pose's covariance."""
    variance = np.trace(prior[:3, :3]) + REFERENCE_DEPTH**2 * np.trace(prior[3:, 3:])
    return min(3.0 * math.sqrt(variance / 3.0), MAX_GATE_STD)


def _outlier_scores(patches: Patches, residuals: Array, settings: CorrectionSettings) -> Array:
    """Residuals (f, 3) of patches (f,), as fractions of the least residual of an outlier."""
    determined = patches.precisions > 0.0
    variances = 1.0 / np.where(determined, patches.precisions, 1.0) + settings.outlier_std**2
    limits = settings.outlier_sigmas * np.sqrt(variances)
    scores = np.abs(patches.along_axes(residuals)) / limits
    return np.asarray(np.where(determined, scores, 0.0).max(axis=1, initial=0.0))
