"""Evaluation of maps against the true surface of a field world.

The evaluator is made once for a world, from the truth. Only scores and figures may use it, never a
planner.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from coopmap_env.evaluation.metrics._surface_samples import sample_surface
from coopmap_env.evaluation.metrics._triangle_distance import TriangleBins
from coopmap_env.evaluation.metrics._visible_surface import N_POSES, visible_points
from coopmap_env.evaluation.metrics.surface_consistency import SurfaceConsistency, surface_chi2
from coopmap_env.evaluation.metrics.surface_scores import (
    SampleVoxels,
    SurfaceScores,
    distance_scores,
    surface_gaussians,
)
from coopmap_env.mapping import OccupancyMap
from coopmap_env.robots import Vehicle
from coopmap_env.sensing import DepthCamera
from coopmap_env.simulation.scenes.field import FieldWorld


class SurfaceEvaluator:
    """Scores maps of one world; `metrics.surface_scores` defines the scores.

    Parameters
    ----------
    world : FieldWorld
        The truth.
    vehicles : sequence of Vehicle
        The robots; what they can see is the visible surface.
    camera : DepthCamera
        The camera of each of them.
    rng : numpy.random.Generator
        Draws the samples of the surface and the poses that define the visible surface.
    n_samples : int
        Points on the surface; the visible ones are scored.
    n_poses : int
        Feasible poses of each vehicle that define the visible surface.
    tau : float, optional
        Metres within which a point counts as correct; one voxel of the world's grid by default.

    Attributes
    ----------
    samples : SurfaceSamples
        All of them.
    visible : ndarray of bool, shape (n_samples,)
        Which of them some pose can see.
    """

    def __init__(
        self,
        world: FieldWorld,
        vehicles: Sequence[Vehicle],
        camera: DepthCamera,
        rng: np.random.Generator,
        n_samples: int = 20_000,
        n_poses: int = N_POSES,
        tau: float | None = None,
    ) -> None:
        self.samples = sample_surface(world, rng, n_samples)
        points = self.samples.points
        self.visible = visible_points(world, vehicles, camera, points, rng, n_poses)
        self.tau = world.grid.resolution if tau is None else float(tau)
        self._points: NDArray[np.float64] = points[self.visible]
        self._cells = SampleVoxels.from_points(self._points, world.grid)
        on_target = points[self.visible & self.samples.is_target]
        self._target_cells = SampleVoxels.from_points(on_target, world.grid)
        self._bins = TriangleBins.from_triangles(world.triangles, world.grid)

    @property
    def sample_voxels(self) -> SampleVoxels:
        """The voxels of the visible samples, whose covered fraction is `coverage`."""
        return self._cells

    def coverage(self, map_: OccupancyMap) -> float:
        """Covered fraction of the visible surface; cheap enough to be computed after each scan."""
        return self._cells.coverage(map_)

    def target_coverage(self, map_: OccupancyMap) -> float:
        """Covered fraction of the target's visible surface."""
        return self._target_cells.coverage(map_)

    def scores(self, map_: OccupancyMap) -> SurfaceScores:
        """All scores; takes about ten milliseconds."""
        means, covariances = surface_gaussians(map_)
        f_score, precision, recall, chamfer = distance_scores(
            means, self._points, self._bins, self.tau
        )
        offsets = self._bins.offsets(means) if len(means) else means
        consistency = SurfaceConsistency.from_chi2(surface_chi2(offsets, covariances))
        return SurfaceScores(
            coverage=self.coverage(map_),
            target_coverage=self.target_coverage(map_),
            f_score=f_score,
            precision=precision,
            recall=recall,
            chamfer=chamfer,
            chi2_median=consistency.median,
            chi2_tail=consistency.tail,
        )
