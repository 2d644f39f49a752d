"""The rating function in the plane: new information (Eqs. 6-8), rating (Eq. 9)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.information.entropy import minus_q_ln_q
from coopmap_env.information.gray import GrayTable
from coopmap_env.information.planar.fan import Fan
from coopmap_env.information.planar.views import (
    all_inside,
    compose,
    new_information_in_turn,
    view,
    views,
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
        self.fan = Fan.of(camera, lattice.grid.resolution, lattice.n_headings)
        self.gray = GrayTable.of(
            self.fan.distance, self.fan.depth, settings.n_gray, settings.reading, log_odds_range
        )
        fan = self.fan
        self._fan = (fan.start, fan.offsets, fan.beams, fan.all_beams, fan.reach)
        self._gray = (
            self.gray.sampled,
            self.gray.distance_class,
            self.gray.unknown,
            log_odds_range.clamp,
        )
        self._terms = minus_q_ln_q(self.fan.n_visible)
        self._nobody = np.zeros(lattice.grid.n_cells, dtype=np.uint8)

    def new_information(
        self, map_: OccupancyMap, ids: ArrayLike, claimed: NDArray[np.uint8] | None = None
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
        return self.views(map_, ids, claimed)[0]

    def unknown_cells(
        self, map_: OccupancyMap, ids: ArrayLike, claimed: NDArray[np.uint8] | None = None
    ) -> NDArray[np.int64]:
        """Number of never-sampled cells in view of each pose, shape (k,)."""
        return self.views(map_, ids, claimed)[1]

    def views(
        self, map_: OccupancyMap, ids: ArrayLike, claimed: NDArray[np.uint8] | None = None
    ) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """`new_information` and `unknown_cells` of poses, from one look at the map."""
        ids = self.check(map_, ids)
        ni, unknown = np.empty(len(ids)), np.empty(len(ids), dtype=np.int64)
        nx, ny = map_.grid.shape
        views(
            map_.levels, map_.sampled_cells, self._nobody if claimed is None else claimed,
            nx, ny, ids, self._fan, self._gray, self._terms, self.settings.n_gray, ni, unknown,
        )  # fmt: skip
        return ni, unknown

    def visible_cells(self, map_: OccupancyMap, pose_id: int) -> NDArray[np.int64]:
        """Flat numbers of the cells that a pose would see on the known map, nearest first."""
        alive = np.empty(len(self.fan.all_beams), dtype=np.uint64)
        visible, entries = np.empty((2, self.fan.n_visible), dtype=np.int64)
        nx, ny = map_.grid.shape
        (pose_id,) = self.check(map_, [pose_id])
        n = view(
            map_.levels, map_.sampled_cells, nx, ny, pose_id, self._fan, alive, visible, entries
        )
        return visible[:n].copy()

    def rate(
        self,
        map_: OccupancyMap,
        ids: ArrayLike,
        current: int,
        claimed: NDArray[np.uint8] | None = None,
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
        return self.compose(map_, ids, [current], self.new_information(map_, ids, claimed))

    def rate_team(self, map_: OccupancyMap, ids: ArrayLike, current: ArrayLike) -> Ratings:
        """Eq. 9 of one pose for each robot, looking at once.

        What a robot sees is left out of the histograms of the robots after it, so that an overlap
        counts once. `ids` and `current`, both of shape (n_robots,), are the new poses and the
        ones before.
        """
        new, old = self.check(map_, np.array([ids, current]))
        ni = np.empty(len(new))
        nx, ny = map_.grid.shape
        new_information_in_turn(
            map_.levels, map_.sampled_cells, self._nobody,
            nx, ny, new, self._fan, self._gray, self._terms, self.settings.n_gray, ni,
        )  # fmt: skip
        return self._compose(map_, new, old, ni)

    def compose(
        self, map_: OccupancyMap, ids: ArrayLike, current: ArrayLike, ni: NDArray[np.float64]
    ) -> Ratings:
        """Eq. 9 from new information that is known already; `current` is one pose or one each."""
        return self._compose(map_, self.check(map_, ids), self.check(map_, current), ni)

    def _compose(
        self,
        map_: OccupancyMap,
        ids: NDArray[np.int64],
        start: NDArray[np.int64],
        ni: NDArray[np.float64],
    ) -> Ratings:
        d, cost, p, rating = np.empty((4, len(ids)))
        lattice, s = self.lattice, self.settings
        compose(
            map_.levels, lattice.grid.shape[1], ids, start,
            (lattice.n_headings, lattice.grid.resolution),
            (s.K, s.exponent, s.alpha_position, s.alpha_heading),
            map_.range.probability, map_.range.clamp, ni, d, cost, p, rating,
        )  # fmt: skip
        return Ratings(ni, d, cost, p, rating)

    def check(self, map_: OccupancyMap, ids: ArrayLike) -> NDArray[np.int64]:
        """Pose numbers as an array; kernels trust them and the map, so both are checked here.

        Raises
        ------
        ValueError
            If a number is no pose of the lattice, or the map is of another shape or clamp.
        """
        numbers = np.asarray(ids, dtype=np.int64)
        if not all_inside(numbers.ravel(), self.lattice.n_poses):
            raise ValueError(f"pose numbers lie in 0 ... {self.lattice.n_poses - 1}, got {numbers}")
        if map_.grid.shape != self.lattice.grid.shape or map_.range.clamp != self._gray[-1]:
            raise ValueError(
                f"the map ({map_.grid.shape}, clamp {map_.range.clamp}) is not of the kind that "
                f"is rated here ({self.lattice.grid.shape}, clamp {self._gray[-1]})"
            )
        return numbers
