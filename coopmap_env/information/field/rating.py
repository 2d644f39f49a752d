"""The rating function in space: what a depth camera would see on the known map, Eqs. 6 to 9.

Camera poses come as rotations R_world_camera (k, 3, 3) and translations (k, 3), metres. How far the
mount has to move (Eq. 5) is the caller's to say, as it depends on the joints: see `joint_distance`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.information.field.pooling import pool, pooled_grid
from coopmap_env.information.field.view_tables import Known, Sight, Spheres
from coopmap_env.information.field.views import histogram_of_view, mark
from coopmap_env.information.planar.rating import Ratings
from coopmap_env.information.settings import FieldRatingSettings, RatingConstants
from coopmap_env.mapping import LogOddsRange, OccupancyMap, VoxelGrid
from coopmap_env.sensing import DepthCamera

Claimed = NDArray[np.uint8] | None


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
    `claimed` (n_cells,) holds 1 at cells that a teammate is about to see: they are left out.
    `bodies` are spheres that cover the other robots: they hide what is behind them. With `coarse`,
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
            Sight.of(camera, g, self.settings, self._range, grid.resolution)
            for g in (grid, pooled_grid(grid))
        )
        self._nobody = np.zeros(grid.n_cells, dtype=np.uint8)
        self._claimed = self._nobody.copy()
        """For `new_information_in_turn`; empty in between."""

    @property
    def n_visible(self) -> int:
        """N of Eq. 7."""
        return self.fine.frustum.n_visible

    def new_information(
        self,
        map_: OccupancyMap,
        rotations: ArrayLike,
        translations: ArrayLike,
        claimed: Claimed = None,
        bodies: Spheres | None = None,
        coarse: bool = False,
    ) -> NDArray[np.float64]:
        """NI (Eqs. 6-8) of poses, nats, shape (k,)."""
        return self.views(map_, rotations, translations, claimed, bodies, coarse)[0]

    def unknown_cells(
        self,
        map_: OccupancyMap,
        rotations: ArrayLike,
        translations: ArrayLike,
        claimed: Claimed = None,
        bodies: Spheres | None = None,
        coarse: bool = False,
    ) -> NDArray[np.int64]:
        """Number of never-sampled cells in view of each pose, shape (k,).

        With `coarse`, eight times the number of blocks.
        """
        return self.views(map_, rotations, translations, claimed, bodies, coarse)[1]

    def views(
        self,
        map_: OccupancyMap,
        rotations: ArrayLike,
        translations: ArrayLike,
        claimed: Claimed = None,
        bodies: Spheres | None = None,
        coarse: bool = False,
    ) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """`new_information` and `unknown_cells` of poses, from one look at the map."""
        sight, known = self.sight(map_, claimed, coarse)
        histogram = sight.histograms(known, *checked_poses(rotations, translations), bodies)
        unknown = histogram[:, sight.n_gray :].sum(axis=1) * (8 if coarse else 1)
        return sight.entropies(histogram), np.asarray(unknown)

    def visible_cells(
        self,
        map_: OccupancyMap,
        rotation: ArrayLike,
        translation: ArrayLike,
        bodies: Spheres | None = None,
    ) -> NDArray[np.int32]:
        """Flat numbers of the cells that a pose would see on the known map, column by column."""
        sight, known = self.sight(map_)
        (R,), (t,) = checked_poses(np.asarray(rotation)[None], np.asarray(translation)[None])
        return sight.view(known, R, t, bodies)[0]

    def new_information_in_turn(
        self,
        map_: OccupancyMap,
        rotations: ArrayLike,
        translations: ArrayLike,
        bodies: Sequence[Spheres | None] | None = None,
    ) -> NDArray[np.float64]:
        """NI of one pose for each robot, without what the robots before it see; shape (n_robots,).

        `bodies` holds the spheres that hide the view of each robot: those of its teammates.
        """
        R, t = checked_poses(rotations, translations)
        sight, known = self.sight(map_, self._claimed)
        histogram = np.zeros((len(R), 2 * sight.n_gray), dtype=np.int64)
        views = []
        try:
            for robot in range(len(R)):
                seen = sight.view(known, R[robot], t[robot], bodies[robot] if bodies else None)
                histogram_of_view(known, *seen, sight.tables, histogram[robot])
                views.append(seen[0])
                mark(self._claimed, seen[0], 1)
        finally:
            for cells in views:
                mark(self._claimed, cells, 0)
        return sight.entropies(histogram)

    def rate(
        self,
        map_: OccupancyMap,
        rotations: ArrayLike,
        translations: ArrayLike,
        distance: ArrayLike,
        claimed: Claimed = None,
        bodies: Spheres | None = None,
        coarse: bool = False,
    ) -> Ratings:
        """Eq. 9 of poses: RF = (NI - K d**n) (1 - P); `distance` is d of Eq. 5, shape (k,)."""
        ni = self.new_information(map_, rotations, translations, claimed, bodies, coarse)
        return self.compose(map_, translations, distance, ni)

    def rate_team(
        self,
        map_: OccupancyMap,
        rotations: ArrayLike,
        translations: ArrayLike,
        distance: ArrayLike,
        bodies: Sequence[Spheres | None] | None = None,
    ) -> Ratings:
        """Eq. 9 of one pose for each robot, looking at once.

        What a robot sees is left out of the histograms of the robots after it, so that an overlap
        counts once.
        """
        ni = self.new_information_in_turn(map_, rotations, translations, bodies)
        return self.compose(map_, translations, distance, ni)

    def compose(
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
        levels = map_.levels[self.grid.flat(index[inside])]
        p[inside] = map_.range.probability[levels + map_.range.clamp]
        return p

    def sight(
        self, map_: OccupancyMap, claimed: Claimed = None, coarse: bool = False
    ) -> tuple[Sight, Known]:
        """The camera and what is known, at the map's own resolution or pooled.

        Kernels trust the map and `claimed`, so both are checked here.

        Raises
        ------
        ValueError
            If the map is of another grid or clamp, or `claimed` of another shape or type.
        """
        if map_.grid != self.grid or map_.range.clamp != self._range.clamp:
            raise ValueError(
                f"the map ({map_.grid}, clamp {map_.range.clamp}) is not of the kind that is rated "
                f"here ({self.grid}, clamp {self._range.clamp})"
            )
        if claimed is None:
            claimed = self._nobody
        elif claimed.shape != self._nobody.shape or claimed.dtype != np.uint8:
            raise ValueError(
                f"claimed must be uint8 of shape {self._nobody.shape}, "
                f"got {claimed.dtype} of shape {claimed.shape}"
            )
        if coarse:
            pooled = pool(map_.levels, map_.sampled_cells, claimed, self.grid)
            return self.coarse, (*pooled, self.coarse.grid.shape)
        return self.fine, (map_.levels, map_.sampled_cells, claimed, self.grid.shape)


def checked_poses(
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
