"""Belief: what the robots of a team know, which is all that a policy may look at."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from coopmap_env.information import Ratings
from coopmap_env.mapping import OccupancyMap

if TYPE_CHECKING:
    from coopmap_env.envs.actions import ActionMode

Observation = dict[str, NDArray[Any]]
"""What one robot observes; the entries are documented by each environment's `observations`."""
Observations = Mapping[str, Observation]
Poses = NDArray[Any]
"""Camera poses of one robot, one a row: lattice numbers (k,) in the plane, mount joints (k, n) in
the field. Planners hand them on and never look inside."""
ReservedMask = NDArray[np.uint8] | None
"""1 at cells (n_cells,) that a teammate is about to see: they are left out of every count."""


@dataclass(frozen=True)
class Belief(ABC):
    """The team's map, its own poses and its own limits; never the truth.

    Planners are written against this class, so that they run in every world. Look, do not touch:
    `map` is the environment's own, not a copy.
    """

    agents: tuple[str, ...]
    """Names of the robots; `robot` in every method is a place in this list."""
    map: OccupancyMap
    """The fused map of the whole team."""
    actions: ActionMode
    """How actions are written."""
    candidates: tuple[Poses, ...] | None
    """The candidates offered to each robot, in "candidates" mode."""

    prior: ClassVar[float]
    """Occupancy expected of a cell that was never sampled: that of training worlds."""

    @property
    @abstractmethod
    def positions(self) -> NDArray[np.float64]:
        """Where the cameras are as far as the robots know, shape (n_robots, D), metres."""

    @abstractmethod
    def feasible_poses(self, robot: int) -> Poses:
        """All poses of the discrete configuration space that satisfy constraints i and ii."""

    @abstractmethod
    def random_poses(self, robot: int, m: int, rng: np.random.Generator) -> Poses:
        """Up to m different feasible poses, uniformly at random."""

    @abstractmethod
    def rate(self, robot: int, poses: Poses, reserved_mask: ReservedMask = None) -> Ratings:
        """Eqs. 5 to 9 of each pose."""

    @abstractmethod
    def rate_team(self, poses: Any) -> Ratings:
        """Eqs. 5 to 9 of one pose for each robot, looking at once: an overlap counts once."""

    @abstractmethod
    def distance(self, robot: int, poses: Poses) -> NDArray[np.float64]:
        """D of Eq. 5 from where the robot is, shape (k,)."""

    @abstractmethod
    def unknown_fraction(
        self, robot: int, poses: Poses, reserved_mask: ReservedMask = None
    ) -> NDArray[np.float64]:
        """Never-sampled cells in view as a share of the most that the camera sees, shape (k,)."""

    @abstractmethod
    def information_fraction(
        self, robot: int, poses: Poses, prior: float, reserved_mask: ReservedMask = None
    ) -> NDArray[np.float64]:
        """Mutual information as a share of a wholly unknown, unobstructed view's, shape (k,).

        `prior` is the occupancy that is expected of never-sampled cells.
        """

    @abstractmethod
    def visible_cells(self, robot: int, pose: Any) -> NDArray[np.int64]:
        """Flat numbers of the cells that a pose would see on the known map."""

    @abstractmethod
    def raster_offset(self, robot: int, poses: Poses) -> NDArray[np.int64]:
        """How far each pose lies ahead in the raster sequence, which goes around, shape (k,)."""

    @abstractmethod
    def nearest_frontier_mask(
        self, robot: int, poses: Poses, shows_unknown: NDArray[np.bool_]
    ) -> NDArray[np.bool_]:
        """Which poses look from or at the nearest frontier, among those that `shows_unknown` marks."""

    def prescreen(self, poses: Poses, score: Callable[[Any, Poses], NDArray[np.float64]]) -> Poses:
        """Poses among which the best one is, by the score on a rougher belief; here: all."""
        return poses

    @abstractmethod
    def with_poses(self, poses: Any) -> Self:
        """The same belief with the robots elsewhere, and without offers."""

    @abstractmethod
    def with_candidates(self, candidates: Sequence[Poses]) -> Self:
        """The same belief with candidates on offer."""

    def action_for(self, robot: int, pose: Any) -> Any:
        """Write the action that leads the robot to a pose.

        Raises
        ------
        InvalidActionError
            If no single action does.
        """
        return self.actions.encode(robot, pose, self)
