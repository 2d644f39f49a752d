"""What single planners ask of a planar belief."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.envs.planar.belief import PlanarBelief
from coopmap_env.information import (
    NewInformationCache,
    PlanarMutualInformation,
    PlanarRatingFunction,
    Ratings,
    ReservedMask,
    ViewContext,
    adjacent_to_unknown,
    entropy,
)
from coopmap_env.robots import ReachableCells


class PlanarPlanning:
    """See `Planning`; poses are ids of the `PoseLattice`."""

    unknown_prior = 0.12

    def information_fraction(
        self,
        belief: PlanarBelief,
        robot: int,
        poses: NDArray[np.int64],
        prior: float,
        reserved_mask: ReservedMask,
    ) -> NDArray[np.float64]:
        """See `PlanarMutualInformation`; a cell at the clamp cannot become more certain."""
        rating, map_ = belief.rating, belief.map
        beams = _mutual_information(rating, prior, map_.log_odds_range.max_probability)
        full_view = rating.max_visible_cells * entropy([prior, 1.0 - prior])
        return beams.mutual_information(map_, poses, ViewContext(reserved_mask)) / full_view

    def nearest_frontier_mask(
        self,
        belief: PlanarBelief,
        robot: int,
        poses: NDArray[np.int64],
        shows_unknown: NDArray[np.bool_],
    ) -> NDArray[np.bool_]:
        """All headings at the frontier cell with the shortest path, or at any cell without one."""
        cells = poses // belief.lattice.n_headings
        at_frontier = adjacent_to_unknown(belief.map)[cells]
        if at_frontier.any():
            shows_unknown = shows_unknown & at_frontier
        steps = ReachableCells.search(belief.map, belief.cell(robot)).steps[cells]
        far = np.iinfo(steps.dtype).max
        return shows_unknown & (cells == cells[np.argmin(np.where(shows_unknown, steps, far))])

    def raster_offset(
        self, belief: PlanarBelief, robot: int, poses: NDArray[np.int64]
    ) -> NDArray[np.int64]:
        """Cell by cell, row by row, and heading by heading in each cell."""
        return (poses - belief.pose_ids[robot] - 1) % belief.lattice.n_poses

    def prescreen(
        self,
        belief: PlanarBelief,
        poses: NDArray[np.int64],
        score: Callable[[Any, NDArray[np.int64]], NDArray[np.float64]],
    ) -> NDArray[np.int64]:
        """All poses: views of the plane are fast to rate."""
        return poses

    def exhaustive_rater(self) -> CachedRater:
        """A rater that rates again only the poses whose views have changed."""
        return CachedRater()


class CachedRater:
    """Rates poses with a `NewInformationCache`, for one rating function at a time."""

    def __init__(self) -> None:
        self.cache: NewInformationCache | None = None

    def rate(
        self,
        belief: PlanarBelief,
        robot: int,
        poses: NDArray[np.int64],
        reserved_mask: ReservedMask,
    ) -> Ratings:
        """Eqs. 5 to 9 of each pose; equals `PlanarBelief.rate`."""
        rating = belief.rating
        if self.cache is None or self.cache.rating is not rating:
            self.cache = NewInformationCache(rating)
        ni = self.cache.new_information(belief.map, poses, ViewContext(reserved_mask))
        distance = belief.distance(robot, poses)
        return rating.rate_from_information(belief.map, poses, distance, ni)


@lru_cache(maxsize=4)
def _mutual_information(
    rating: PlanarRatingFunction, prior: float, known_probability: float
) -> PlanarMutualInformation:
    return PlanarMutualInformation(rating, prior, known_probability)
