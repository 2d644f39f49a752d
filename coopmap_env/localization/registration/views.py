"""The scans that a robot has made from one base pose, as arrays for kernels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.linear_algebra import product
from coopmap_env.geometry import RigidTransform
from coopmap_env.localization._depth_rendering import min_neighbour_range
from coopmap_env.robots import PoseEstimate
from coopmap_env.sensing import DepthCamera, PinholeIntrinsics, PointCloud

Array = NDArray[np.float64]


class View(NamedTuple):
    """One scan, and the estimated pose of its camera."""

    cloud: PointCloud
    """A point for each pixel, row by row, in the camera frame; points on robots are filtered."""
    estimate: PoseEstimate
    """T_base_camera with its covariance in the base frame."""


class ViewArrays(NamedTuple):
    """One view of a `ViewBatch`, for kernels; n pixels."""

    points: Array
    """Shape (n, 3): ends of the rays in the camera frame, metres."""
    hit: NDArray[np.bool_]
    """Shape (n,): whether the ray ends at a surface."""
    ranges: Array
    """Shape (n,): metres up to which a ray is clear; 0 where nothing was measured."""
    min_ranges: Array
    """Shape (n,): least range of a pixel and its neighbours, 0 at the border."""
    T_base_camera: RigidTransform


class Beams(NamedTuple):
    """The rays of v views, for the search; n pixels each."""

    min_ranges: Array
    """Shape (v, n): see `ViewArrays`."""
    rotations: Array
    """Shape (v, 3, 3): of T_base_camera."""
    translations: Array
    """Shape (v, 3): of T_base_camera, metres."""
    intrinsics: PinholeIntrinsics
    margin: float
    """Metres by which a ray must pass a point to see through it."""


@dataclass(frozen=True, eq=False)
class ViewBatch:
    """v views of n pixels each, side by side.

    Attributes
    ----------
    points : (v, n, 3) float array
        Ends of the rays in the camera frame, metres.
    hit : (v, n) bool array
        Whether the ray ends at a surface.
    ranges : (v, n) float array
        Metres up to which a ray is clear; 0 where nothing was measured.
    min_ranges : (v, n) float array
        Least range of a pixel and its neighbours, 0 at the border.
    R, t : (v, 3, 3) and (v, 3) float arrays
        T_base_camera.
    covariances : (v, 6, 6) float array
        Of T_base_camera.
    intrinsics : PinholeIntrinsics
    """

    points: Array
    hit: NDArray[np.bool_]
    ranges: Array
    min_ranges: Array
    R: Array
    t: Array
    covariances: Array
    intrinsics: PinholeIntrinsics

    @classmethod
    def from_views(cls, views: Sequence[View], camera: DepthCamera) -> ViewBatch:
        """Stack views.

        Raises
        ------
        ValueError
            If there is no view, or one has not a point for each pixel, a planar pose or a
            covariance that is not (6, 6).
        """
        if not views:
            raise ValueError("a target is registered from at least one view, got none")
        for k, (cloud, (pose, covariance)) in enumerate(views):
            if len(cloud.points) != camera.n_pixels:
                raise ValueError(
                    f"view {k} needs a point for each of {camera.n_pixels} pixels, got "
                    f"{len(cloud.points)}"
                )
            if pose.translation.shape != (3,) or np.shape(covariance) != (6, 6):
                raise ValueError(
                    f"view {k} needs a pose in space with a covariance (6, 6), got "
                    f"{pose.translation.shape} and {np.shape(covariance)}"
                )
        points = np.array([view.cloud.points for view in views], dtype=np.float64)
        ranges = np.linalg.norm(points, axis=-1)
        min_ranges = np.empty_like(ranges)
        for nearest, row in zip(min_ranges, ranges, strict=True):
            min_neighbour_range(row, camera.width, camera.height, nearest)
        return cls(
            points,
            np.array([view.cloud.hit for view in views]),
            ranges,
            min_ranges,
            np.array([view.estimate.pose.rotation for view in views]),
            np.array([view.estimate.pose.translation for view in views]),
            np.array([view.estimate.covariance for view in views], dtype=np.float64),
            camera.intrinsics,
        )

    def __len__(self) -> int:
        return len(self.points)

    def view(self, index: int) -> ViewArrays:
        """The arrays of one view."""
        return ViewArrays(
            self.points[index], self.hit[index], self.ranges[index], self.min_ranges[index],
            RigidTransform(self.R[index], self.t[index]),
        )  # fmt: skip

    def beams(self, margin: float) -> Beams:
        """The rays of all views, with a margin in metres."""
        return Beams(self.min_ranges, self.R, self.t, self.intrinsics, margin)

    def points_in_base(self) -> Array:
        """All measured points (k, 3) in the base frame, metres."""
        points = product(self.points, self.R.transpose(0, 2, 1)) + self.t[:, None]
        return points[self.hit]
