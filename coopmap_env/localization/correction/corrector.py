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

from coopmap_env.geometry import Pose, displaced, skew
from coopmap_env.localization.correction.fiducials import Fiducials, FiducialSettings, select
from coopmap_env.localization.correction.keyframes import Keyframes, Surfaces
from coopmap_env.localization.correction.known_target import KnownTarget
from coopmap_env.localization.correction.patches import (
    N_SUMS,
    Patches,
    count_shared,
    measure_patches,
    patches_of,
)
from coopmap_env.localization.correction.pose_state import JointPoses
from coopmap_env.localization.correction.settings import CorrectionSettings
from coopmap_env.localization.correction.tracking import TrackingSettings, track
from coopmap_env.localization.depth_rendering import pinhole
from coopmap_env.localization.target import TargetModel
from coopmap_env.mapping import OccupancyMap
from coopmap_env.robots import CameraEstimate, Vehicle
from coopmap_env.sensing import DepthCamera, PointCloud, RangeNoise

Array = NDArray[np.float64]

GATE = 0.25
"""Metres between a point and the surface that it may belong to."""
SPREADS = (1.0, 0.5, 0.2, 0.0)
"""By these shares of three standard deviations of where a prediction puts a surface `AHEAD` of the
camera, residuals are held for less certain while surfaces are still to be found; the last one
serves from then on. Without it, pixels that are still held against a wrong face pull the pose away
from where all would fit."""
AHEAD = 3.0
"""Metres."""
WIDEST = 0.1
"""Metres of that at most: a base that registration has just found is better than it is said to be
(it is said to be next to unknown, so that nothing counts twice)."""
STEP = 5
"""One pixel in so many is asked when earlier looks are counted out."""
LEAST_SHARED = 3
"""Of these pixels: an earlier look with fewer in common is not asked any further."""
LEAST_PLANAR = 40
"""Pixels with a normal: with fewer, a look is not kept for later ones."""


class Matches(NamedTuple):
    """Fiducials as Eqs. 10 to 13 want them."""

    base_points: Array
    """Shape (m, 3): r_i in the world frame, by what was seen before or is known. In directions
    that a fiducial leaves open, as predicted."""
    seen_points: Array
    """Shape (m, 3): k_i (f, u_i, v_i) in the camera frame."""
    information: Array
    """Shape (m, 3, 3): inverse covariance of r_i - T u_i, world frame; singular where open."""
    used: NDArray[np.bool_]
    """Shape (m,): False for outliers."""


class Correction(NamedTuple):
    """What fiducials say of a camera's pose."""

    estimate: CameraEstimate
    """T_world_camera, corrected, or as predicted where `reason` says why."""
    predicted: CameraEstimate
    """By the encoders, with what earlier looks have told of base and offsets."""
    directions: int
    """Of the pose's six: how many the fiducials tell better than the prediction does."""
    reason: str
    """Why nothing was corrected; empty if it was."""
    matches: Matches
    """The patches that the pose was identified from."""
    tracked: tuple[Array, Array]
    """Shapes (m, 3), (m, 3): r_i in the world and k_i (f, u_i, v_i) in the camera frame of the
    map's fiducials that were found in the image, as the paper reads Eq. 10: peaks of the map, and
    mean points of their regions. Nothing is done with them here: a region's mean point says little
    of where along its surface the fiducial is."""


