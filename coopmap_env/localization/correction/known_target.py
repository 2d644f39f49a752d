"""The known target as fiducials: its geometry is as certain as nothing else in view (2.1).

Its surface is divided into patches, each around one of evenly spaced points. A pixel belongs to the
one nearest to what it should see there, unless what it measures lies far from that, faces another
way, or is seen edge-on.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from coopmap_env.geometry import Pose
from coopmap_env.localization.depth_rendering import PinholeIntrinsics, render_depth
from coopmap_env.localization.target import TargetModel

MAX_DEPTH_RESIDUAL = 0.1
"""Metres along a beam, besides 3 sigma, by which a pixel may miss the surface it should see."""
MIN_INCIDENCE_COSINE = 0.15
"""Least cosine between a surface's normal and the beam: of a face that is seen edge-on, a small
error of the pose decides whether a pixel is on it or on the next one, and it would tell of what is
not seen at all."""


class KnownTarget:
    """A target where it is known to stand, for one camera.

    Parameters
    ----------
    model : TargetModel
        In the world frame, which is the target's.
    lens : tuple
        See `pinhole_intrinsics`.
    spacing : float
        Metres between fiducials.
    """

    def __init__(self, model: TargetModel, intrinsics: PinholeIntrinsics, spacing: float) -> None:
        self.model = model
        self._intrinsics = intrinsics
        self.centers = _one_per_cube(model.samples[0], spacing)
        """Fiducials (k, 3) on the target."""
        n = intrinsics[0] * intrinsics[1]
        self._depth, self._triangle_index = np.empty(n), np.empty(n, dtype=np.int64)

    def label_pixels(
        self,
        camera: Pose,
        points: NDArray[np.float64],
        normals: NDArray[np.float64],
        planar: NDArray[np.bool_],
        deviations: NDArray[np.float64],
        first_label: int,
        labels: NDArray[np.int32],
        target_planes: NDArray[np.float64],
    ) -> None:
        """Fill `target_planes` (n, 6) and overwrite the labels (n,) of pixels that see the target.

        Parameters
        ----------
        camera : Pose
            T_world_camera.
        points, normals : ndarray, shape (n, 3)
            Of the look, camera frame.
        planar, deviations : ndarray, shape (n,)
            See `surface_normals`; S T_depth d^n of Eq. 1.
        first_label : int
            Of the target's fiducials.
        """
        T = camera.inverse()
        R, t = np.ascontiguousarray(T.rotation), np.ascontiguousarray(T.translation)
        render_depth(
            self.model.triangles, R, t, self._intrinsics, self._depth, self._triangle_index
        )
        label_target_pixels(
            points, normals, planar, deviations, self._depth, self._triangle_index, self._intrinsics,
            self.model.normals, self.model.plane_points, self.centers, camera.rotation,
            camera.translation, first_label, labels, target_planes,
        )  # fmt: skip


def _one_per_cube(points: NDArray[np.float64], spacing: float) -> NDArray[np.float64]:
    """The middle one of the points (n, 3) in each cube of the grid of that spacing."""
    _, cube = np.unique(np.floor(points / spacing), axis=0, return_inverse=True)
    cube = cube.ravel()
    count = np.bincount(cube)
    centroids = (
        np.stack([np.bincount(cube, points[:, i]) for i in range(3)], axis=1) / count[:, None]
    )
    distances = np.linalg.norm(points - centroids[cube], axis=1)
    order = np.lexsort((distances, cube))
    _, first = np.unique(cube[order], return_index=True)
    return np.ascontiguousarray(points[order[first]])


@njit(cache=True, nogil=True)
def label_target_pixels(
    points, normals, planar, deviations, depth, triangle_index, intrinsics, plane_normals, plane_points, centers,
    R, t, first_label, labels, target_planes,
):  # fmt: skip
    """`KnownTarget.label_pixels`, with what `render_depth` filled."""
    width, height, _, _ = intrinsics
    q = np.empty(3)
    for row in range(height):
        for column in range(width):
            k = row * width + column
            target_planes[k] = 0.0
            m = triangle_index[k]
            if m < 0:
                continue
            if deviations[k] == 0.0:
                continue
            if abs(points[k, 0] - depth[k]) > MAX_DEPTH_RESIDUAL + 3.0 * deviations[k]:
                continue
            n = plane_normals[m]
            facing, distance = 0.0, 0.0
            for i in range(3):
                for j in range(3):
                    facing -= n[i] * R[i, j] * points[k, j]
                distance += points[k, i] * points[k, i]
            if facing < MIN_INCIDENCE_COSINE * math.sqrt(distance):
                continue
            if planar[k]:
                cosine = 0.0
                for i in range(3):
                    for j in range(3):
                        cosine += n[i] * R[i, j] * normals[k, j]
                if cosine < 0.8:
                    continue
            for i in range(3):
                q[i] = t[i]
                for j in range(3):
                    q[i] += R[i, j] * points[k, j]
            nearest, best = np.inf, -1
            for c in range(len(centers)):
                d = (
                    (centers[c, 0] - q[0]) ** 2
                    + (centers[c, 1] - q[1]) ** 2
                    + (centers[c, 2] - q[2]) ** 2
                )
                if d < nearest:
                    nearest, best = d, c
            labels[k] = first_label + best
            for i in range(3):
                target_planes[k, i] = n[i]
                target_planes[k, 3 + i] = plane_points[m, i]
