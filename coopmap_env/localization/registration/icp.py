"""From a hypothesis to the nearest pose in which the points fit, by a library's ICP."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.extras import import_optional
from coopmap_env.geometry.rotations import nearest_rotation
from coopmap_env.geometry.transforms import Pose


class Refiner(Protocol):
    """Whatever aligns points with the samples of a surface."""

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
        surface : ndarray, shape (m, 3)
            In the target's frame, metres: samples of what can be seen from the base.
        T_target_base : Pose
            Where to begin.
        reach : float
            Metres between a point and the surface at most; points further away are left out.

        Returns
        -------
        Pose
            T_target_base; the one that was given if too few points are within reach.
        """


MIN_POINTS = 12
"""Points and samples: two for each degree of freedom."""
N_NORMAL_NEIGHBOURS = 8
"""Samples of which the library takes a normal: those next to one on a face."""


class SmallGicp:
    """Point-to-plane ICP of small_gicp (Koide 2024), on one thread and so the same at each call.

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
