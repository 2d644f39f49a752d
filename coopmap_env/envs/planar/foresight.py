"""The planar map as it may be after the next scans."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from coopmap_env.envs.planar.belief import PlanarBelief
from coopmap_env.information import ExpectedCells, PlanarExpectedViews
from coopmap_env.robots import PoseLattice
from coopmap_env.robots.planar.feasible_poses import PoseSampling
from coopmap_env.robots.planar.likely_cells import likely_cells

LIKELY_FREE = 0.5
"""Cells that will be known to be free with this probability, or a higher one, can be planned on."""


@dataclass(frozen=True)
class PlanarForesight:
    """See `Foresight`; a view opens the cells that it will probably show and that may be free.

    Pose ids that are none of the lattice are a ValueError.
    """

    views: PlanarExpectedViews
    cells: ExpectedCells
    """Changed by `take`."""
    sampling: PoseSampling

    @classmethod
    def of_belief(
        cls,
        belief: PlanarBelief,
        views: PlanarExpectedViews,
        unknown_occupancy: NDArray[np.float32] | None = None,
    ) -> PlanarForesight:
        """The map as it is; cameras may stay in their cells, whatever is known of them."""
        cells = views.cells(belief.map, unknown_occupancy=unknown_occupancy)
        cells.free[[belief.cell(robot) for robot in range(len(belief.agents))]] = 1
        return cls(views, cells, belief.sampling)

    @property
    def _lattice(self) -> PoseLattice:
        return self.views.rating.lattice

    def copy(self) -> PlanarForesight:
        """See `Foresight.copy`."""
        return replace(self, cells=self.cells.copy())

    def gain(self, robot: int, pose_ids: NDArray[np.int64]) -> NDArray[np.float64]:
        """See `Foresight.gain`; times the probability that the cell can be entered."""
        ids = self._lattice.checked_ids(pose_ids)
        chance = self.cells.free[ids // self._lattice.n_headings]
        n_cells = self.views.rating.max_visible_cells
        gain: NDArray[np.float64] = self.views.count(self.cells, ids) * chance / n_cells
        return gain

    def take(self, robot: int, pose_id: int) -> None:
        """See `Foresight.take`."""
        (pose,) = self._lattice.checked_ids([pose_id])
        cell = pose // self._lattice.n_headings
        self.views.take(self.cells, pose, float(self.cells.free[cell]))

    def random_poses(
        self, robot: int, pose_id: int, m: int, rng: np.random.Generator
    ) -> NDArray[np.int64]:
        """See `Foresight.random_poses`."""
        (pose,), n = self._lattice.checked_ids([pose_id]), self._lattice.n_headings
        cells = likely_cells(self.cells.free, LIKELY_FREE, pose, self.sampling)
        numbers = np.unique(rng.integers(len(cells) * n, size=m))
        poses: NDArray[np.int64] = cells[numbers // n] * n + numbers % n
        return poses

    def distance(
        self, robot: int, pose_ids: NDArray[np.int64], pose_id: int
    ) -> NDArray[np.float64]:
        """See `PlanarRatingFunction.distance`."""
        return self.views.rating.distance(pose_ids, [pose_id])
