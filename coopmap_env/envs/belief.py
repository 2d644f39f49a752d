"""Belief: what the robots of a team know, which is all that a policy may look at."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.geometry import to_camera_frame
from coopmap_env.information import RatingFunction
from coopmap_env.mapping import OccupancyMap
from coopmap_env.robots import PoseLattice, Reach, why_not

if TYPE_CHECKING:
    from coopmap_env.envs.actions import ActionMode


@dataclass(frozen=True)
class Belief:
    """The team's map, its own poses and its own limits; never the truth.

    Look, do not touch: `map` is the environment's own, not a copy.
    """

    agents: tuple[str, ...]
    """Names of the robots; every list below is in this order."""
    map: OccupancyMap
    """The fused map of the whole team."""
    pose_ids: tuple[int, ...]
    """Where each camera is: its lattice number."""
    rating: RatingFunction
    """Rates poses with the constants of the environment; holds the pose lattice."""
    reach: float
    """Metres; see `PlanarSettings.reach`."""
    actions: ActionMode
    """How actions are written."""
    offers: tuple[NDArray[np.int64], ...] | None = None
    """The candidates offered to each robot, lattice numbers, in "candidates" mode."""

    @property
    def lattice(self) -> PoseLattice:
        """The configuration space."""
        return self.rating.lattice

    @cached_property
    def poses(self) -> NDArray[np.float64]:
        """Camera poses (n_robots, 3) [x, y, heading], metres and radians."""
        return np.array([self.lattice.pose(pose_id) for pose_id in self.pose_ids])

    def within_reach(self, robot: int, cells: NDArray[np.int32]) -> NDArray[np.bool_]:
        """Which cells one action can bring the robot to, walls aside, shape (k,)."""
        here = self.lattice.poses(self.pose_ids[robot])
        centers = self.lattice.poses(cells.astype(np.int64) * self.lattice.n_headings)
        relative = np.abs(to_camera_frame(centers, here)[:, :2])
        # a cell counts if its centre is in reach, but for the rounding of the rotation
        return relative.max(axis=1) <= self.reach * (1 + 1e-9)

    def feasible_cells(self, robot: int) -> NDArray[np.int32]:
        """Cells that satisfy constraints i and ii and lie within reach, nearest by path first."""
        cells = Reach.search(self.map, self.cell(robot)).cells
        return cells[self.within_reach(robot, cells)]

    def feasible_poses(self, robot: int) -> NDArray[np.int64]:
        """All headings in all feasible cells, lattice numbers in the order of the cells."""
        cells, n = self.feasible_cells(robot).astype(np.int64), self.lattice.n_headings
        return (cells[:, None] * n + np.arange(n)).ravel()

    def random_poses(self, robot: int, m: int, rng: np.random.Generator) -> NDArray[np.int64]:
        """Up to m different feasible poses, uniformly at random, lattice numbers."""
        cells, n = self.feasible_cells(robot).astype(np.int64), self.lattice.n_headings
        picks = rng.choice(len(cells) * n, min(m, len(cells) * n), replace=False)
        return cells[picks // n] * n + picks % n

    def cell(self, robot: int) -> int:
        """Flat number of the cell in which the robot's camera is."""
        return self.pose_ids[robot] // self.lattice.n_headings

    def action_for(self, robot: int, pose_id: int) -> Any:
        """Write the action that leads the robot to a lattice pose.

        Raises
        ------
        InvalidActionError
            If no single action does.
        """
        return self.actions.encode(robot, pose_id, self)

    def why_not(self, robot: int, pose_id: int) -> str:
        """Why the robot cannot take this pose; empty if it can."""
        if pose_id < 0:
            return "outside the world"
        return why_not(self.map, self.cell(robot), pose_id // self.lattice.n_headings)

    def moved(
        self, pose_ids: tuple[int, ...], offers: tuple[NDArray[np.int64], ...] | None = None
    ) -> Belief:
        """The same belief with the cameras elsewhere."""
        return Belief(
            self.agents, self.map, pose_ids, self.rating, self.reach, self.actions, offers
        )
