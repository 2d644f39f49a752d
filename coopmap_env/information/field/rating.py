"""The rating function of the 3-D (field) environment: what a depth camera would see, Eqs. 6 to 9.

How far the mount has to move (Eq. 5) depends on its joints, so the caller gives the distance: see
`joint_distance`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.kernels import PlainTuple
from coopmap_env.geometry import Spheres
from coopmap_env.information.field._view_tables import ViewTables
from coopmap_env.information.field.camera_terms import rate_cameras, write_occupancy
from coopmap_env.information.ratings import (
    WHOLE_VIEW,
    CameraPoses,
    Ratings,
    ReservedMask,
    ViewContext,
)
from coopmap_env.information.settings import FieldRatingSettings, RatingSettings
from coopmap_env.mapping import LogOddsRange, OccupancyMap, VoxelGrid
from coopmap_env.mapping.occluders import ViewedMap
from coopmap_env.mapping.pooling import pool_mask, pooled_grid
from coopmap_env.sensing import DepthCamera


class FieldRatingFunction:
    """Rates camera poses on a known map; planner and reward use the same object.

    Parameters
    ----------
    camera : DepthCamera
    grid : VoxelGrid
        That of the maps to be rated on.
    settings : FieldRatingSettings
    log_odds_range : LogOddsRange
        That of the maps to be rated on.

    Notes
    -----
    A camera outside the grid sees nothing.
    """

    def __init__(
        self,
        camera: DepthCamera,
        grid: VoxelGrid,
        settings: RatingSettings | None = None,
        log_odds_range: LogOddsRange | None = None,
    ) -> None:
        if grid.dimension != 3:
            raise ValueError(f"a depth camera needs a 3-D grid, got {grid}")
        self.camera = camera
        self.grid = grid
        self.settings = settings or FieldRatingSettings()
        self._range = log_odds_range or LogOddsRange()
        self.fine, self.coarse = (
            ViewTables.from_camera(camera, g, self.settings, self._range, grid.resolution)
            for g in (grid, pooled_grid(grid))
        )
        self._no_reservation = np.zeros(grid.n_cells, dtype=np.uint8)
        self._no_pooled_reservation = np.zeros(self.coarse.grid.n_cells, dtype=np.uint8)
        self._sequential_mask = self._no_reservation.copy()
        """For `sequential_new_information`; zeros in between."""

    @property
    def max_visible_cells(self) -> int:
        """N of Eq. 7."""
        return self.fine.frustum.max_visible_cells

    def new_information(
        self, map_: OccupancyMap, poses: CameraPoses, context: ViewContext = WHOLE_VIEW
    ) -> NDArray[np.float64]:
        """NI (Eqs. 6-8) of poses, nats, shape (k,)."""
        return self.new_information_and_unknown(map_, poses, context)[0]

    def count_unknown_cells(
        self, map_: OccupancyMap, poses: CameraPoses, context: ViewContext = WHOLE_VIEW
    ) -> NDArray[np.int64]:
        """Number of never-sampled voxels in view of each pose, shape (k,).

        On the pooled map, eight times the number of blocks.
        """
        return self.new_information_and_unknown(map_, poses, context)[1]

    def new_information_and_unknown(
        self, map_: OccupancyMap, poses: CameraPoses, context: ViewContext = WHOLE_VIEW
    ) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """`new_information` and `count_unknown_cells` of poses, in one pass over the map."""
        tables, viewed, reserved = self.checked_inputs(map_, context.reserved_mask, context.coarse)
        ni, unknown = tables.evaluate(viewed, reserved, poses, context.occluder_spheres)
        return ni, unknown * 8 if context.coarse else unknown

    def visible_cells(
        self,
        map_: OccupancyMap,
        pose: tuple[ArrayLike, ArrayLike],
        context: ViewContext = WHOLE_VIEW,
    ) -> NDArray[np.int32]:
        """Flat indices of the voxels that a pose (R, t) would see on the known map, by column.

        Reserved voxels are included, and the resolution is that of the map.
        """
        tables, viewed, _ = self.checked_inputs(map_)
        return tables.visible_cells(viewed, pose, context.occluder_spheres)

    def visible_weight(
        self,
        map_: OccupancyMap,
        poses: CameraPoses,
        weights: NDArray[np.float32],
        context: ViewContext = WHOLE_VIEW,
    ) -> NDArray[np.float64]:
        """Sum of the weights (n_cells,) of the voxels that each pose would see, shape (k,).

        Voxels that do not count have no weight: the reserved mask is not used. The resolution is
        that of the map, also where the context asks for half of it. Weights have to be finite.

        Raises
        ------
        ValueError
            If the weights are not one float32 for each voxel, or the map does not fit.
        """
        tables, viewed, _ = self.checked_inputs(map_)
        usable = np.ascontiguousarray(weights)
        if usable.shape != (self.grid.n_cells,) or usable.dtype != np.float32:
            raise ValueError(
                f"weights must be float32 of shape ({self.grid.n_cells},), got {usable.dtype} of "
                f"shape {usable.shape}"
            )
        return tables.sum_weights(viewed, usable, poses, context.occluder_spheres)

    def sequential_new_information(
        self,
        map_: OccupancyMap,
        poses: CameraPoses,
        occluder_spheres: Sequence[Spheres | None] | None = None,
    ) -> NDArray[np.float64]:
        """NI of one pose for each robot, without what the robots before it see; (n_robots,).

        `occluder_spheres` are, for each robot, the spheres of its teammates.
        """
        tables, viewed, _ = self.checked_inputs(map_)
        return tables.evaluate_team(viewed, self._sequential_mask, poses, occluder_spheres)

    def rate(
        self,
        map_: OccupancyMap,
        poses: CameraPoses,
        distance: ArrayLike,
        context: ViewContext = WHOLE_VIEW,
    ) -> Ratings:
        """Eq. 9 of poses: RF = (NI - K d**n) (1 - P); `distance` is d of Eq. 5, shape (k,)."""
        ni = self.new_information(map_, poses, context)
        return self.rate_from_new_information(map_, poses, distance, ni)

    def rate_team(
        self,
        map_: OccupancyMap,
        poses: CameraPoses,
        distance: ArrayLike,
        occluder_spheres: Sequence[Spheres | None] | None = None,
    ) -> Ratings:
        """Eq. 9 of one pose for each robot, all scanning at once.

        What a robot sees is reserved for it: the robots after it do not count it, so that an
        overlap counts once.
        """
        ni = self.sequential_new_information(map_, poses, occluder_spheres)
        return self.rate_from_new_information(map_, poses, distance, ni)

    def rate_from_new_information(
        self,
        map_: OccupancyMap,
        poses: CameraPoses,
        distance: ArrayLike,
        new_information: NDArray[np.float64],
    ) -> Ratings:
        """Eq. 9 from new information that is known already.

        Raises
        ------
        ValueError
            If the numbers of poses, distances and values differ, or the map does not fit.
        """
        points = self._points(poses[1])
        if new_information.shape != (len(points),):
            raise ValueError(
                f"{len(points)} poses need as many values of new information, "
                f"got shape {new_information.shape}"
            )
        d = np.asarray(distance, dtype=np.float64)
        if d.shape != new_information.shape:
            d = np.ascontiguousarray(np.broadcast_to(d, new_information.shape))
        out = np.empty((3, len(d)))
        cost_law = float(self.settings.K), float(self.settings.exponent)
        rate_cameras(self._occupancy_tuple(map_), points, cost_law, new_information, d, out)
        return Ratings(new_information, d, *out)

    def occupancy(self, map_: OccupancyMap, translations: ArrayLike) -> NDArray[np.float64]:
        """P of the cell in which each camera (k, 3) would be; 1 outside the grid."""
        points = self._points(translations)
        out = np.empty(len(points))
        write_occupancy(self._occupancy_tuple(map_), points, out)
        return out

    @staticmethod
    def _points(translations: ArrayLike) -> NDArray[np.float64]:
        points = np.ascontiguousarray(translations, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 3:
            raise ValueError(f"translations have the shape (k, 3), got {points.shape}")
        return points

    def _occupancy_tuple(self, map_: OccupancyMap) -> PlainTuple:
        """A map as `write_occupancy` takes it."""
        self._check_map(map_)
        known = map_.log_odds_range
        return map_.log_odds_fixed, known.clamp, known.probability, tuple(self.grid.geometry)

    def checked_inputs(
        self, map_: OccupancyMap, reserved_mask: ReservedMask | None = None, coarse: bool = False
    ) -> tuple[ViewTables, ViewedMap, NDArray[np.uint8]]:
        """The camera, the map and the reserved mask, at full resolution or pooled.

        Kernels trust the map and the mask, so both are checked here.

        Raises
        ------
        ValueError
            If the map is of another grid or clamp, or the mask of another shape or type.
        """
        self._check_map(map_)
        if reserved_mask is None:
            if coarse:
                return self.coarse, map_.viewed(pooled=True), self._no_pooled_reservation
            return self.fine, map_.viewed(), self._no_reservation
        if reserved_mask.shape != self._no_reservation.shape or reserved_mask.dtype != np.uint8:
            raise ValueError(
                f"reserved_mask must be uint8 of shape {self._no_reservation.shape}, "
                f"got {reserved_mask.dtype} of shape {reserved_mask.shape}"
            )
        if coarse:
            return self.coarse, map_.viewed(pooled=True), pool_mask(reserved_mask, self.grid)
        return self.fine, map_.viewed(), reserved_mask

    def _check_map(self, map_: OccupancyMap) -> None:
        if map_.grid != self.grid or map_.log_odds_range.clamp != self._range.clamp:
            raise ValueError(
                f"the map ({map_.grid}, clamp {map_.log_odds_range.clamp}) does not fit this "
                f"rating function ({self.grid}, clamp {self._range.clamp})"
            )
