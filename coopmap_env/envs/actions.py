"""Action modes: what an action means, its space, and the action that leads to a pose.

"candidates" is the same in every environment: a choice among random feasible poses. What "pose"
means is documented by each environment's own `actions`.

=============  ==========================  ======================================================
mode           space (one robot)           meaning
=============  ==========================  ======================================================
"pose"         Box(-1, 1, (n,), float32)   a camera pose; `planar.actions`, `field.actions`
"candidates"   Discrete(m)                 index into the m random feasible poses
=============  ==========================  ======================================================
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from coopmap_env.core.files import brief
from coopmap_env.envs.belief import Belief, Decoded, Poses
from coopmap_env.envs.reasons import RejectedReason

_USUAL = (np.ndarray, np.int64, int)


class InvalidActionError(ValueError):
    """An action that is not in its space; the environment is unchanged."""


def action_of_each(agents: Sequence[str], actions: Any) -> dict[str, Any]:
    """The action of each robot, from a mapping of exactly these.

    Raises
    ------
    InvalidActionError
        Naming the robots that are needed and what was given.
    """
    if not isinstance(actions, Mapping):
        raise InvalidActionError(f"one action for each of {agents} is needed, got {brief(actions)}")
    try:
        names = sorted(map(str, actions))
        given = {agent: actions[agent] for agent in agents} if set(actions) == set(agents) else None
    except Exception:  # a mapping of somebody else may raise whatever it likes
        names, given = [brief(actions)], None
    if given is None:
        raise InvalidActionError(f"one action for each of {agents} is needed, got {brief(names)}")
    return given


def to_number_array(action: Any) -> NDArray[Any] | None:
    """Integers or floats of an action, in any number of axes; None if it is something else.

    Numpy would convert more: strings, booleans among numbers, durations, bytes and the data under a
    mask.
    """
    if type(action) in _USUAL:  # nothing to look into: 3 us less a robot and step
        numbers = np.asarray(action)
        return numbers if numbers.dtype.kind in "iuf" else None
    if isinstance(action, np.ma.MaskedArray | bytes | bytearray | memoryview):
        return None
    try:
        numbers = np.asarray(action)
        parts = action if isinstance(action, Sequence) and numbers.ndim == 1 else ()
        kinds = {numbers.dtype.kind, *(np.asarray(part).dtype.kind for part in parts)}
    except Exception:  # ragged, or an object whose `__array__` raises whatever it likes
        return None
    return numbers if kinds <= set("iuf") else None


def parse_pose_action(agent: str, action: Any, names: tuple[str, ...]) -> NDArray[np.float64]:
    """Values of a "pose" action, shape (len(names),), each in [-1, 1].

    Raises
    ------
    InvalidActionError
        Naming the robot and the value.
    """
    numbers = to_number_array(action)
    if numbers is None or numbers.shape != (len(names),):
        raise InvalidActionError(
            f"{agent}: a pose action is {len(names)} numbers [{', '.join(names)}], "
            f"got {brief(action)}"
        )
    if not all(abs(number) <= 1 for number in numbers.tolist()):  # NaN fails too
        raise InvalidActionError(
            f"{agent}: each number of a pose action must lie in [-1, 1], got {brief(action)}"
        )
    return numbers.astype(np.float64)


class CandidateMode:
    """A choice among random feasible poses: the paper's random-m search."""

    def __init__(self, n_candidates: int) -> None:
        self.n_candidates = n_candidates

    def space(self, robot: int) -> spaces.Discrete:
        """Discrete(m)."""
        return spaces.Discrete(self.n_candidates)

    def parse(self, agent: str, action: Any) -> int:
        """The index that an action is.

        Raises
        ------
        InvalidActionError
            Naming the robot and the value.
        """
        value = to_number_array(action)
        if value is None or value.shape != () or value.dtype.kind == "f":
            raise InvalidActionError(
                f"{agent}: a candidate action is one integer, got {brief(action)}"
            )
        index = int(value)
        if not 0 <= index < self.n_candidates:
            raise InvalidActionError(
                f"{agent}: a candidate action must lie in 0 ... {self.n_candidates - 1}, "
                f"got {index}"
            )
        return index

    def decode(self, agent: str, action: Any, belief: Belief) -> Decoded:
        """The candidate of that index; one that is masked out is rejected."""
        index = self.parse(agent, action)
        candidates = self._candidates_of(belief, belief.agents.index(agent))
        if index >= len(candidates):
            return Decoded(None, RejectedReason.MASKED)
        return Decoded(candidates[index], RejectedReason.NONE)

    def encode(self, robot: int, pose: Any, belief: Belief) -> np.int64:
        """Index of the pose among the candidates."""
        candidates = self._candidates_of(belief, robot)
        (matches,) = np.nonzero((candidates == pose).reshape(len(candidates), -1).all(axis=1))
        if not len(matches):
            raise InvalidActionError(
                f"{belief.agents[robot]}: pose {pose} is not among the candidates"
            )
        return np.int64(matches[0])

    @staticmethod
    def _candidates_of(belief: Belief, robot: int) -> Poses:
        if belief.candidates is None:
            raise InvalidActionError("this belief has no candidates")
        return belief.candidates[robot]