class MotionCorrection:
    """Corrects the camera poses of a team; one object for each episode.

    Parameters
    ----------
    vehicles : sequence of Vehicle
        Where they are taken to stand; see also `place_base`.
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
        self.poses = JointPoses(vehicles)
        self._camera, self._noise = camera, noise
        self._selection = fiducials or FiducialSettings()
        self._tracking = tracking or TrackingSettings()
        self._lens = pinhole(camera)
        spacing = self.settings.target_spacing
        self._target = None if target is None else KnownTarget(target, self._lens, spacing)
        self._earlier = Keyframes(self.settings.keyframes + 1, camera.n_pixels)
        self._kept: list[Fiducials | None] = [None] * len(vehicles)

    def place_base(self, robot: int, base: CameraEstimate) -> None:
        """A robot's base is found: see `JointPoses.place_base`."""
        self.poses.place_base(robot, base)

    def correct(
        self, robot: int, reading: Array, cloud: PointCloud, map_: OccupancyMap
    ) -> Correction:
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
        look = Surfaces.of(cloud, self._camera, self._noise)
        number = self.poses.add(robot, reading)
        predicted = self.poses.estimate(number)
        labels, n_tracked, tracked = self._track(robot, predicted, cloud, map_)
        found = self._solve(look, number, labels, n_tracked)
        estimate = self.poses.estimate(number)
        self._keep(look, number)
        return Correction(estimate, predicted, *found, tracked)

    def _keep(self, look: Surfaces, number: int) -> None:
        """Keep a look for later ones, if there is enough to be seen in it."""
        if look.planar.sum() < LEAST_PLANAR:
            self.poses.forget(number)
            return
        self._earlier.add(look)
        if len(self._earlier) > self.settings.keyframes:
            self.poses.forget(0)
            self._earlier.remove(0)

    def _track(
        self, robot: int, predicted: CameraEstimate, cloud: PointCloud, map_: OccupancyMap
    ) -> tuple[NDArray[np.int32], int, tuple[Array, Array]]:
        """Which fiducial of the map each pixel (n,) belongs to, how many there are, those found."""
        pose, covariance = predicted
        chosen = select(map_, pose, self._camera, self._selection, self._kept[robot])
        self._kept[robot] = chosen
        if not len(chosen):
            none = np.zeros((0, 3))
            return np.full(len(cloud.points), -1, dtype=np.int32), 0, (none, none)
        at = pose.inverse().transform(chosen.positions)
        squares = np.trace(covariance[:3, :3]) + np.trace(covariance[3:, 3:]) * (at**2).sum(axis=1)
        tracks = track(
            cloud, self._camera, self._noise, at, chosen.radii, np.sqrt(squares), self._tracking
        )
        found = tracks.found
        return tracks.labels, len(chosen), (chosen.positions[found], tracks.points[found])

    def _solve(
        self, look: Surfaces, number: int, tracked: NDArray[np.int32], n_tracked: int
    ) -> tuple[int, str, Matches]:
        """Identify the pose of a look, and move the state by it, if it is told at all."""
        s, poses = self.settings, self.poses
        prior = poses.estimate(number).covariance
        self._earlier.place(poses.cameras[:number])
        numbers = self._shared(look, poses.cameras[number])
        columns = poses.columns([number, *numbers])
        x = np.zeros(len(columns))
        turns = np.trace(prior[:3, :3]) + AHEAD**2 * np.trace(prior[3:, 3:])
        spread = min(3.0 * math.sqrt(turns / 3.0), WIDEST)
        for iteration in range(s.iterations):
            doubt = spread * SPREADS[min(iteration, len(SPREADS) - 1)]
            camera = displaced(poses.cameras[number], x[:6])
            patches = self._measure(look, camera, numbers, tracked, n_tracked, doubt)
            if (n := patches.n_fiducials) < s.least_fiducials:
                return 0, _too_few(n, s.least_fiducials), _none()
            J = self._design(patches, camera, numbers)
            z = patches.displacements + J[:, :, :6] @ x[:6]
            weighed = patches.information @ J
            # first nothing is known to be wrong, then outliers count less, at last not at all
            share = np.ones(len(z))
            for turn in range(1 if iteration == 0 else 2):
                rows = (share[:, None, None] * weighed).reshape(-1, len(columns))
                A, b = rows.T @ J.reshape(-1, len(columns)), rows.T @ z.ravel()
                x = poses.displacement(columns, A, b)
                strangeness = _strangeness(patches, z - J @ x, s)
                share = 1.0 / (1.0 + strangeness**2)
                if iteration == s.iterations - 1 and turn == 0:
                    share = (strangeness < 1.0).astype(np.float64)
        used = strangeness < 1.0
        matches = _matches(patches, camera, used)
        if (n := len(set(patches.labels[used].tolist()))) < s.least_fiducials:
            return 0, _too_few(n, s.least_fiducials), matches
        poses.condition(columns, A, b)
        # a direction counts where the fiducials alone are surer than the prediction
        L = np.linalg.cholesky(prior)
        gain = np.linalg.eigvalsh(L.T @ A[:6, :6] @ L)
        return int((gain > 1.0).sum()), "", matches

    def _shared(self, look: Surfaces, camera: Pose) -> list[int]:
        """Numbers of the earlier looks that have the most pixels in common with this one."""
        counts = np.empty(len(self._earlier), dtype=np.int64)
        count_shared(
            camera.transform(look.points), look.normals @ camera.rotation.T, look.planar, STEP,
            np.array(self._earlier.slots, dtype=np.int64), self._sources, self._lens,
            GATE, counts,
        )  # fmt: skip
        best = np.argsort(-counts, kind="stable")[: self.settings.sources]
        return [int(number) for number in best if counts[number] >= LEAST_SHARED]

    @property
    def _sources(self) -> tuple[NDArray[Any], ...]:
        """Earlier looks as kernels want them; see `patches.associate`."""
        kept = self._earlier
        return (*kept.surfaces[:3], kept.rotations, kept.translations)

    def _measure(
        self, look: Surfaces, camera: Pose, numbers: list[int], tracked: NDArray[np.int32],
        n_tracked: int, doubt: float,
    ) -> Patches:  # fmt: skip
        """Hold a look against earlier ones and the target, with its camera at a pose."""
        labels, known, n_known = tracked.copy(), np.zeros((len(look.points), 6)), 0
        if self._target is not None:
            n_known = len(self._target.centers)
            self._target.expect(
                camera, look.points, look.normals, look.planar, look.deviations, n_tracked, labels,
                known,
            )  # fmt: skip
        earlier = self._earlier
        slots = np.array([earlier.slots[number] for number in numbers], dtype=np.int64)
        sums = np.zeros((n_tracked + n_known, 1 + len(numbers), N_SUMS))
        measure_patches(
            camera.transform(look.points), look.normals @ camera.rotation.T, look.planar,
            look.tilts, look.deviations, np.ascontiguousarray(camera.rotation[:, 0]),
            self._noise.lateral / max(self._noise.depth, 1e-12), labels, known,
            slots, self._sources, earlier.surfaces.tilts, earlier.surfaces.deviations, self._lens,
            (GATE, doubt),
            np.zeros((len(numbers), len(look.points)), dtype=np.bool_), sums,
        )  # fmt: skip
        return patches_of(sums, self.settings)

    def _design(self, patches: Patches, camera: Pose, numbers: list[int]) -> Array:
        """Jacobian (f, 3, c) of what patches measure by the displacements of the looks.

        A patch's displacement is that of this camera, less that of the look it was held against.
        """
        J = np.zeros((len(patches.labels), 3, 6 * (1 + len(numbers))))
        J[:, :, :3] = np.eye(3)
        J[:, :, 3:6] = -skew(patches.positions - camera.translation)
        for place, number in enumerate(numbers):
            of = patches.sources == place
            at = 6 * (place + 1)
            J[of, :, at : at + 3] = -np.eye(3)
            origin = self.poses.cameras[number].translation
            J[of, :, at + 3 : at + 6] = skew(patches.positions[of] - origin)
        return J


def _strangeness(patches: Patches, left: Array, settings: CorrectionSettings) -> Array:
    """How far each patch (f,) is off by what is left (f, 3), as a share of what is an outlier."""
    told = patches.strengths > 0.0
    variances = 1.0 / np.where(told, patches.strengths, 1.0) + settings.outlier_std**2
    off = np.abs(patches.along_axes(left)) / (settings.outlier_sigmas * np.sqrt(variances))
    return np.asarray(np.where(told, off, 0.0).max(axis=1, initial=0.0))


def _matches(patches: Patches, camera: Pose, used: NDArray[np.bool_]) -> Matches:
    return Matches(
        patches.positions + patches.displacements,
        camera.inverse().transform(patches.positions),
        patches.information,
        used,
    )


def _none() -> Matches:
    return Matches(
        np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros(0, dtype=np.bool_)
    )


def _too_few(n: int, least: int) -> str:
    return f"fiducials in view: {n}, needed: {least}"
