"""ICP: from a hypothesis to the nearest pose in which the points lie on the target."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.extras import import_optional
from coopmap_env.geometry import Pose, nearest_rotation


class Refiner(Protocol):
    """Aligns points with the samples of a surface."""

    def __call__(
        self,
        points: NDArray[np.float64],
        surface_points: NDArray[np.float64],
        T_target_base: Pose,
        max_distance: float,
    ) -> Pose:
        """Align points with a surface.

        Parameters
        ----------
        points : ndarray, shape (n, 3)
            In the base frame, metres.
        surface_points : ndarray, shape (m, 3)
            In the target's frame, metres: samples of the faces that are visible from the base.
        T_target_base : Pose
            Initial estimate.
        max_distance : float
            Metres between a point and the surface at most; points further away are left out.

        Returns
        -------
        Pose
            T_target_base; the initial estimate if too few points are within the distance.
        """


MIN_POINTS = 12
"""Least number of points and samples: two for each degree of freedom."""
N_NORMAL_NEIGHBOURS = 8
"""Samples from which the library estimates a normal: those next to one on a face."""


class SmallGicp:
    """Point-to-plane ICP of small_gicp (Koide 2024), on one thread, so deterministic.

    Raises
    ------
    ImportError
        If the extra "field" is not installed.
    """

    def __init__(self, iterations: int = 15) -> None:
        self.iterations = iterations
        self._small_gicp = import_optional("small_gicp", "field")

    def __call__(
        self,
        points: NDArray[np.float64],
        surface_points: NDArray[np.float64],
        T_target_base: Pose,
        max_distance: float,
    ) -> Pose:
        """See `Refiner`."""
        if len(points) < MIN_POINTS or len(surface_points) < MIN_POINTS:
            return T_target_base
        target = self._small_gicp.PointCloud(surface_points)
        tree = self._small_gicp.KdTree(target)
        self._small_gicp.estimate_normals(target, tree, N_NORMAL_NEIGHBOURS)
        start = np.eye(4)
        start[:3, :3], start[:3, 3] = T_target_base.rotation, T_target_base.translation
        result = self._small_gicp.align(
            target, self._small_gicp.PointCloud(points), tree, start, "PLANE_ICP",
            max_correspondence_distance=max_distance, num_threads=1, max_iterations=self.iterations,
        )  # fmt: skip
        T = np.asarray(result.T_target_source)
        if result.num_inliers < MIN_POINTS or not np.isfinite(T).all():
            return T_target_base
        return Pose(T[:3, 3].copy(), nearest_rotation(T[:3, :3]))
