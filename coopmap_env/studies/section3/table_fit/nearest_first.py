"""Exhaustive search that rates the nearest poses first and stops when none can be better.

New information is at most the logarithm of the number of gray levels, and motion costs K d**n. So
the poses beyond some distance cannot be better than the best one so far. The choice is that of
`RatingFunctionPolicy` with "exhaustive", ties included.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_baselines import RatingFunctionPolicy
from coopmap_env.envs.planar.belief import PlanarBelief
from coopmap_env.information import PlanarRatingFunction, ReservedMask
from coopmap_env.mapping import OccupancyMap

CHUNK = 256
"""Poses rated at a time."""
ROUNDING = 1e-9
"""Nats by which rounding can lift a rating above its bound."""


class NearestFirstPolicy(RatingFunctionPolicy):
    """The exhaustive search of the rating function, for planar worlds without "candidates"."""

    def __init__(self) -> None:
        super().__init__("exhaustive", "independent")

    def _best_pose(self, belief: Any, robot: int, reserved_mask: ReservedMask | None) -> Any:
        return best_rated_pose(belief, robot)


def best_rated_pose(belief: PlanarBelief, robot: int) -> np.int64:
    """The feasible pose of the highest rating; of equal ones the first."""
    rating, map_ = belief.rating_function, belief.map
    n, pose_id = belief.lattice.n_headings, belief.pose_ids[robot]
    most = most_information(map_, rating)
    cells = belief.feasible_cells(robot)
    # what a motion costs without its turn
    bounds = most - motion_cost(rating, rating.distance(cells * n + pose_id % n, pose_id))
    here = belief.cell(robot) * n + np.arange(n)
    best = rating.rate(map_, here, rating.distance(here, pose_id)).rating.max()
    kept = np.flatnonzero(bounds >= best) if best > 0.0 else np.arange(len(cells))
    poses = (cells[kept, None] * n + np.arange(n)).ravel()
    distance = rating.distance(poses, pose_id)
    bounds = most - motion_cost(rating, distance)
    order = np.argsort(distance, kind="stable")
    best, best_index, start = -math.inf, -1, 0
    while start < len(order) and (best <= 0.0 or bounds[order[start]] >= best):
        chunk = order[start : start + CHUNK]
        ratings = rating.rate(map_, poses[chunk], distance[chunk]).rating
        highest = float(ratings.max())
        index = int(chunk[ratings == highest].min())
        if highest > best or (highest == best and index < best_index):
            best, best_index = highest, index
        start += CHUNK
    return np.int64(poses[best_index])


def most_information(map_: OccupancyMap, rating: PlanarRatingFunction) -> float:
    """An upper bound of NI on this map, nats: all gray levels that occur, in equal parts."""
    log_odds = np.unique(map_.log_odds_fixed[map_.sampled_mask != 0])
    known = rating.gray.sampled[:, log_odds + map_.log_odds_range.clamp]
    levels = np.union1d(known, rating.gray.unknown)
    return math.log(max(len(levels), 3)) + ROUNDING


def motion_cost(rating: PlanarRatingFunction, distance: NDArray[np.float64]) -> NDArray[np.float64]:
    """K d**n of distances (k,), nats."""
    cost: NDArray[np.float64] = rating.settings.K * distance**rating.settings.exponent
    return cost
