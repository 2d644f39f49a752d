"""Motion correction (2.5): where the camera really is after a motion, from fiducials.

Mounts err and suspensions give, so encoders tell a camera's pose only roughly. What was seen before
the motion, and what is known of the target, tells it again: fiducials are chosen on the map, and
tracked in the new depth image; each measures by how much the predicted pose is off, in the
directions that its surface tells (`patches`); all of them together, with the prediction, give the
pose of the greatest likelihood and its covariance (`joint_poses`), outliers left out.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.geometry import Pose, apply_displacement, skew
from coopmap_env.localization.correction.fiducials import (
    Fiducials,
    FiducialSettings,
    select_fiducials,
)
from coopmap_env.localization.correction.keyframes import KeyframeBuffer, ScanSurfaces
from coopmap_env.localization.correction.known_target import KnownTarget
from coopmap_env.localization.correction.patches import (
    N_SUMS,
    Patches,
    accumulate_patches,
    count_overlap,
    patches_from_sums,
)
from coopmap_env.localization.correction.pose_state import PoseState
from coopmap_env.localization.correction.settings import CorrectionSettings
from coopmap_env.localization.correction.tracking import TrackingSettings, track_fiducials
from coopmap_env.localization.depth_rendering import pinhole_intrinsics
from coopmap_env.localization.target import TargetModel
from coopmap_env.mapping import OccupancyMap
from coopmap_env.robots import PoseEstimate, Vehicle
from coopmap_env.sensing import DepthCamera, PointCloud, RangeNoise

Array = NDArray[np.float64]

MAX_ASSOCIATION_DISTANCE = 0.25
"""Metres between a point and the surface that it may belong to."""
GATE_FRACTIONS = (1.0, 0.5, 0.2, 0.0)
"""By these shares of three standard deviations of where a prediction puts a surface `REFERENCE_DEPTH` of the
camera, residuals are held for less certain while surfaces are still to be found; the last one
serves from then on. Without it, pixels that are still held against a wrong face pull the pose away
from where all would fit."""
REFERENCE_DEPTH = 3.0
"""Metres."""
MAX_GATE_STD = 0.1
"""Metres of that at most: a base that registration has just found is better than it is said to be
(it is said to be next to unknown, so that nothing counts twice)."""
OVERLAP_STRIDE = 5
"""One pixel in so many is asked when earlier looks are counted out."""
MIN_OVERLAP = 3
"""Of these pixels: an earlier look with fewer in common is not asked any further."""
MIN_PLANAR_PIXELS = 40
"""Pixels with a normal: with fewer, a look is not kept for later ones."""


class FiducialMatches(NamedTuple):
    """Fiducials as Eqs. 10 to 13 want them."""

    base_points: Array
    """Shape (m, 3): r_i in the world frame, by what was seen before or is known. In directions
    that a fiducial leaves open, as predicted."""
    observed_points: Array
    """Shape (m, 3): k_i (f, u_i, v_i) in the camera frame."""
    information: Array
    """Shape (m, 3, 3): inverse covariance of r_i - T u_i, world frame; singular where open."""
    inlier_mask: NDArray[np.bool_]
    """Shape (m,): False for outliers."""


class PoseCorrection(NamedTuple):
    """What fiducials say of a camera's pose."""

    estimate: PoseEstimate
    """T_world_camera, corrected, or as predicted where `reason` says why."""
    predicted: PoseEstimate
    """By the encoders, with what earlier looks have told of base and offsets."""
    n_directions: int
    """Of the pose's six: how many the fiducials tell better than the prediction does."""
    reason: str
    """Why nothing was corrected; empty if it was."""
    matches: FiducialMatches
    """The patches that the pose was identified from."""
    tracked_fiducials: tuple[Array, Array]
    """Shapes (m, 3), (m, 3): r_i in the world and k_i (f, u_i, v_i) in the camera frame of the
    map's fiducials that were found in the image, as the paper reads Eq. 10: peaks of the map, and
    mean points of their regions. Nothing is done with them here: a region's mean point says little
    of where along its surface the fiducial is."""


