"""Rows of a vector environment: the robots of all worlds, or their teams.

=========  =====================================  ==========================================
           rows="agents"                          rows="teams"
=========  =====================================  ==========================================
a row      a robot, world * n_robots + robot      a world
is like    a robot of `MappingEnv`                `TeamEnv`
reward     the robot's                            the sum over the robots
an info    (rows,)                                (rows, n_robots)
=========  =====================================  ==========================================
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from coopmap_env.envs.team import team_action_space, team_observation_space
from coopmap_env.vector.step_arrays import StepArrays
from coopmap_env.vector.team_spaces import TeamSpaces

RowName = Literal["agents", "teams"]


class RowViews(NamedTuple):
    """Arrays of a buffer by row: views, except for the rewards of teams."""

    observations: dict[str, NDArray[Any]]
    rewards: NDArray[np.float64]
    terminations: NDArray[np.bool_]
    truncations: NDArray[np.bool_]
    infos: dict[str, NDArray[Any]]


@dataclass(frozen=True)
class Rows:
    """How the arrays of a number of worlds are seen as rows.

    Raises
    ------
    ValueError
        If rows are robots and these have different spaces.
    """

    team: TeamSpaces
    n_worlds: int
    of: RowName

    def __post_init__(self) -> None:
        both = list(zip(self.team.observations, self.team.actions, strict=True))
        for robot, own in zip(self.team.robots, both, strict=True):
            if self.of == "agents" and own != both[0]:
                raise ValueError(
                    f"robots that are rows must share their spaces: {robot} has {own}, "
                    f'{self.team.robots[0]} has {both[0]}; rows="teams" needs no equal spaces'
                )

    @property
    def per_world(self) -> int:
        """Rows of each world."""
        return len(self.team.robots) if self.of == "agents" else 1

    @property
    def observation_space(self) -> spaces.Dict:
        """Space of a row's observation."""
        team = self.team
        own = (
            team.observations[0]
            if self.of == "agents"
            else team_observation_space(team.observations)
        )
        state = {} if team.state is None else {"state": team.state}
        return spaces.Dict({**own.spaces, **state})

    @property
    def action_space(self) -> spaces.Space[Any]:
        """Space of a row's action."""
        actions = self.team.actions
        return actions[0] if self.of == "agents" else team_action_space(actions)

    def views(self, arrays: StepArrays) -> RowViews:
        """See the arrays of a buffer by row."""
        is_team = self.of == "teams"
        return RowViews(
            {key: self.split(values) for key, values in arrays.observations.items()},
            np.zeros(self.n_worlds) if is_team else self.flat(arrays.rewards),
            arrays.terminations[:, 0] if is_team else self.flat(arrays.terminations),
            arrays.truncations[:, 0] if is_team else self.flat(arrays.truncations),
            {key: self.flat(values) for key, values in arrays.infos.items()},
        )

    def flat(self, values: NDArray[Any]) -> NDArray[Any]:
        """Entries (E, n, ...) of robots by row."""
        return values if self.of == "teams" else values.reshape(-1, *values.shape[2:])

    def split(self, values: NDArray[Any]) -> NDArray[Any]:
        """Entries (E, n * k, ...), the robots' one after another, by row."""
        n_parts, length = self.per_world, values.shape[1] // self.per_world
        return values.reshape(self.n_worlds * n_parts, length, *values.shape[2:])

    def of_worlds(self, worlds: NDArray[Any]) -> NDArray[Any]:
        """Values (E,) of worlds by row."""
        return worlds.repeat(self.per_world)
