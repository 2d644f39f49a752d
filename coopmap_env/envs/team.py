"""The whole team as one Gymnasium agent: one controller moves every camera."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from coopmap_env.core.files import brief
from coopmap_env.core.linear_algebra import total
from coopmap_env.envs.actions import InvalidActionError, to_number_array
from coopmap_env.envs.belief import Observation
from coopmap_env.envs.mapping_env import MappingEnv
from coopmap_env.envs.step_data import Infos, InfoTypes


class TeamEnv(gymnasium.Env[Observation, Any]):
    """A parallel environment seen by a single agent; takes the same arguments.

    Observations are those of the robots, each entry concatenated along its first axis (maps along
    their channels). The action is the robots' actions one after another: a ``Box(-1, 1)`` of
    all their values, or ``MultiDiscrete([m] * n_robots)``. The reward is the *sum* over the robots
    (with ``team_reward="shared"``, the parallel environment pays each of them the *mean*, which has
    the same sum). Entries of the info are arrays (n_robots,) of those of the robots.
    """

    parallel_env: ClassVar[Callable[..., MappingEnv[Any]]]
    """The parallel environment; set by each subclass."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        self.parallel = type(self).parallel_env(*args, **kwargs)
        self.render_mode = self.parallel.render_mode
        agents = self.parallel.possible_agents
        each: list[Any] = [self.parallel.observation_space(agent) for agent in agents]
        self.observation_space = team_observation_space(each)
        actions: list[Any] = [self.parallel.action_space(agent) for agent in agents]
        self.action_space: spaces.Space[Any] = team_action_space(actions)
        lengths = [action.shape[0] if action.shape else 1 for action in actions]
        self._masks: NDArray[np.bool_] | None = None
        self._split_indices = np.cumsum(lengths)[:-1].tolist()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode; see `MappingEnv.reset`."""
        observations, infos = self.parallel.reset(seed=seed, options=options)
        super().reset(seed=None if seed is None else int(seed))  # after the check of the seed
        return self._concatenate(observations), team_info(infos, self.parallel.info_types)

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Move and scan with all robots; see `MappingEnv.step`.

        Raises
        ------
        InvalidActionError
            If the action is no numbers of the right shape, or a robot's part of it is invalid.
        """
        agents = self.parallel.possible_agents
        flat = to_number_array(action)
        if flat is None:
            raise InvalidActionError(f"the team's action must be numbers, got {brief(action)}")
        if flat.shape != self.action_space.shape:
            raise InvalidActionError(
                f"the team's action must have shape {self.action_space.shape}, got {flat.shape}"
            )
        parts = dict(zip(agents, np.split(flat, self._split_indices), strict=True))
        if isinstance(self.action_space, spaces.MultiDiscrete):
            parts = {agent: part[0] for agent, part in parts.items()}
        observations, rewards, _, truncations, infos = self.parallel.step(parts)
        truncated = truncations[agents[0]]
        return (
            self._concatenate(observations),
            total(rewards.values()),
            False,
            truncated,
            team_info(infos, self.parallel.info_types),
        )

    def action_masks(self) -> NDArray[np.bool_]:
        """Mask (n_robots * m,) of the candidates that can be taken now, those of a robot together.

        sb3-contrib's MaskablePPO calls it.

        Raises
        ------
        AttributeError
            In "pose" mode.
        RuntimeError
            Before the first reset.
        """
        if not isinstance(self.action_space, spaces.MultiDiscrete):
            raise AttributeError("actions have no mask: make it with action_mode='candidates'")
        if self._masks is None:
            raise RuntimeError("call reset() first: there are no candidates yet")
        return self._masks.copy()

    def render(self) -> Any:
        """See `MappingEnv.render`."""
        return self.parallel.render()

    def close(self) -> None:
        """See `MappingEnv.close`."""
        self.parallel.close()

    def _concatenate(self, observations: Mapping[str, Observation]) -> Observation:
        team = team_observation(observations)
        if "action_mask" in team:
            self._masks = team["action_mask"].astype(np.bool_)
        return team


def team_observation(observations: Mapping[str, Observation]) -> Observation:
    """The observation of a team: each entry of its robots', concatenated."""
    each = list(observations.values())
    return {key: np.concatenate([one[key] for one in each]) for key in each[0]}


def team_info(infos: Infos, types: InfoTypes) -> dict[str, NDArray[Any]]:
    """The info of a team: arrays (n_robots,) of the entries of its robots'."""
    each = infos.values()
    return {key: np.array([info[key] for info in each], kind) for key, kind in types.items()}


def team_observation_space(robots: Sequence[spaces.Dict]) -> spaces.Dict:
    """Observation space of a team: each entry of its robots', concatenated."""
    return spaces.Dict(
        {key: _concatenate_boxes([space[key] for space in robots]) for key in robots[0]}
    )


def team_action_space(robots: Sequence[Any]) -> spaces.Space[Any]:
    """Action space of a team: MultiDiscrete of its robots' choices, or a Box of all numbers."""
    if isinstance(robots[0], spaces.Discrete):
        return spaces.MultiDiscrete([int(space.n) for space in robots])
    return _concatenate_boxes(robots)


def _concatenate_boxes(boxes: Sequence[Any]) -> spaces.Box:
    return spaces.Box(
        np.concatenate([box.low for box in boxes]),
        np.concatenate([box.high for box in boxes]),
        dtype=boxes[0].dtype.type,
    )
