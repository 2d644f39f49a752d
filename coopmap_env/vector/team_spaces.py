"""Names, spaces and infos of a team's robots, which all worlds of a vector environment share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

from gymnasium import spaces
from pettingzoo import ParallelEnv

from coopmap_env.envs import InfoTypes

Team: TypeAlias = "ParallelEnv[str, Any, Any]"


@dataclass(frozen=True)
class TeamSpaces:
    """What the worlds of a vector environment have in common.

    Raises
    ------
    ValueError
        If observations are no dictionaries of arrays with at least one axis, or there is no state
        where it is needed.
    """

    robots: tuple[str, ...]
    observations: tuple[spaces.Dict, ...]
    """Observation space of each robot."""
    actions: tuple[spaces.Space[Any], ...]
    """Action space of each robot."""
    state: spaces.Box | None
    """Space of the state, if it is observed."""
    info_types: InfoTypes
    """Entries of a robot's info."""
    metadata: Mapping[str, Any]
    render_mode: str | None

    def __post_init__(self) -> None:
        for robot, space in zip(self.robots, self.observations, strict=True):
            if not isinstance(space, spaces.Dict):
                raise ValueError(f"observations must be a Dict space, got {space} for {robot}")
            for key, box in space.spaces.items():
                if not isinstance(box, spaces.Box) or not box.shape:
                    raise ValueError(
                        f"the observation {key!r} of {robot} must be a Box with at least one axis, "
                        f"got {box}"
                    )
        if self.state is not None and "state" in self.observations[0].spaces:
            raise ValueError(
                'with_state=True would overwrite the entry "state" of the observations'
            )

    @classmethod
    def from_env(cls, env: Team, with_state: bool) -> TeamSpaces:
        """Names and spaces of an environment; infos are those that it declares the types of."""
        state = getattr(env, "state_space", None) if with_state else None
        if with_state and state is None:
            raise ValueError(f"with_state=True needs an environment with a state_space, not {env}")
        robots = tuple(env.possible_agents)
        return cls(
            robots,
            tuple(env.observation_space(robot) for robot in robots),
            tuple(env.action_space(robot) for robot in robots),
            state,
            dict(getattr(env, "info_types", {})),
            dict(env.metadata),
            getattr(env, "render_mode", None),
        )
