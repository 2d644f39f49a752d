"""The rating function of the 2-D (planar) environment: Eqs. 5 to 9."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.kernels import kernel
from coopmap_env.information.gray_levels import GrayLevelTable
from coopmap_env.information.planar.cell_codes import CodeTable
from coopmap_env.information.planar.view_arrays import ViewTables
from coopmap_env.information.planar.view_calls import (
    evaluate_coded_poses,
    evaluate_poses,
    evaluate_team,
    find_visible_cells,
)
from coopmap_env.information.ratings import (
    WHOLE_VIEW,
    Ratings,
    ReservedMask,
    ViewContext,
    write_ratings,
)
from coopmap_env.information.settings import PlanarRatingSettings
from coopmap_env.mapping import LogOddsRange, OccupancyMap
from coopmap_env.robots import PoseLattice
from coopmap_env.sensing import BeamFan, PlanarCamera

NOTHING_RESERVED: ReservedMask = np.zeros(0, dtype=np.uint8)


class PlanarRatingFunction:
    """Rates lattice poses on a known map; planner and reward use the same object.

    Parameters
    ----------
    camera : PlanarCamera
    lattice : PoseLattice
        Its grid must be the map's.
    settings : PlanarRatingSettings
    log_odds_range : LogOddsRange
        That of the maps to be rated on.

    Notes
    -----
    Poses are lattice ids (k,). Of a `ViewContext` only the reserved mask counts here.
    """

    def __init__(
        self,
        camera: PlanarCamera,
        lattice: PoseLattice,
        settings: PlanarRatingSettings,
        log_odds_range: LogOddsRange,
    ) -> None:
        self.camera = camera
        self.lattice = lattice
        self.settings = settings
        self.fan = BeamFan.from_camera(camera, lattice.grid.resolution, lattice.n_headings)
        self.gray = GrayLevelTable.from_distances(
            self.fan.distance, self.fan.depth, settings, log_odds_range
        )
        self.codes = CodeTable.from_gray_levels(self.gray, log_odds_range)
        self._fan = tuple(self.fan.arrays(lattice.grid.shape[1]))
        self._tables = tuple(ViewTables.from_fan(self.fan, self.gray, self.codes))
        self._clamp = log_odds_range.clamp

    @property
    def max_visible_cells(self) -> int:
        """N of Eq. 7."""
        return self.fan.max_visible_cells

    def new_information(
        self, map_: OccupancyMap, pose_ids: ArrayLike, context: ViewContext = WHOLE_VIEW
    ) -> NDArray[np.float64]:
        """NI (Eqs. 6-8) of poses, nats, shape (k,)."""
        return self.new_information_and_unknown(map_, pose_ids, context)[0]

    def count_unknown_cells(
        self, map_: OccupancyMap, pose_ids: ArrayLike, context: ViewContext = WHOLE_VIEW
    ) -> NDArray[np.int64]:
        """Number of never-sampled cells in view of each pose, shape (k,)."""
        return self.new_information_and_unknown(map_, pose_ids, context)[1]

    def new_information_and_unknown(
        self, map_: OccupancyMap, pose_ids: ArrayLike, context: ViewContext = WHOLE_VIEW
    ) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """`new_information` and `count_unknown_cells` of poses, in one pass over the map."""
        return self._evaluate(map_, self.validate_ids(map_, pose_ids), context)

    def _evaluate(
        self, map_: OccupancyMap, ids: NDArray[np.int64], context: ViewContext
    ) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        ni, unknown = np.empty(len(ids)), np.empty(len(ids), dtype=np.int64)
        mask = context.reserved_mask
        reserved_mask = NOTHING_RESERVED if mask is None else mask
        evaluate_poses(tuple(map_.arrays), reserved_mask, ids, self._fan, self._tables, ni, unknown)
        return ni, unknown

    def evaluate_codes(
        self, codes: NDArray[np.uint8], ids: NDArray[np.int64]
    ) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """`new_information_and_unknown` of valid poses on the `cell_codes` of a map (n_cells,)."""
        ni, unknown = np.empty(len(ids)), np.empty(len(ids), dtype=np.int64)
        shape = self.lattice.grid.shape
        evaluate_coded_poses(codes, shape, ids, self._fan, self._tables, ni, unknown)
        return ni, unknown

    def visible_cells(
        self, map_: OccupancyMap, pose_id: int, context: ViewContext = WHOLE_VIEW
    ) -> NDArray[np.int64]:
        """Flat indices of the cells that a pose would see on the known map, nearest first.

        Reserved cells are included.
        """
        ids = self.validate_ids(map_, [pose_id])
        cells = np.empty(self.max_visible_cells, dtype=np.int64)
        n = find_visible_cells(tuple(map_.arrays), ids, self._fan, self._tables, cells)
        return cells[:n]

    def distance(self, pose_ids: ArrayLike, current: ArrayLike) -> NDArray[np.float64]:
        """Distance d of Eq. 5, shape (k,), from `current`: one pose for each, or one for all.

        Raises
        ------
        ValueError
            If an id is no pose of the lattice, or there is another number of current ones.
        """
        new = self.lattice.checked_ids(pose_ids)
        old = self.lattice.checked_ids(current).reshape(-1)
        if len(old) not in (1, len(new)):
            raise ValueError(
                f"{len(new)} distances need 1 or {len(new)} current poses, got {len(old)}"
            )
        out = np.empty(len(new))
        grid, s = self.lattice.grid, self.settings
        lattice_distances(
            new, old, self.lattice.n_headings, grid.shape[1], grid.resolution,
            s.alpha_position, s.alpha_heading, out,
        )  # fmt: skip
        return out

    def rate(
        self,
        map_: OccupancyMap,
        pose_ids: ArrayLike,
        distance: ArrayLike,
        context: ViewContext = WHOLE_VIEW,
    ) -> Ratings:
        """Eq. 9 of poses: RF = (NI - K d**n) (1 - P); `distance` is d of Eq. 5, shape (k,)."""
        ids = self.validate_ids(map_, pose_ids)
        return self._rate(map_, ids, distance, self._evaluate(map_, ids, context)[0])

    def rate_team(self, map_: OccupancyMap, pose_ids: ArrayLike, distance: ArrayLike) -> Ratings:
        """Eq. 9 of one pose for each robot, all scanning at once; shapes (n_robots,).

        What a robot sees is reserved for it: the robots after it do not count it, so that an
        overlap counts once.
        """
        ids = self.validate_ids(map_, pose_ids)
        ni = np.empty(len(ids))
        evaluate_team(tuple(map_.arrays), ids, self._fan, self._tables, ni)
        return self._rate(map_, ids, distance, ni)

    def rate_from_new_information(
        self,
        map_: OccupancyMap,
        pose_ids: ArrayLike,
        distance: ArrayLike,
        new_information: NDArray[np.float64],
    ) -> Ratings:
        """Eq. 9 from new information that is known already."""
        return self._rate(map_, self.validate_ids(map_, pose_ids), distance, new_information)

    def _rate(
        self,
        map_: OccupancyMap,
        ids: NDArray[np.int64],
        distance: ArrayLike,
        new_information: NDArray[np.float64],
    ) -> Ratings:
        d = np.asarray(distance, dtype=np.float64)
        if d.shape != ids.shape:
            d = np.full(ids.shape, d)
        table, clamp, s = map_.log_odds_range.probability, self._clamp, self.settings
        out = np.empty((3, len(ids)))
        rate_poses(
            map_.log_odds_fixed, table, clamp, ids, self.lattice.n_headings,
            (float(s.K), float(s.exponent)),
            new_information, d, out,
        )  # fmt: skip
        cost, occupancy, rating = out
        return Ratings(new_information, d, cost, occupancy, rating)

    def validate_ids(self, map_: OccupancyMap, ids: ArrayLike) -> NDArray[np.int64]:
        """Pose ids as an array; kernels trust them and the map, so both are checked here.

        Raises
        ------
        ValueError
            If an id is no pose of the lattice, or the map is of another shape or clamp.
        """
        numbers = self.lattice.checked_ids(ids)
        self.validate_map(map_)
        return numbers

    def validate_map(self, map_: OccupancyMap) -> None:
        """ValueError if a map is of another shape or clamp than the maps to be rated on."""
        if map_.grid.shape != self.lattice.grid.shape or map_.log_odds_range.clamp != self._clamp:
            raise ValueError(
                f"the map ({map_.grid.shape}, clamp {map_.log_odds_range.clamp}) does not fit this "
                f"rating function ({self.lattice.grid.shape}, clamp {self._clamp})"
            )


@kernel
def lattice_distances(
    poses: NDArray[np.int64],
    current: NDArray[np.int64],
    n_headings: int,
    ny: int,
    resolution: float,
    alpha_position: float,
    alpha_heading: float,
    out: NDArray[np.float64],
) -> None:
    """Write d of Eq. 5 from `current` (k,) or (1,) to each pose (k,); `ny` cells lie along y."""
    heading_step = 2.0 * np.pi / n_headings
    for k in range(len(poses)):
        start = current[k] if len(current) > 1 else current[0]
        start_cell, start_heading = start // n_headings, start % n_headings
        cell, heading = poses[k] // n_headings, poses[k] % n_headings
        dx = (cell // ny - start_cell // ny) * resolution
        dy = (cell % ny - start_cell % ny) * resolution
        turns = abs(heading - start_heading)
        angle = min(turns, n_headings - turns) * heading_step
        out[k] = np.sqrt(alpha_position * (dx * dx + dy * dy) + alpha_heading * angle * angle)


@kernel
def rate_poses(
    log_odds_fixed: NDArray[np.int32],
    probability: NDArray[np.float64],
    clamp: int,
    ids: NDArray[np.int64],
    n_headings: int,
    cost_law: tuple[float, float],
    ni: NDArray[np.float64],
    d: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:
    """Eq. 9: write K d**n, P and RF, one row each, to `out` (3, k).

    `probability` is the table of the map's log-odds, `cost_law` is K and n.
    """
    for k in range(len(d)):
        out[1, k] = probability[log_odds_fixed[ids[k] // n_headings] + clamp]
    write_ratings(cost_law, ni, d, out)
