"""Action modes: what an action means, its space, and the action that leads to a pose.

=============  ==========================  ======================================================
mode           space (one robot)           meaning
=============  ==========================  ======================================================
"pose"         Box(-1, 1, (3,), float32)   camera pose relative to the current one, in its frame:
                                           [ahead / reach, left / reach, turn / pi]; the nearest
                                           lattice pose is taken
"candidates"   Discrete(m)                 index into the m random feasible poses on offer
=============  ==========================  ======================================================
"""

from __future__ import annotations

import math
from typing import Any, Protocol

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from coopmap_env.envs.belief import Belief
from coopmap_env.geometry import to_camera_frame


class InvalidActionError(ValueError):
    """An action that is no member of its space; the environment stays as it was."""


class ActionMode(Protocol):
    """How actions of one robot are written and read."""

    def space(self) -> spaces.Space[Any]:
        """Make a new space for one robot."""

    def decode(self, agent: str, action: Any, belief: Belief) -> tuple[int, str]:
        """Lattice pose that the action asks for, and why it cannot be taken (or empty).

        Raises
        ------
        InvalidActionError
            Naming the robot and the value.
        """

    def encode(self, robot: int, pose_id: int, belief: Belief) -> Any:
        """Write the action that leads a robot to a lattice pose.

        Raises
        ------
        InvalidActionError
            If no action of one step does.
        """


class PoseMode:
    """Continuous poses relative to the current one."""

    def __init__(self, reach: float) -> None:
        self._scale = np.array([reach, reach, math.pi])

    def space(self) -> spaces.Box:
        """Box(-1, 1, (3,), float32)."""
        return spaces.Box(-1.0, 1.0, (3,), np.float32)

    def decode(self, agent: str, action: Any, belief: Belief) -> tuple[int, str]:
        """Nearest lattice pose to the one asked for."""
        try:
            numbers = np.asarray(action, dtype=np.float64)
        except (TypeError, ValueError):
            numbers = np.empty(0)
        if numbers.shape != (3,):
            raise InvalidActionError(
                f"{agent}: a pose action is 3 numbers [ahead, left, turn], got {action!r}"
            )
        ahead, left, turn = numbers.tolist()
        if not (abs(ahead) <= 1 and abs(left) <= 1 and abs(turn) <= 1):  # NaN fails too
            raise InvalidActionError(
                f"{agent}: each number of a pose action must lie in [-1, 1], got {action!r}"
            )
        robot = belief.agents.index(agent)
        reach, _, half_turn = self._scale.tolist()
        x, y, heading = belief.lattice.pose(belief.pose_ids[robot])
        c, s = math.cos(heading), math.sin(heading)
        target = (
            x + reach * (c * ahead - s * left),
            y + reach * (s * ahead + c * left),
            heading + half_turn * turn,
        )
        pose_id = belief.lattice.nearest(target)
        return pose_id, belief.why_not(robot, pose_id)

    def encode(self, robot: int, pose_id: int, belief: Belief) -> NDArray[np.float32]:
        """Write the relative pose, as shares of the reach and of half a turn."""
        relative = to_camera_frame(belief.lattice.poses(pose_id), belief.poses[robot])
        action = relative / self._scale
        if np.abs(action).max() > 1 + 1e-6:
            raise InvalidActionError(
                f"{belief.agents[robot]}: pose {pose_id} is out of reach: {relative} from here"
            )
        return np.clip(action, -1, 1).astype(np.float32)


class CandidateMode:
    """A choice among random feasible poses: the paper's random-m search."""

    def __init__(self, n_candidates: int) -> None:
        self.n_candidates = n_candidates

    def space(self) -> spaces.Discrete:
        """Discrete(m)."""
        return spaces.Discrete(self.n_candidates)

    def decode(self, agent: str, action: Any, belief: Belief) -> tuple[int, str]:
        """Read the candidate of that index; one that is masked out cannot be taken."""
        value = np.asarray(action)
        if value.shape != () or not np.issubdtype(value.dtype, np.integer):
            raise InvalidActionError(f"{agent}: a candidate action is one integer, got {action!r}")
        index = int(value)
        if not 0 <= index < self.n_candidates:
            raise InvalidActionError(
                f"{agent}: a candidate action must lie in 0 ... {self.n_candidates - 1}, "
                f"got {index}"
            )
        offers = self._offers(belief, belief.agents.index(agent))
        if index >= len(offers):
            return -1, f"candidate {index} is masked out: only {len(offers)} poses are feasible"
        return int(offers[index]), ""

    def encode(self, robot: int, pose_id: int, belief: Belief) -> np.int64:
        """Index of the pose among the candidates on offer."""
        (matches,) = np.nonzero(self._offers(belief, robot) == pose_id)
        if not len(matches):
            raise InvalidActionError(
                f"{belief.agents[robot]}: pose {pose_id} is not among the candidates on offer"
            )
        return np.int64(matches[0])

    @staticmethod
    def _offers(belief: Belief, robot: int) -> NDArray[np.int64]:
        if belief.offers is None:
            raise InvalidActionError("this belief carries no candidates")
        return belief.offers[robot]
