"""The rating function in space: what a depth camera would see on the known map, Eqs. 6 to 9.

Camera poses come as rotations R_world_camera (k, 3, 3) and translations (k, 3), metres. How far the
mount has to move (Eq. 5) is the caller's to say, as it depends on the joints: see `joint_distance`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.information.field.pooling import pool, pooled_grid
from coopmap_env.information.field.view_tables import MapArrays, Spheres, ViewTables
from coopmap_env.information.field.views import fill_mask, view_histogram
from coopmap_env.information.planar.rating import Ratings
from coopmap_env.information.settings import FieldRatingSettings, RatingConstants
from coopmap_env.mapping import LogOddsRange, OccupancyMap, VoxelGrid
from coopmap_env.sensing import DepthCamera

ReservedMask = NDArray[np.uint8] | None


class FieldRatingFunction:
    """Rates camera poses on a known map in space; one object serves planner and reward alike.

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
    `reserved_mask` (n_cells,) holds 1 at cells that a teammate is about to see: they are left out.
    `occluder_spheres` are spheres that cover the other robots: they hide what is behind them. With `coarse`,
    views are taken on the map pooled to half its resolution: four to five times as fast.
    A camera outside the grid sees nothing.
    """

    def __init__(
        self,
        camera: DepthCamera,
        grid: VoxelGrid,
        settings: RatingConstants | None = None,
        log_odds_range: LogOddsRange | None = None,
    ) -> None:
        if grid.dimension != 3:
            raise ValueError(f"a depth camera needs a grid in space, got {grid}")
        self.camera = camera
        self.grid = grid
        self.settings = settings or FieldRatingSettings()
        self._range = log_odds_range or LogOddsRange()
        self.fine, self.coarse = (
            ViewTables.from_camera(camera, g, self.settings, self._range, grid.resolution)
            for g in (grid, pooled_grid(grid))
        )
        self._no_reservation = np.zeros(grid.n_cells, dtype=np.uint8)
        self._in_turn_mask = self._no_reservation.copy()
        """For `sequential_new_information`; empty in between."""

    @property
    def max_visible_cells(self) -> int:
        """N of Eq. 7."""
        return self.fine.frustum.max_visible_cells

    def new_information(
        self,
        map_: OccupancyMap,
        rotations: ArrayLike,
        translations: ArrayLike,
        reserved_mask: ReservedMask = None,
        occluder_spheres: Spheres | None = None,
        coarse: bool = False,
    ) -> NDArray[np.float64]:
        """NI (Eqs. 6-8) of poses, nats, shape (k,)."""
        return self.information_and_unknown(
            map_, rotations, translations, reserved_mask, occluder_spheres, coarse
        )[0]

    def count_unknown_cells(
        self,
        map_: OccupancyMap,
        rotations: ArrayLike,
        translations: ArrayLike,
        reserved_mask: ReservedMask = None,
        occluder_spheres: Spheres | None = None,
        coarse: bool = False,
    ) -> NDArray[np.int64]:
        """Number of never-sampled cells in view of each pose, shape (k,).

        With `coarse`, eight times the number of blocks.
        """
        return self.information_and_unknown(
            map_, rotations, translations, reserved_mask, occluder_spheres, coarse
        )[1]

    def information_and_unknown(
        self,
        map_: OccupancyMap,
        rotations: ArrayLike,
        translations: ArrayLike,
        reserved_mask: ReservedMask = None,
        occluder_spheres: Spheres | None = None,
        coarse: bool = False,
    ) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """`new_information` and `count_unknown_cells` of poses, from one look at the map."""
        view_tables, map_arrays = self.view_tables(map_, reserved_mask, coarse)
        histogram = view_tables.histograms(
            map_arrays, *validate_camera_poses(rotations, translations), occluder_spheres
        )
        unknown = histogram[:, view_tables.n_gray_bins :].sum(axis=1) * (8 if coarse else 1)
        return view_tables.entropies(histogram), np.asarray(unknown)

    def visible_cells(
        self,
        map_: OccupancyMap,
        rotation: ArrayLike,
        translation: ArrayLike,
        occluder_spheres: Spheres | None = None,
    ) -> NDArray[np.int32]:
        """Flat numbers of the cells that a pose would see on the known map, column by column."""
        view_tables, map_arrays = self.view_tables(map_)
        (R,), (t,) = validate_camera_poses(
            np.asarray(rotation)[None], np.asarray(translation)[None]
        )
        return view_tables.view(map_arrays, R, t, occluder_spheres)[0]

    def sequential_new_information(
        self,
        map_: OccupancyMap,
        rotations: ArrayLike,
        translations: ArrayLike,
        occluder_spheres: Sequence[Spheres | None] | None = None,
    ) -> NDArray[np.float64]:
        """NI of one pose for each robot, without what the robots before it see; shape (n_robots,).

        `occluder_spheres` holds the spheres that hide the view of each robot: those of its teammates.
        """
        R, t = validate_camera_poses(rotations, translations)
        view_tables, map_arrays = self.view_tables(map_, self._in_turn_mask)
        histogram = np.zeros((len(R), 2 * view_tables.n_gray_bins), dtype=np.int64)
        views = []
        try:
            for robot in range(len(R)):
                seen = view_tables.view(
                    map_arrays,
                    R[robot],
                    t[robot],
                    occluder_spheres[robot] if occluder_spheres else None,
                )
                view_histogram(map_arrays, *seen, view_tables.tables, histogram[robot])
                views.append(seen[0])
                fill_mask(self._in_turn_mask, seen[0], 1)
        finally:
            for cells in views:
                fill_mask(self._in_turn_mask, cells, 0)
        return view_tables.entropies(histogram)

    def rate(
        self,
        map_: OccupancyMap,
        rotations: ArrayLike,
        translations: ArrayLike,
        distance: ArrayLike,
        reserved_mask: ReservedMask = None,
        occluder_spheres: Spheres | None = None,
        coarse: bool = False,
    ) -> Ratings:
        """Eq. 9 of poses: RF = (NI - K d**n) (1 - P); `distance` is d of Eq. 5, shape (k,)."""
        ni = self.new_information(
            map_, rotations, translations, reserved_mask, occluder_spheres, coarse
        )
        return self.rate_from_information(map_, translations, distance, ni)

    def rate_team(
        self,
        map_: OccupancyMap,
        rotations: ArrayLike,
        translations: ArrayLike,
        distance: ArrayLike,
        occluder_spheres: Sequence[Spheres | None] | None = None,
    ) -> Ratings:
        """Eq. 9 of one pose for each robot, looking at once.

        What a robot sees is left out of the histograms of the robots after it, so that an overlap
        counts once.
        """
        ni = self.sequential_new_information(map_, rotations, translations, occluder_spheres)
        return self.rate_from_information(map_, translations, distance, ni)

    def rate_from_information(
        self,
        map_: OccupancyMap,
        translations: ArrayLike,
        distance: ArrayLike,
        ni: NDArray[np.float64],
    ) -> Ratings:
        """Eq. 9 from new information that is known already."""
        d = np.broadcast_to(np.asarray(distance, dtype=np.float64), ni.shape)
        return Ratings.of(ni, d, self.occupancy(map_, translations), self.settings)

    def occupancy(self, map_: OccupancyMap, translations: ArrayLike) -> NDArray[np.float64]:
        """P of the cell in which each camera (k, 3) would be; 1 outside the grid."""
        index = self.grid.index(translations)
        inside = self.grid.contains(index)
        p = np.ones(len(index))
        log_odds_fixed = map_.log_odds_fixed[self.grid.flat_index(index[inside])]
        p[inside] = map_.log_odds_range.probability[log_odds_fixed + map_.log_odds_range.clamp]
        return p

    def view_tables(
        self, map_: OccupancyMap, reserved_mask: ReservedMask = None, coarse: bool = False
    ) -> tuple[ViewTables, MapArrays]:
        """The camera and what is known, at the map's own resolution or pooled.

        Kernels trust the map and `reserved_mask`, so both are checked here.

        Raises
        ------
        ValueError
            If the map is of another grid or clamp, or `reserved_mask` of another shape or type.
        """
        if map_.grid != self.grid or map_.log_odds_range.clamp != self._range.clamp:
            raise ValueError(
                f"the map ({map_.grid}, clamp {map_.log_odds_range.clamp}) is not of the kind that is rated "
                f"here ({self.grid}, clamp {self._range.clamp})"
            )
        if reserved_mask is None:
            reserved_mask = self._no_reservation
        elif reserved_mask.shape != self._no_reservation.shape or reserved_mask.dtype != np.uint8:
            raise ValueError(
                f"reserved_mask must be uint8 of shape {self._no_reservation.shape}, "
                f"got {reserved_mask.dtype} of shape {reserved_mask.shape}"
            )
        if coarse:
            pooled = pool(map_.log_odds_fixed, map_.sampled_mask, reserved_mask, self.grid)
            return self.coarse, (*pooled, self.coarse.grid.shape)
        return self.fine, (map_.log_odds_fixed, map_.sampled_mask, reserved_mask, self.grid.shape)


def validate_camera_poses(
    rotations: ArrayLike, translations: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Poses as contiguous arrays (k, 3, 3) and (k, 3).

    Raises
    ------
    ValueError
        If the shapes do not fit, or a value is not finite.
    """
    R = np.ascontiguousarray(rotations, dtype=np.float64)
    t = np.ascontiguousarray(translations, dtype=np.float64)
    if t.ndim != 2 or t.shape[1] != 3 or R.shape != (len(t), 3, 3):
        raise ValueError(
            "camera poses are rotations (k, 3, 3) and translations (k, 3), "
            f"got shapes {R.shape} and {t.shape}"
        )
    if not (np.isfinite(R).all() and np.isfinite(t).all()):
        raise ValueError("a camera pose has a value that is not finite")
    return R, t
