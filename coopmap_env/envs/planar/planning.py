"""Operations on planar beliefs that only some baselines need."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.elementary import sin_cos_array, tan
from coopmap_env.envs.belief import CameraFrames
from coopmap_env.envs.planar.belief import PlanarBelief
from coopmap_env.envs.planar.foresight import PlanarForesight
from coopmap_env.information import (
    NewInformationCache,
    PlanarExpectedViews,
    PlanarMutualInformation,
    PlanarRatingFunction,
    Ratings,
    ReservedMask,
    ViewContext,
    adjacent_to_unknown,
    entropy,
)
from coopmap_env.robots import ReachableCells, free_mask


class PlanarPlanning:
    """See `Planning`; poses are ids of the `PoseLattice`, and others are a ValueError."""

    unknown_prior = 0.12

    def __init__(self) -> None:
        self._cache: NewInformationCache | None = None

    def mutual_information_fraction(
        self,
        belief: PlanarBelief,
        robot: int,
        pose_ids: NDArray[np.int64],
        prior: float,
        reserved_mask: ReservedMask | None,
    ) -> NDArray[np.float64]:
        """See `PlanarMutualInformation`; a cell at the clamp cannot become more certain."""
        rating, map_ = belief.rating_function, belief.map
        beams = _mutual_information(rating, prior, map_.log_odds_range.max_probability)
        full_view = rating.max_visible_cells * entropy([prior, 1.0 - prior])
        return beams.mutual_information(map_, pose_ids, ViewContext(reserved_mask)) / full_view

    def nearest_frontier_mask(
        self,
        belief: PlanarBelief,
        robot: int,
        pose_ids: NDArray[np.int64],
        shows_unknown: NDArray[np.bool_],
    ) -> NDArray[np.bool_]:
        """All headings at the frontier cell with the shortest path, or at any cell without one."""
        cells = belief.lattice.checked_ids(pose_ids) // belief.lattice.n_headings
        at_frontier = adjacent_to_unknown(belief.map)[cells]
        if at_frontier.any():
            shows_unknown = shows_unknown & at_frontier
        steps = ReachableCells.search(belief.map, belief.cell(robot)).steps[cells]
        far = np.iinfo(steps.dtype).max
        return shows_unknown & (cells == cells[np.argmin(np.where(shows_unknown, steps, far))])

    def expected_unknown_fraction(
        self,
        belief: PlanarBelief,
        robot: int,
        pose_ids: NDArray[np.int64],
        reserved_mask: ReservedMask | None,
    ) -> NDArray[np.float64]:
        """See `PlanarExpectedViews`."""
        views = _expected_views(belief.rating_function)
        cells = views.cells(belief.map, reserved_mask)
        return views.count(cells, pose_ids) / belief.rating_function.max_visible_cells

    def foresight(
        self, belief: PlanarBelief, unknown_occupancy: NDArray[np.float32] | None = None
    ) -> PlanarForesight:
        """See `PlanarForesight` and `PlanarExpectedViews.cells`."""
        views = _expected_views(belief.rating_function)
        return PlanarForesight.of_belief(belief, views, unknown_occupancy)

    def frontier_mask(self, belief: PlanarBelief, robot: int) -> NDArray[np.bool_]:
        """Cells that are known to be free and border on the unknown."""
        mask: NDArray[np.bool_] = adjacent_to_unknown(belief.map) & free_mask(belief.map)
        return mask.reshape(belief.map.grid.shape)

    def frontier_poses(
        self, belief: PlanarBelief, robot: int, clusters: NDArray[np.int32]
    ) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
        """All headings in the cells of the clusters to which known free space leads."""
        regions, flat, n = belief.regions, clusters.ravel(), belief.lattice.n_headings
        is_open = np.isin(regions.labels, regions.access[robot]) & (regions.labels > 0)
        (cells,) = np.nonzero((flat > 0) & is_open)
        return (cells[:, None] * n + np.arange(n)).ravel(), flat[cells].repeat(n)

    def clusters_of_poses(
        self,
        belief: PlanarBelief,
        robot: int,
        pose_ids: NDArray[np.int64],
        clusters: NDArray[np.int32],
    ) -> NDArray[np.int32]:
        """The cluster nearest to the camera, by the longer of dx and dy."""
        from scipy.ndimage import distance_transform_cdt  # a third of a second, seldom needed

        cells = belief.lattice.checked_ids(pose_ids) // belief.lattice.n_headings
        if not clusters.any():
            return np.zeros(len(cells), dtype=np.int32)
        _, (i, j) = distance_transform_cdt(clusters == 0, "chessboard", return_indices=True)
        return clusters[i, j].ravel()[cells]

    def occupied_mask(self, belief: PlanarBelief, robot: int) -> NDArray[np.bool_]:
        """Sampled cells with P >= 1/2."""
        return belief.map.sampled & (belief.map.log_odds_fixed >= 0).reshape(belief.map.grid.shape)

    def camera_frames(
        self, belief: PlanarBelief, robot: int, pose_ids: NDArray[np.int64]
    ) -> CameraFrames:
        """For cameras with a field of view below pi radians."""
        camera = belief.rating_function.camera
        if camera.field_of_view >= np.pi:
            raise ValueError(
                "PlanarCamera.field_of_view must be < pi radians for a projection, got "
                f"{camera.field_of_view}: choose another planner"
            )
        poses = belief.lattice.poses(belief.lattice.checked_ids(pose_ids))
        sines, cosines = sin_cos_array(poses[:, 2])
        rotations = np.stack([cosines, -sines, sines, cosines], axis=-1).reshape(-1, 2, 2)
        tangents = np.array([tan(camera.field_of_view / 2)])
        return CameraFrames(rotations, poses[:, :2], tangents, 0.0, camera.depth_of_field)

    def n_actions(
        self, belief: PlanarBelief, robot: int, pose_ids: NDArray[np.int64]
    ) -> NDArray[np.int64]:
        """By the longer of dx and dy: an action leads to any cell near by, whatever the path."""
        grid, n = belief.map.grid, belief.lattice.n_headings
        x, y = np.divmod(belief.lattice.checked_ids(pose_ids) // n, grid.shape[1])
        x0, y0 = divmod(belief.cell(robot), grid.shape[1])
        longer = np.maximum(abs(x - x0), abs(y - y0)) * grid.resolution
        return np.maximum(np.ceil(longer / belief.reach), 1).astype(np.int64)

    def raster_offset(
        self, belief: PlanarBelief, robot: int, pose_ids: NDArray[np.int64]
    ) -> NDArray[np.int64]:
        """Cell by cell, row by row, and heading by heading in each cell."""
        steps = belief.lattice.checked_ids(pose_ids) - belief.pose_ids[robot] - 1
        return steps % belief.lattice.n_poses

    def prescreen(
        self,
        belief: PlanarBelief,
        pose_ids: NDArray[np.int64],
        score: Callable[[Any, NDArray[np.int64]], NDArray[np.float64]],
    ) -> NDArray[np.int64]:
        """All poses: views of the plane are fast to rate."""
        return pose_ids

    def rate_all(
        self,
        belief: PlanarBelief,
        robot: int,
        pose_ids: NDArray[np.int64],
        reserved_mask: ReservedMask | None,
    ) -> Ratings:
        """`PlanarBelief.rate`; only poses whose views have changed are evaluated again."""
        rating = belief.rating_function
        if self._cache is None or self._cache.rating is not rating:
            self._cache = NewInformationCache(rating)
        ni = self._cache.new_information(belief.map, pose_ids, ViewContext(reserved_mask))
        distance = belief.distance(robot, pose_ids)
        return rating.rate_from_new_information(belief.map, pose_ids, distance, ni)


@lru_cache(maxsize=4)
def _mutual_information(
    rating: PlanarRatingFunction, prior: float, known_probability: float
) -> PlanarMutualInformation:
    return PlanarMutualInformation(rating, prior, known_probability)


@lru_cache(maxsize=4)
def _expected_views(rating: PlanarRatingFunction) -> PlanarExpectedViews:
    return PlanarExpectedViews(rating)