class PoseCorrector:
    """Corrects the camera poses of a team; one object for each episode.

    Parameters
    ----------
    vehicles : sequence of Vehicle
        Where they are taken to stand; see also `set_base`.
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
        self._intrinsics = pinhole_intrinsics(camera)
        spacing = self.settings.target_spacing
        self._target = None if target is None else KnownTarget(target, self._intrinsics, spacing)
        self._keyframes = KeyframeBuffer(self.settings.max_keyframes + 1, camera.n_pixels)
        self._fiducials: list[Fiducials | None] = [None] * len(vehicles)

    def set_base(self, robot: int, base: PoseEstimate) -> None:
        """A robot's base is found: see `PoseState.set_base`."""
        self.poses.set_base(robot, base)

    def correct(
        self, robot: int, reading: Array, cloud: PointCloud, map_: OccupancyMap
    ) -> PoseCorrection:
        """Correct the pose of one look, and keep the look for those that follow.

        Parameters
        ----------
        robot : int
        reading : ndarray, shape (n,)
            Of its encoders.
        cloud : PointCloud
            In the camera frame, robots taken out.
        map_ : OccupancyMap
            Before this look, from which fiducials are chosen.
        """
        surfaces = ScanSurfaces.from_cloud(cloud, self._camera, self._noise)
        camera_index = self.poses.add(robot, reading)
        predicted = self.poses.estimate(camera_index)
        labels, n_tracked, tracked = self._track(robot, predicted, cloud, map_)
        found = self._solve(surfaces, camera_index, labels, n_tracked)
        estimate = self.poses.estimate(camera_index)
        self._store_keyframe(surfaces, camera_index)
        return PoseCorrection(estimate, predicted, *found, tracked)

    def _store_keyframe(self, surfaces: ScanSurfaces, camera_index: int) -> None:
        """Keep a look for later ones, if there is enough to be seen in it."""
        if surfaces.planar.sum() < MIN_PLANAR_PIXELS:
            self.poses.remove_camera(camera_index)
            return
        self._keyframes.add(surfaces)
        if len(self._keyframes) > self.settings.max_keyframes:
            self.poses.remove_camera(0)
            self._keyframes.remove(0)

    def _track(
        self, robot: int, predicted: PoseEstimate, cloud: PointCloud, map_: OccupancyMap
    ) -> tuple[NDArray[np.int32], int, tuple[Array, Array]]:
        """Which fiducial of the map each pixel (n,) belongs to, how many there are, those found."""
        pose, covariance = predicted
        fiducials = select_fiducials(
            map_, pose, self._camera, self._fiducial_settings, self._fiducials[robot]
        )
        self._fiducials[robot] = fiducials
        if not len(fiducials):
            none = np.zeros((0, 3))
            return np.full(len(cloud.points), -1, dtype=np.int32), 0, (none, none)
        at = pose.inverse().transform(fiducials.positions)
        variances = np.trace(covariance[:3, :3]) + np.trace(covariance[3:, 3:]) * (at**2).sum(
            axis=1
        )
        tracks = track_fiducials(
            cloud,
            self._camera,
            self._noise,
            at,
            fiducials.radii,
            np.sqrt(variances),
            self._tracking_settings,
        )
        found = tracks.found
        return tracks.labels, len(fiducials), (fiducials.positions[found], tracks.points[found])

    def _solve(
        self, surfaces: ScanSurfaces, camera_index: int, tracked: NDArray[np.int32], n_tracked: int
    ) -> tuple[int, str, FiducialMatches]:
        """Identify the pose of a look, and move the state by it, if it is told at all."""
        s, poses = self.settings, self.poses
        prior = poses.estimate(camera_index).covariance
        self._keyframes.set_camera_poses(poses.cameras[:camera_index])
        keyframe_ids = self._overlapping_keyframes(surfaces, poses.cameras[camera_index])
        state_indices = poses.state_indices([camera_index, *keyframe_ids])
        x = np.zeros(len(state_indices))
        displacement_variance = np.trace(prior[:3, :3]) + REFERENCE_DEPTH**2 * np.trace(
            prior[3:, 3:]
        )
        max_gate_std = min(3.0 * math.sqrt(displacement_variance / 3.0), MAX_GATE_STD)
        for iteration in range(s.iterations):
            gate_std = max_gate_std * GATE_FRACTIONS[min(iteration, len(GATE_FRACTIONS) - 1)]
            camera = apply_displacement(poses.cameras[camera_index], x[:6])
            patches = self._measure_patches(
                surfaces, camera, keyframe_ids, tracked, n_tracked, gate_std
            )
            if (n := patches.n_fiducials) < s.min_fiducials:
                return 0, _too_few(n, s.min_fiducials), _no_matches()
            J = self._jacobian(patches, camera, keyframe_ids)
            z = patches.displacements + J[:, :, :6] @ x[:6]
            weighted = patches.information @ J
            # first nothing is known to be wrong, then outliers count less, at last not at all
            weights = np.ones(len(z))
            for pass_index in range(1 if iteration == 0 else 2):
                rows = (weights[:, None, None] * weighted).reshape(-1, len(state_indices))
                A, b = rows.T @ J.reshape(-1, len(state_indices)), rows.T @ z.ravel()
                x = poses.posterior_displacement(state_indices, A, b)
                outlier_scores = _outlier_scores(patches, z - J @ x, s)
                weights = 1.0 / (1.0 + outlier_scores**2)
                if iteration == s.iterations - 1 and pass_index == 0:
                    weights = (outlier_scores < 1.0).astype(np.float64)
        used = outlier_scores < 1.0
        matches = _matches(patches, camera, used)
        if (n := len(set(patches.labels[used].tolist()))) < s.min_fiducials:
            return 0, _too_few(n, s.min_fiducials), matches
        poses.update(state_indices, A, b)
        # a direction counts where the fiducials alone are surer than the prediction
        L = np.linalg.cholesky(prior)
        gain = np.linalg.eigvalsh(L.T @ A[:6, :6] @ L)
        return int((gain > 1.0).sum()), "", matches

    def _overlapping_keyframes(self, surfaces: ScanSurfaces, camera: Pose) -> list[int]:
        """Numbers of the earlier looks that have the most pixels in common with this one."""
        counts = np.empty(len(self._keyframes), dtype=np.int64)
        count_overlap(
            camera.transform(surfaces.points), surfaces.normals @ camera.rotation.T, surfaces.planar, OVERLAP_STRIDE,
            np.array(self._keyframes.slots, dtype=np.int64), self._keyframe_arrays, self._intrinsics,
            MAX_ASSOCIATION_DISTANCE, counts,
        )  # fmt: skip
        best = np.argsort(-counts, kind="stable")[: self.settings.max_sources]
        return [int(camera_index) for camera_index in best if counts[camera_index] >= MIN_OVERLAP]

    @property
    def _keyframe_arrays(self) -> tuple[NDArray[Any], ...]:
        """Earlier looks as kernels want them; see `patches.associate`."""
        keyframes = self._keyframes
        return (*keyframes.surfaces[:3], keyframes.rotations, keyframes.translations)

    def _measure_patches(
        self, surfaces: ScanSurfaces, camera: Pose, keyframe_ids: list[int], tracked: NDArray[np.int32],
        n_tracked: int, gate_std: float,
    ) -> Patches:  # fmt: skip
        """Hold a look against earlier ones and the target, with its camera at a pose."""
        labels, target_planes, n_target_labels = (
            tracked.copy(),
            np.zeros((len(surfaces.points), 6)),
            0,
        )
        if self._target is not None:
            n_target_labels = len(self._target.centers)
            self._target.label_pixels(
                camera, surfaces.points, surfaces.normals, surfaces.planar, surfaces.deviations, n_tracked, labels,
                target_planes,
            )  # fmt: skip
        keyframes = self._keyframes
        slots = np.array(
            [keyframes.slots[camera_index] for camera_index in keyframe_ids], dtype=np.int64
        )
        sums = np.zeros((n_tracked + n_target_labels, 1 + len(keyframe_ids), N_SUMS))
        accumulate_patches(
            camera.transform(surfaces.points), surfaces.normals @ camera.rotation.T, surfaces.planar,
            surfaces.normal_variances, surfaces.deviations, np.ascontiguousarray(camera.rotation[:, 0]),
            self._noise.lateral / max(self._noise.depth, 1e-12), labels, target_planes,
            slots, self._keyframe_arrays, keyframes.surfaces.normal_variances, keyframes.surfaces.deviations, self._intrinsics,
            (MAX_ASSOCIATION_DISTANCE, gate_std),
            np.zeros((len(keyframe_ids), len(surfaces.points)), dtype=np.bool_), sums,
        )  # fmt: skip
        return patches_from_sums(sums, self.settings)

    def _jacobian(self, patches: Patches, camera: Pose, keyframe_ids: list[int]) -> Array:
        """Jacobian (f, 3, c) of what patches measure by the displacements of the looks.

        A patch's displacement is that of this camera, less that of the look it was held against.
        """
        J = np.zeros((len(patches.labels), 3, 6 * (1 + len(keyframe_ids))))
        J[:, :, :3] = np.eye(3)
        J[:, :, 3:6] = -skew(patches.positions - camera.translation)
        for column, camera_index in enumerate(keyframe_ids):
            of = patches.sources == column
            at = 6 * (column + 1)
            J[of, :, at : at + 3] = -np.eye(3)
            origin = self.poses.cameras[camera_index].translation
            J[of, :, at + 3 : at + 6] = skew(patches.positions[of] - origin)
        return J


def _outlier_scores(patches: Patches, residuals: Array, settings: CorrectionSettings) -> Array:
    """How far each patch (f,) is off by what is left (f, 3), as a share of what is an outlier."""
    observed = patches.precisions > 0.0
    variances = 1.0 / np.where(observed, patches.precisions, 1.0) + settings.outlier_std**2
    normalized_residuals = np.abs(patches.along_axes(residuals)) / (
        settings.outlier_sigmas * np.sqrt(variances)
    )
    return np.asarray(np.where(observed, normalized_residuals, 0.0).max(axis=1, initial=0.0))


def _matches(patches: Patches, camera: Pose, used: NDArray[np.bool_]) -> FiducialMatches:
    return FiducialMatches(
        patches.positions + patches.displacements,
        camera.inverse().transform(patches.positions),
        patches.information,
        used,
    )


def _no_matches() -> FiducialMatches:
    return FiducialMatches(
        np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros(0, dtype=np.bool_)
    )


def _too_few(n: int, needed: int) -> str:
    return f"fiducials in view: {n}, needed: {needed}"
