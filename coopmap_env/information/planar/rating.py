"""The rating function in the plane: new information (Eqs. 6-8), rating (Eq. 9)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.information.entropy import entropy_terms
from coopmap_env.information.gray import GrayLevelTable
from coopmap_env.information.planar.fan import BeamFan
from coopmap_env.information.planar.views import (
    are_all_below,
    evaluate_views,
    find_visible_cells,
    rate_poses,
    sequential_new_information,
)
from coopmap_env.information.settings import RatingConstants, RatingSettings
from coopmap_env.mapping import LogOddsRange, OccupancyMap
from coopmap_env.robots import PoseLattice
from coopmap_env.sensing import PlanarCamera


@dataclass(frozen=True)
class Ratings:
    """What Eq. 9 is made of, for k poses."""

    new_information: NDArray[np.float64]
    """NI, nats, shape (k,)."""
    distance: NDArray[np.float64]
    """d of Eq. 5, shape (k,)."""
    motion_cost: NDArray[np.float64]
    """K d**n, nats, shape (k,)."""
    occupancy: NDArray[np.float64]
    """P at the camera's position, shape (k,)."""
    rating: NDArray[np.float64]
    """RF, shape (k,)."""

    @classmethod
    def of(
        cls,
        new_information: NDArray[np.float64],
        distance: NDArray[np.float64],
        occupancy: NDArray[np.float64],
        constants: RatingConstants,
    ) -> Ratings:
        """Eq. 9 from its parts: RF = (NI - K d**n) (1 - P)."""
        cost = constants.K * distance**constants.exponent
        rating = (new_information - cost) * (1.0 - occupancy)
        return cls(new_information, distance, cost, occupancy, rating)


