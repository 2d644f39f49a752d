"""Fiducials on the known target, whose geometry is exact (Section 2.1).

Its surface is divided into patches, each around one of evenly spaced points. A pixel belongs to the
nearest of them, unless its point is far from the surface that it should see there, the measured
normal differs, or the surface is seen at a grazing angle.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import inlined_kernel, kernel
from coopmap_env.geometry import Pose, RigidTransform
from coopmap_env.localization._depth_rendering import DepthImage, render_depth
from coopmap_env.localization.correction._keyframes import ScanSurfaces
from coopmap_env.localization.target import TargetModel, TargetPlanes
from coopmap_env.sensing import PinholeIntrinsics

Array = NDArray[np.float64]

MAX_DEPTH_RESIDUAL = 0.1
"""Metres along a ray, besides 3 sigma, by which a pixel may miss the surface it should see."""
MIN_INCIDENCE_COSINE = 0.15
"""Least cosine between a surface's normal and the ray. At a grazing angle a small error of the pose
decides whether a pixel is on a face or on the next one."""
MIN_FACE_COSINE = 0.8
"""Least cosine between the normal of the target's face and the measured one."""


class PixelPlanes(NamedTuple):
    """The target's plane that each of n pixels should see."""

    normals: Array
    """Shape (n, 3): unit normals, world frame; 0 for none."""
    points: Array
    """Shape (n, 3): a point of the plane, world frame, metres; 0 for none."""

    @classmethod
    def zeros(cls, n_pixels: int) -> PixelPlanes:
        """No plane for any pixel."""
        return cls(np.zeros((n_pixels, 3)), np.zeros((n_pixels, 3)))


class KnownTarget:
    """A target at its known pose, for one camera.

    Parameters
    ----------
    model : TargetModel
        In the world frame, which is the target's.
    intrinsics : PinholeIntrinsics
    spacing : float
        Metres between fiducials.
    """

    def __init__(self, model: TargetModel, intrinsics: PinholeIntrinsics, spacing: float) -> None:
        self.model = model
        self._intrinsics = intrinsics
        self.centers = _one_per_cube(model.samples[0], spacing)
        """Fiducials (k, 3) on the target."""
        self._image = DepthImage.empty(intrinsics.width * intrinsics.height)

    def label_pixels(
        self,
        T_world_camera: Pose,
        scan: ScanSurfaces,
        first_label: int,
        labels: NDArray[np.int32],
        planes: PixelPlanes,
    ) -> None:
        """Fill the planes, and overwrite the labels (n,) of pixels that see the target.

        Parameters
        ----------
        T_world_camera : Pose
        scan : ScanSurfaces
            Camera frame.
        first_label : int
            Label of the target's first fiducial.
        labels : ndarray, shape (n,)
            Changed in place; those of other pixels stay.
        planes : PixelPlanes
            Filled in place; zeros for other pixels.
        """
        T_camera_world = T_world_camera.inverse().arrays
        render_depth(self.model.triangles, T_camera_world, self._intrinsics, self._image)
        label_target_pixels(
            scan, self._image, self.model.planes, self.centers, T_world_camera.arrays,
            first_label, labels, planes,
        )  # fmt: skip


def _one_per_cube(points: Array, spacing: float) -> Array:
    """Of the points (n, 3) in each cube of a grid, the one nearest to their centroid."""
    _, cube = np.unique(np.floor(points / spacing), axis=0, return_inverse=True)
    cube = cube.ravel()
    sums = np.stack([np.bincount(cube, points[:, i]) for i in range(3)], axis=1)
    centroids = sums / np.bincount(cube)[:, None]
    distances = np.linalg.norm(points - centroids[cube], axis=1)
    order = np.lexsort((distances, cube))
    _, first = np.unique(cube[order], return_index=True)
    return np.ascontiguousarray(points[order[first]])


@kernel
def label_target_pixels(
    scan: ScanSurfaces,
    image: DepthImage,
    planes: TargetPlanes,
    centers: Array,
    T_world_camera: RigidTransform,
    first_label: int,
    labels: NDArray[np.int32],
    pixel_planes: PixelPlanes,
) -> None:
    """See `KnownTarget.label_pixels`; the image is what `render_depth` filled."""
    R, t = T_world_camera
    points = scan.points
    q = np.empty(3)
    for k in range(len(points)):
        for i in range(3):
            pixel_planes.normals[k, i] = 0.0
            pixel_planes.points[k, i] = 0.0
        m = image.triangle_index[k]
        if m < 0 or scan.deviations[k] == 0.0:
            continue
        if abs(points[k, 0] - image.depth[k]) > MAX_DEPTH_RESIDUAL + 3.0 * scan.deviations[k]:
            continue
        n = planes.normals[m]
        facing, distance = 0.0, 0.0
        for i in range(3):
            for j in range(3):
                facing -= n[i] * R[i, j] * points[k, j]
            distance += points[k, i] * points[k, i]
        if facing < MIN_INCIDENCE_COSINE * math.sqrt(distance):
            continue
        if scan.planar[k]:
            cosine = 0.0
            for i in range(3):
                for j in range(3):
                    cosine += n[i] * R[i, j] * scan.normals[k, j]
            if cosine < MIN_FACE_COSINE:
                continue
        for i in range(3):
            q[i] = t[i]
            for j in range(3):
                q[i] += R[i, j] * points[k, j]
        labels[k] = first_label + _nearest(centers, q)
        for i in range(3):
            pixel_planes.normals[k, i] = n[i]
            pixel_planes.points[k, i] = planes.points[m, i]


@inlined_kernel
def _nearest(centers: Array, q: Array) -> int:
    """Index of the center (k, 3) that is nearest to a point (3,)."""
    least, nearest = np.inf, -1
    for c in range(len(centers)):
        square = (
            (centers[c, 0] - q[0]) ** 2 + (centers[c, 1] - q[1]) ** 2 + (centers[c, 2] - q[2]) ** 2
        )
        if square < least:
            least, nearest = square, c
    return nearest
