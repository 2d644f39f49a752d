"""Base classes of the planners: where they search, and how a team coordinates."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.settings import Bounds, NonNegative, checked_value
from coopmap_env.envs import Belief, Observations, Poses
from coopmap_env.information import ReservedMask

Search = int | Literal["exhaustive"]
CheckedSearch = Annotated[int, Bounds(at_least=1, largest=1_000_000)] | Literal["exhaustive"]
Coordination = Literal["independent", "sequential"]


def candidate_poses(belief: Belief, robot: int, search: Search, rng: np.random.Generator) -> Poses:
    """The poses among which a search chooses: the candidates, where there are any."""
    if belief.candidates is not None:
        return belief.candidates[robot]
    if isinstance(search, int):
        return belief.random_poses(robot, search, rng)
    return belief.feasible_poses(robot)


class Planner(ABC):
    """Gives each robot the best-scored pose of its search.

    Parameters
    ----------
    search : int or "exhaustive"
        Best of m random feasible poses, or of all. In "candidates" mode always of the candidates.
    coordination : {"independent", "sequential"}
        Whether robots plan as if alone (the paper's), or one after another, each leaving out the
        cells that the robots before it are about to see.

    Raises
    ------
    ValueError
        If an option is not one of its choices.
    """

    def __init__(
        self, search: Search = "exhaustive", coordination: Coordination = "independent"
    ) -> None:
        self.search: Search = checked_value("search", search, CheckedSearch)
        self.coordination: Coordination = checked_value("coordination", coordination, Coordination)
        self.rng = np.random.default_rng(0)

    def reset(self, rng: np.random.Generator) -> None:
        """Start an episode; `rng` draws the random poses."""
        self.rng = rng

    @abstractmethod
    def score(
        self, belief: Belief, robot: int, poses: Poses, reserved_mask: ReservedMask | None
    ) -> NDArray[np.float64]:
        """Score of each pose (k,), higher is better; reserved cells do not count."""

    def act(self, belief: Belief, observations: Observations) -> dict[str, Any]:
        """Choose the best pose of each robot, as actions."""
        sequential = self.coordination == "sequential" and len(belief.agents) > 1
        reserved_mask = np.zeros(belief.map.grid.n_cells, dtype=np.uint8) if sequential else None
        actions = {}
        for robot, agent in enumerate(belief.agents):
            best = self.best_pose(belief, robot, reserved_mask)
            actions[agent] = belief.action_for(robot, best)
            if reserved_mask is not None:
                reserved_mask[belief.visible_cells(robot, best)] = 1
        return actions

    def best_pose(self, belief: Belief, robot: int, reserved_mask: ReservedMask | None) -> Any:
        """The best-scored pose of a robot."""

        def score(some_belief: Belief, poses: Poses) -> NDArray[np.float64]:
            return self.score(some_belief, robot, poses, reserved_mask)

        poses = belief.planning.prescreen(belief, self.candidate_poses(belief, robot), score)
        return poses[np.argmax(score(belief, poses))]

    def candidate_poses(self, belief: Belief, robot: int) -> Poses:
        """The poses to choose from."""
        return candidate_poses(belief, robot, self.search, self.rng)


class GainPlanner(Planner):
    """Maximises a gain minus the weighted motion that it takes.

    Parameters
    ----------
    search, coordination
        See `Planner`.
    motion_weight : float
        Gain that is worth one unit of d (Eq. 5). On training worlds of the planar environment, with
        32 to 300 candidates or any pose, the default keeps 95 to 99 % of the largest area under the
        coverage curve of all weights, with 0.55 to 0.81 of the motion of weight 0.
    """

    def __init__(
        self,
        search: Search = 100,
        coordination: Coordination = "independent",
        motion_weight: float = 0.006,
    ) -> None:
        super().__init__(search, coordination)
        self.motion_weight: float = checked_value("motion_weight", motion_weight, NonNegative)

    @abstractmethod
    def gain(
        self, belief: Belief, robot: int, poses: Poses, reserved_mask: ReservedMask | None
    ) -> NDArray[np.float64]:
        """Gain of each pose (k,), as a fraction of that of a full view."""

    def score(
        self, belief: Belief, robot: int, poses: Poses, reserved_mask: ReservedMask | None
    ) -> NDArray[np.float64]:
        """Gain minus the weighted distance."""
        gain = self.gain(belief, robot, poses, reserved_mask)
        return gain - self.motion_weight * belief.distance(robot, poses)