class RatingFunction:
    """Rates lattice poses on a known map; one object serves planner and reward alike.

    Parameters
    ----------
    camera : PlanarCamera
    lattice : PoseLattice
        Its grid must be the map's.
    settings : RatingSettings
    log_odds_range : LogOddsRange
        That of the maps to be rated on.
    """

    def __init__(
        self,
        camera: PlanarCamera,
        lattice: PoseLattice,
        settings: RatingSettings,
        log_odds_range: LogOddsRange,
    ) -> None:
        self.lattice = lattice
        self.settings = settings
        self.fan = BeamFan.from_camera(camera, lattice.grid.resolution, lattice.n_headings)
        self.gray = GrayLevelTable.from_distances(
            self.fan.distance,
            self.fan.depth,
            settings.n_gray_bins,
            settings.interpretation,
            log_odds_range,
        )
        fan = self.fan
        self._fan = (fan.start, fan.offsets, fan.beams, fan.all_beams, fan.max_offset)
        self._gray = (
            self.gray.sampled,
            self.gray.distance_class,
            self.gray.unknown,
            log_odds_range.clamp,
        )
        self._entropy_terms = entropy_terms(self.fan.max_visible_cells)
        self._no_reservation = np.zeros(lattice.grid.n_cells, dtype=np.uint8)

    def new_information(
        self, map_: OccupancyMap, ids: ArrayLike, reserved_mask: NDArray[np.uint8] | None = None
    ) -> NDArray[np.float64]:
        """NI (Eqs. 6-8) of poses, nats, shape (k,).

        Parameters
        ----------
        map_ : OccupancyMap
        ids : array_like, shape (k,)
            Lattice numbers.
        claimed : ndarray of uint8, shape (n_cells,), optional
            1 at cells that a teammate is about to see: they are left out of the histogram.
        """
        return self.information_and_unknown(map_, ids, reserved_mask)[0]

    def count_unknown_cells(
        self, map_: OccupancyMap, ids: ArrayLike, reserved_mask: NDArray[np.uint8] | None = None
    ) -> NDArray[np.int64]:
        """Number of never-sampled cells in view of each pose, shape (k,)."""
        return self.information_and_unknown(map_, ids, reserved_mask)[1]

    def information_and_unknown(
        self, map_: OccupancyMap, ids: ArrayLike, reserved_mask: NDArray[np.uint8] | None = None
    ) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """`new_information` and `count_unknown_cells` of poses, from one look at the map."""
        ids = self.validate_ids(map_, ids)
        ni, unknown = np.empty(len(ids)), np.empty(len(ids), dtype=np.int64)
        nx, ny = map_.grid.shape
        evaluate_views(
            map_.log_odds_fixed, map_.sampled_mask, self._no_reservation if reserved_mask is None else reserved_mask,
            nx, ny, ids, self._fan, self._gray, self._entropy_terms, self.settings.n_gray_bins, ni, unknown,
        )  # fmt: skip
        return ni, unknown

    def visible_cells(self, map_: OccupancyMap, pose_id: int) -> NDArray[np.int64]:
        """Flat numbers of the cells that a pose would see on the known map, nearest first."""
        alive = np.empty(len(self.fan.all_beams), dtype=np.uint64)
        visible, entries = np.empty((2, self.fan.max_visible_cells), dtype=np.int64)
        nx, ny = map_.grid.shape
        (pose_id,) = self.validate_ids(map_, [pose_id])
        n = find_visible_cells(
            map_.log_odds_fixed,
            map_.sampled_mask,
            nx,
            ny,
            pose_id,
            self._fan,
            alive,
            visible,
            entries,
        )
        return visible[:n].copy()

    def rate(
        self,
        map_: OccupancyMap,
        ids: ArrayLike,
        current: int,
        reserved_mask: NDArray[np.uint8] | None = None,
    ) -> Ratings:
        """Eq. 9 of lattice poses: RF = (NI - K d**n) (1 - P).

        Parameters
        ----------
        map_ : OccupancyMap
        ids : array_like, shape (k,)
        current : int
            Where the camera is.
        claimed : ndarray of uint8, shape (n_cells,), optional
            See `new_information`.
        """
        return self.rate_from_information(
            map_, ids, [current], self.new_information(map_, ids, reserved_mask)
        )

    def rate_team(self, map_: OccupancyMap, ids: ArrayLike, current: ArrayLike) -> Ratings:
        """Eq. 9 of one pose for each robot, looking at once.

        What a robot sees is left out of the histograms of the robots after it, so that an overlap
        counts once. `ids` and `current`, both of shape (n_robots,), are the new poses and the
        ones before.
        """
        new, old = self.validate_ids(map_, np.array([ids, current]))
        ni = np.empty(len(new))
        nx, ny = map_.grid.shape
        sequential_new_information(
            map_.log_odds_fixed, map_.sampled_mask, self._no_reservation,
            nx, ny, new, self._fan, self._gray, self._entropy_terms, self.settings.n_gray_bins, ni,
        )  # fmt: skip
        return self._rate_from_information(map_, new, old, ni)

    def rate_from_information(
        self, map_: OccupancyMap, ids: ArrayLike, current: ArrayLike, ni: NDArray[np.float64]
    ) -> Ratings:
        """Eq. 9 from new information that is known already; `current` is one pose or one each."""
        return self._rate_from_information(
            map_, self.validate_ids(map_, ids), self.validate_ids(map_, current), ni
        )

    def _rate_from_information(
        self,
        map_: OccupancyMap,
        ids: NDArray[np.int64],
        start: NDArray[np.int64],
        ni: NDArray[np.float64],
    ) -> Ratings:
        d, cost, p, rating = np.empty((4, len(ids)))
        lattice, s = self.lattice, self.settings
        rate_poses(
            map_.log_odds_fixed, lattice.grid.shape[1], ids, start,
            (lattice.n_headings, lattice.grid.resolution),
            (s.K, s.exponent, s.alpha_position, s.alpha_heading),
            map_.log_odds_range.probability, map_.log_odds_range.clamp, ni, d, cost, p, rating,
        )  # fmt: skip
        return Ratings(ni, d, cost, p, rating)

    def validate_ids(self, map_: OccupancyMap, ids: ArrayLike) -> NDArray[np.int64]:
        """Pose numbers as an array; kernels trust them and the map, so both are checked here.

        Raises
        ------
        ValueError
            If a number is no pose of the lattice, or the map is of another shape or clamp.
        """
        numbers = np.asarray(ids, dtype=np.int64)
        if not are_all_below(numbers.ravel(), self.lattice.n_poses):
            raise ValueError(f"pose numbers lie in 0 ... {self.lattice.n_poses - 1}, got {numbers}")
        if (
            map_.grid.shape != self.lattice.grid.shape
            or map_.log_odds_range.clamp != self._gray[-1]
        ):
            raise ValueError(
                f"the map ({map_.grid.shape}, clamp {map_.log_odds_range.clamp}) is not of the kind that "
                f"is rated here ({self.lattice.grid.shape}, clamp {self._gray[-1]})"
            )
        return numbers
