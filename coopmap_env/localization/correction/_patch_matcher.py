"""Comparison of a scan with earlier scans and with the known target, patch by patch."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coopmap_env.geometry import Pose
from coopmap_env.localization.correction._association import (
    AssociationGates,
    PatchScan,
    PatchSources,
    accumulate_patches,
    count_overlap,
)
from coopmap_env.localization.correction._keyframes import KeyframeBuffer, ScanSurfaces
from coopmap_env.localization.correction._known_target import KnownTarget, PixelPlanes
from coopmap_env.localization.correction._patches import Patches, PatchSums, patches_from_sums
from coopmap_env.localization.correction.settings import CorrectionSettings
from coopmap_env.localization.target import TargetModel
from coopmap_env.sensing import DepthCamera, RangeNoise

OVERLAP_STRIDE = 5
"""One pixel in so many counts towards the overlap of two scans."""
MIN_OVERLAP = 3
"""Least of these pixels: with fewer, a keyframe is not compared."""


class PatchMatcher:
    """Measures by how much patches of a scan are displaced from where they were before.

    Parameters
    ----------
    camera : DepthCamera
    noise : RangeNoise
    target : TargetModel, optional
        In the world frame; without it, scans are compared with each other only.
    settings : CorrectionSettings
    """

    def __init__(
        self,
        camera: DepthCamera,
        noise: RangeNoise,
        target: TargetModel | None,
        settings: CorrectionSettings,
    ) -> None:
        self._settings = settings
        self._intrinsics = camera.intrinsics
        self._lateral_ratio = noise.lateral / max(noise.depth, 1e-12)
        self._target = None
        if target is not None:
            self._target = KnownTarget(target, self._intrinsics, settings.target_spacing)
        # one more than is kept, as a scan is added before the oldest is dropped
        self._keyframes = KeyframeBuffer(settings.max_keyframes + 1, camera.n_pixels)

    def set_camera_poses(self, cameras: list[Pose]) -> None:
        """Set T_world_camera of all keyframes, in their order."""
        self._keyframes.set_camera_poses(cameras)

    def add_keyframe(self, scan: ScanSurfaces) -> bool:
        """Keep a scan for later ones; False if it has too few planar pixels."""
        if scan.planar.sum() < self._settings.min_planar_pixels:
            return False
        self._keyframes.add(scan)
        return True

    def drop_oldest(self) -> bool:
        """Drop the oldest keyframe if there are more than the settings allow; whether it did."""
        if len(self._keyframes) <= self._settings.max_keyframes:
            return False
        self._keyframes.remove(0)
        return True

    def overlapping_keyframes(self, scan: ScanSurfaces, T_world_camera: Pose) -> list[int]:
        """Indices of the keyframes with the largest overlap, largest first."""
        counts = np.empty(len(self._keyframes), dtype=np.int64)
        slots = np.array(self._keyframes.slots, dtype=np.int64)
        count_overlap(
            scan.in_world(T_world_camera), OVERLAP_STRIDE, slots, self._keyframes.arrays,
            self._intrinsics, self._settings.max_association_distance, counts,
        )  # fmt: skip
        best = np.argsort(-counts, kind="stable")[: self._settings.max_sources]
        return [int(index) for index in best if counts[index] >= MIN_OVERLAP]

    def measure(
        self,
        scan: ScanSurfaces,
        T_world_camera: Pose,
        keyframe_ids: list[int],
        tracked: NDArray[np.int32],
        n_tracked: int,
        gate_std: float,
    ) -> Patches:
        """Measure the patches of a scan with its camera at a pose.

        Parameters
        ----------
        scan : ScanSurfaces
            Camera frame.
        T_world_camera : Pose
        keyframe_ids : list of int
            Keyframes to compare with, in this order.
        tracked : ndarray, shape (n,)
            Fiducial of the map to which each pixel belongs; -1 for none.
        n_tracked : int
            Number of these fiducials; those of the target follow.
        gate_std : float
            Metres, added to each pixel's deviation, see `AssociationGates`.
        """
        n_pixels, n_sources = len(scan.points), len(keyframe_ids)
        labels, planes, n_labels = tracked.copy(), PixelPlanes.zeros(n_pixels), n_tracked
        if self._target is not None:
            self._target.label_pixels(T_world_camera, scan, n_tracked, labels, planes)
            n_labels += len(self._target.centers)
        slots = np.array([self._keyframes.slots[k] for k in keyframe_ids], dtype=np.int64)
        used_pixels = np.zeros((n_sources, n_pixels), dtype=np.bool_)
        optical_axis = np.ascontiguousarray(T_world_camera.rotation[:, 0])
        sums = PatchSums.zeros(n_labels, 1 + n_sources)
        accumulate_patches(
            PatchScan(
                scan.in_world(T_world_camera), labels, planes, optical_axis, self._lateral_ratio
            ),
            PatchSources(self._keyframes.arrays, slots, used_pixels),
            self._intrinsics,
            AssociationGates(self._settings.max_association_distance, gate_std),
            sums,
        )
        return patches_from_sums(sums, self._settings)
