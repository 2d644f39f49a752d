"""The looks that a robot has made from where it stands, side by side for the kernels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.localization.depth_rendering import (
    PinholeIntrinsics,
    min_neighbour_range,
    pinhole_intrinsics,
)
from coopmap_env.robots.vehicle import PoseEstimate
from coopmap_env.sensing.depth_camera import DepthCamera
from coopmap_env.sensing.point_cloud import PointCloud


class View(NamedTuple):
    """One look, and where the robot believes that its camera was."""

    cloud: PointCloud
    """A pixel each, row by row, in the camera frame; what is seen of robots is taken out."""
    estimate: PoseEstimate
    """T_base_camera with its covariance in the base frame."""


@dataclass(frozen=True, eq=False)
class ViewBatch:
    """v looks of n pixels each as arrays.

    Attributes
    ----------
    points : (v, n, 3) float array
        Ends of the beams in the camera frame, metres.
    hit : (v, n) bool array
    ranges : (v, n) float array
        Metres up to which each beam is clear; 0 where it says nothing.
    around : (v, n) float array
        The least range of a pixel and its neighbours, 0 at the border.
    R, t : (v, 3, 3) and (v, 3) float arrays
        T_base_camera.
    covariances : (v, 6, 6) float array
        Of T_base_camera.
    lens : tuple
        See `pinhole_intrinsics`.
    """

    points: NDArray[np.float64]
    hit: NDArray[np.bool_]
    ranges: NDArray[np.float64]
    min_ranges: NDArray[np.float64]
    R: NDArray[np.float64]
    t: NDArray[np.float64]
    covariances: NDArray[np.float64]
    intrinsics: PinholeIntrinsics

    @classmethod
    def from_views(cls, views: Sequence[View], camera: DepthCamera) -> ViewBatch:
        """Put looks side by side.

        Raises
        ------
        ValueError
            If there is no look, or one has not a point for each pixel, a planar pose or a
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
        ranges = np.sqrt(np.einsum("vni,vni->vn", points, points))
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
            pinhole_intrinsics(camera),
        )

    def __len__(self) -> int:
        return len(self.points)

    def points_in_base(self) -> NDArray[np.float64]:
        """All measured points (k, 3) in the base frame, metres."""
        points = np.einsum("vij,vnj->vni", self.R, self.points) + self.t[:, None]
        return points[self.hit]
