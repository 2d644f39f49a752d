"""Earlier scans with which later ones are compared, side by side in memory."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.elementary import power_array
from coopmap_env.core.linear_algebra import product
from coopmap_env.geometry import Pose
from coopmap_env.localization.correction._surface_normals import surface_normals
from coopmap_env.sensing import DepthCamera, PointCloud, RangeNoise

Array = NDArray[np.float64]

_MIN_STD = 1e-6
"""Metres: standard deviation of a camera without noise."""


class ScanSurfaces(NamedTuple):
    """Points and normals of a scan; n pixels, row by row."""

    points: Array
    """Shape (n, 3), camera frame, metres."""
    normals: Array
    """Shape (n, 3), camera frame, see `SurfaceNormals`."""
    planar: NDArray[np.bool_]
    """Shape (n,), see `SurfaceNormals`."""
    normal_variances: Array
    """Shape (n,), see `SurfaceNormals`."""
    deviations: Array
    """Shape (n,): S T_depth d^n of Eq. 1, metres; 0 where nothing was measured."""

    @classmethod
    def from_cloud(cls, cloud: PointCloud, camera: DepthCamera, noise: RangeNoise) -> ScanSurfaces:
        """The surfaces of a scan, in the camera frame."""
        points = np.ascontiguousarray(cloud.points, dtype=np.float64)
        normals, normal_variances, planar = surface_normals(cloud, camera, noise)
        distances = np.linalg.norm(points, axis=1)
        sigma = noise.intrinsic * noise.depth * power_array(distances, noise.exponent)
        deviations = np.where(cloud.hit, np.maximum(sigma, _MIN_STD), 0.0)
        return cls(points, normals, planar, normal_variances, deviations)

    def in_world(self, T_world_camera: Pose) -> ScanSurfaces:
        """The same surfaces in the world frame."""
        return self._replace(
            points=T_world_camera.transform(self.points),
            normals=product(self.normals, T_world_camera.rotation.T),
        )


class KeyframeArrays(NamedTuple):
    """All slots of a `KeyframeBuffer`, for kernels; c slots of n pixels."""

    surfaces: ScanSurfaces
    """With the slot as the first axis of each array."""
    rotations: Array
    """Shape (c, 3, 3): of T_world_camera."""
    translations: Array
    """Shape (c, 3): of T_world_camera, metres."""


class KeyframeBuffer:
    """Memory for a number of scans; each lies in a slot, where kernels find it.

    Parameters
    ----------
    capacity : int
        Scans at most.
    n_pixels : int
        Of each scan.
    """

    def __init__(self, capacity: int, n_pixels: int) -> None:
        c, n = capacity, n_pixels
        surfaces = ScanSurfaces(
            np.zeros((c, n, 3)), np.zeros((c, n, 3)), np.zeros((c, n), dtype=np.bool_),
            np.zeros((c, n)), np.zeros((c, n)),
        )  # fmt: skip
        self.arrays = KeyframeArrays(surfaces, np.zeros((c, 3, 3)), np.zeros((c, 3)))
        self.slots: list[int] = []
        """Slot of each stored scan, in the order in which they were added."""

    def __len__(self) -> int:
        return len(self.slots)

    def add(self, scan: ScanSurfaces) -> None:
        """Store one more scan.

        Raises
        ------
        ValueError
            If all slots are used.
        """
        free = set(range(len(self.arrays.translations))) - set(self.slots)
        if not free:
            raise ValueError(f"all {len(self.slots)} slots are used: remove a scan first")
        slot = min(free)
        for stored, new in zip(self.arrays.surfaces, scan, strict=True):
            stored[slot] = new
        self.slots.append(slot)

    def set_camera_poses(self, cameras: list[Pose]) -> None:
        """Set T_world_camera of all stored scans, in their order."""
        for slot, camera in zip(self.slots, cameras, strict=True):
            self.arrays.rotations[slot] = camera.rotation
            self.arrays.translations[slot] = camera.translation

    def remove(self, index: int) -> None:
        """Drop a scan; the later ones move up by one index."""
        del self.slots[index]
