"""Earlier looks that later ones are held against, side by side in memory."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.geometry import Pose
from coopmap_env.localization.correction.surface_normals import surface_normals
from coopmap_env.sensing import DepthCamera, PointCloud, RangeNoise

Array = NDArray[np.float64]


class ScanSurfaces(NamedTuple):
    """What one look saw, in the camera frame; n pixels, row by row."""

    points: Array
    """Shape (n, 3), metres."""
    normals: Array
    """Shape (n, 3), see `SurfaceNormals`."""
    planar: NDArray[np.bool_]
    normal_variances: Array
    deviations: Array
    """Shape (n,): S T_depth d^n of Eq. 1, metres; 0 where nothing was measured."""

    @classmethod
    def from_cloud(cls, cloud: PointCloud, camera: DepthCamera, noise: RangeNoise) -> ScanSurfaces:
        """The surfaces of a look."""
        points = np.ascontiguousarray(cloud.points, dtype=np.float64)
        normals, normal_variances, planar = surface_normals(cloud, camera, noise)
        distances = np.sqrt(np.einsum("ni,ni->n", points, points))
        sigma = noise.intrinsic * noise.depth * distances**noise.exponent
        deviations = np.where(cloud.hit, np.maximum(sigma, 1e-6), 0.0)
        return cls(points, normals, planar, normal_variances, deviations)


class KeyframeBuffer:
    """Room for a number of looks; each lies in a slot, in which kernels find it.

    Parameters
    ----------
    capacity : int
    n_pixels : int
    """

    def __init__(self, capacity: int, n_pixels: int) -> None:
        c, n = capacity, n_pixels
        self.surfaces = ScanSurfaces(
            np.zeros((c, n, 3)), np.zeros((c, n, 3)), np.zeros((c, n), dtype=np.bool_),
            np.zeros((c, n)), np.zeros((c, n)),
        )  # fmt: skip
        """Those of all looks, with the slot as the first axis."""
        self.rotations, self.translations = np.zeros((c, 3, 3)), np.zeros((c, 3))
        """T_world_camera by slot."""
        self.slots: list[int] = []
        """Of each look that is kept, in the order in which they were made."""

    def __len__(self) -> int:
        return len(self.slots)

    def add(self, scan: ScanSurfaces) -> None:
        """Keep one more look.

        Raises
        ------
        ValueError
            If there is no room left.
        """
        free = set(range(len(self.translations))) - set(self.slots)
        if not free:
            raise ValueError(f"no room for more than {len(self.slots)} looks: remove one first")
        slot = min(free)
        for stored, new in zip(self.surfaces, scan, strict=True):
            stored[slot] = new
        self.slots.append(slot)

    def set_camera_poses(self, cameras: list[Pose]) -> None:
        """Say where the cameras of all looks are taken to be, in their order."""
        for slot, camera in zip(self.slots, cameras, strict=True):
            self.rotations[slot], self.translations[slot] = camera.rotation, camera.translation

    def remove(self, index: int) -> None:
        """Give up a look; the later ones move up."""
        del self.slots[index]
