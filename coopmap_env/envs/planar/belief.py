"""Belief of a planar team: lattice poses, reached over the known free cells."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.envs.belief import Belief, ReservedMask
from coopmap_env.information import (
    MutualInformation,
    RatingFunction,
    Ratings,
    adjacent_to_unknown,
    entropy,
)
from coopmap_env.robots import PoseLattice, ReachableCells, infeasibility_reason


@dataclass(frozen=True)
class PlanarBelief(Belief):
    """What a planar team knows. A pose is a number of the `PoseLattice`."""

    prior = 0.12

    pose_ids: tuple[int, ...]
    """Where each camera is: its lattice number."""
    rating: RatingFunction
    """Rates poses with the constants of the environment; holds the pose lattice."""
    reach: float
    """Metres; see `PlanarSettings.reach`."""

    @property
    def lattice(self) -> PoseLattice:
        """The configuration space."""
        return self.rating.lattice

    @cached_property
    def poses(self) -> NDArray[np.float64]:
        """Camera poses (n_robots, 3) [x, y, heading], metres and radians."""
        return self.lattice.poses(self.pose_ids)

    @property
    def positions(self) -> NDArray[np.float64]:
        """Where the cameras are, shape (n_robots, 2), metres."""
        return self.poses[:, :2]

    def feasible_cells(self, robot: int) -> NDArray[np.int32]:
        """Cells that satisfy constraints i and ii and lie within reach, nearest by path first."""
        cells = ReachableCells.search(self.map, self.cell(robot)).cells
        return self.lattice.cells_within(cells, self.pose_ids[robot], self.reach)

    def feasible_poses(self, robot: int) -> NDArray[np.int64]:
        """All headings in all feasible cells, lattice numbers in the order of the cells."""
        cells, n = self.feasible_cells(robot).astype(np.int64), self.lattice.n_headings
        return (cells[:, None] * n + np.arange(n)).ravel()

    def random_poses(self, robot: int, m: int, rng: np.random.Generator) -> NDArray[np.int64]:
        """Up to m different feasible poses, uniformly at random, lattice numbers."""
        cells, n = self.feasible_cells(robot), self.lattice.n_headings
        picks = rng.choice(len(cells) * n, min(m, len(cells) * n), replace=False)
        places, headings = np.divmod(picks, n)
        return cells[places] * np.int64(n) + headings

    def cell(self, robot: int) -> int:
        """Flat number of the cell in which the robot's camera is."""
        return self.pose_ids[robot] // self.lattice.n_headings

    def rate(self, robot: int, poses: ArrayLike, reserved_mask: ReservedMask = None) -> Ratings:
        """See `RatingFunction.rate`."""
        return self.rating.rate(self.map, poses, self.pose_ids[robot], reserved_mask)

    def rate_team(self, poses: ArrayLike) -> Ratings:
        """See `RatingFunction.rate_team`."""
        return self.rating.rate_team(self.map, poses, self.pose_ids)

    def distance(self, robot: int, poses: ArrayLike) -> NDArray[np.float64]:
        """See `motion_distance`."""
        nothing = np.zeros(len(np.atleast_1d(poses)))
        return self.rating.rate_from_information(
            self.map, poses, [self.pose_ids[robot]], nothing
        ).distance

    def unknown_fraction(
        self, robot: int, poses: ArrayLike, reserved_mask: ReservedMask = None
    ) -> NDArray[np.float64]:
        """See `RatingFunction.count_unknown_cells`."""
        return (
            self.rating.count_unknown_cells(self.map, poses, reserved_mask)
            / self.rating.fan.max_visible_cells
        )

    def information_fraction(
        self, robot: int, poses: ArrayLike, prior: float, reserved_mask: ReservedMask = None
    ) -> NDArray[np.float64]:
        """See `MutualInformation`; a cell at the clamp cannot become more certain."""
        beams = _mutual_information(self.rating, prior, self.map.log_odds_range.max_probability)
        full_view = self.rating.fan.max_visible_cells * entropy([prior, 1.0 - prior])
        return beams.mutual_information(self.map, poses, reserved_mask) / full_view

    def visible_cells(self, robot: int, pose: int) -> NDArray[np.int64]:
        """See `RatingFunction.visible_cells`."""
        return self.rating.visible_cells(self.map, pose)

    def raster_offset(self, robot: int, poses: NDArray[np.int64]) -> NDArray[np.int64]:
        """Cell by cell, row by row, and heading by heading in each cell."""
        return (poses - self.pose_ids[robot] - 1) % self.lattice.n_poses

    def nearest_frontier_mask(
        self, robot: int, poses: NDArray[np.int64], shows_unknown: NDArray[np.bool_]
    ) -> NDArray[np.bool_]:
        """All headings at the nearest cell by path that is a frontier, or at any without one."""
        cells = poses // self.lattice.n_headings
        at_frontier = adjacent_to_unknown(self.map)[cells]
        if at_frontier.any():
            shows_unknown = shows_unknown & at_frontier
        steps = ReachableCells.search(self.map, self.cell(robot)).steps[cells]
        far = np.iinfo(steps.dtype).max
        return shows_unknown & (cells == cells[np.argmin(np.where(shows_unknown, steps, far))])

    def infeasibility_reason(self, robot: int, pose_id: int) -> str:
        """Why the robot cannot take this pose; empty if it can."""
        if pose_id < 0:
            return "outside the world"
        return infeasibility_reason(self.map, self.cell(robot), pose_id // self.lattice.n_headings)

    def with_poses(self, poses: tuple[int, ...]) -> PlanarBelief:
        """The same belief with the cameras elsewhere."""
        return PlanarBelief(
            self.agents, self.map, self.actions, None, poses, self.rating, self.reach
        )

    def with_candidates(self, candidates: Sequence[NDArray[np.int64]]) -> PlanarBelief:
        """The same belief with candidates on offer."""
        return replace(self, candidates=tuple(candidates))


@lru_cache(maxsize=4)
def _mutual_information(rating: RatingFunction, prior: float, known: float) -> MutualInformation:
    return MutualInformation(rating, prior, known)
