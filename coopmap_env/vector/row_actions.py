"""Actions of all rows: checked before any world moves."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from coopmap_env.core.files import brief
from coopmap_env.envs import InvalidActionError
from coopmap_env.envs.actions import to_number_array
from coopmap_env.vector.rows import Rows


class ActionParser:
    """Checks the actions of all rows, and writes them into the memory.

    Parameters
    ----------
    rows : Rows
    target : array
        See `action_spec`.
    """

    def __init__(self, rows: Rows, target: NDArray[Any]) -> None:
        self._robots = rows.team.robots
        self._target = target
        self._shape = (rows.n_worlds * rows.per_world, *(rows.action_space.shape or ()))
        self._is_choice = isinstance(rows.team.actions[0], spaces.Discrete)
        lowest: list[Any] = []
        highest: list[Any] = []
        owner: list[int] = []
        for robot, space in enumerate(rows.team.actions):
            low, high = _bounds(space)
            lowest, highest = [*lowest, *low], [*highest, *high]
            owner += [robot] * len(low)
        self._low, self._high = np.array(lowest), np.array(highest)
        self._robot_of_column = owner

    def __call__(self, actions: Any, active: NDArray[np.bool_]) -> None:
        """Write the actions; those of worlds that are not active are neither checked nor used.

        Raises
        ------
        InvalidActionError
            Naming the world, the robot and the value; nothing is written.
        """
        values = to_number_array(actions)
        if values is None or values.shape != self._shape:
            raise InvalidActionError(
                f"the actions must be numbers of shape {self._shape}, got "
                + (brief(actions) if values is None else f"those of shape {values.shape}")
            )
        if self._is_choice and values.dtype.kind == "f":
            raise InvalidActionError(f"candidate actions are integers, got {values.dtype} numbers")
        by_world = values.reshape(self._target.shape)
        is_valid = (self._low <= by_world) & (by_world <= self._high)  # NaN is not
        if not is_valid.all():
            invalid = ~is_valid & active[:, None]
            if invalid.any():
                raise self._error(by_world, *np.argwhere(invalid)[0].tolist())
            by_world = np.where(is_valid, by_world, self._low)  # of worlds that do not act
        self._target[...] = by_world

    def _error(self, by_world: NDArray[Any], world: int, column: int) -> InvalidActionError:
        robot = self._robot_of_column[column]
        name = f"world {world}, {self._robots[robot]}"
        low, high = self._low[column].item(), self._high[column].item()
        if self._is_choice:
            return InvalidActionError(
                f"{name}: a candidate action must lie in {low} ... {high}, "
                f"got {by_world[world, column]}"
            )
        own = by_world[world, [owner == robot for owner in self._robot_of_column]]
        return InvalidActionError(
            f"{name}: each number of an action must lie in [{low:g}, {high:g}], "
            f"got {brief(own.tolist())}"
        )


def _bounds(space: spaces.Space[Any]) -> tuple[list[Any], list[Any]]:
    """Lowest and highest value of each number of an action."""
    if isinstance(space, spaces.Discrete):
        first = int(space.start)
        return [first], [first + int(space.n) - 1]
    assert isinstance(space, spaces.Box)
    return space.low.ravel().tolist(), space.high.ravel().tolist()
