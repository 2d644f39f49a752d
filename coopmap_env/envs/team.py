"""The whole team as one Gymnasium agent: one controller moves every camera."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.utils import EzPickle
from numpy.typing import NDArray

from coopmap_env.envs.actions import InvalidActionError
from coopmap_env.envs.observations import Observation
from coopmap_env.envs.planar import PlanarEnv


class TeamEnv(gymnasium.Env[Observation, Any], EzPickle):
    """`PlanarEnv` seen by a single agent; takes the same arguments.

    Observations are those of the robots, each entry concatenated along its first axis (maps along
    their channels). The action is the robots' actions in a row: ``Box(-1, 1, (3 n_robots,))`` or
    ``MultiDiscrete([m] * n_robots)``. The reward is the sum over the robots; ``infos`` are keyed by
    robot under ``"robots"``.
    """

    metadata = PlanarEnv.metadata

    def __init__(self, render_mode: str | None = None, **arguments: Any) -> None:
        EzPickle.__init__(self, render_mode, **arguments)
        self.parallel = PlanarEnv(render_mode=render_mode, **arguments)
        self.render_mode = render_mode
        agents = self.parallel.possible_agents
        one = self.parallel.observation_space(agents[0])
        assert isinstance(one, spaces.Dict)
        self.observation_space = spaces.Dict(
            {key: _repeated(box, len(agents)) for key, box in one.spaces.items()}
        )
        action = self.parallel.action_space(agents[0])
        self.action_space: spaces.Space[Any]
        if isinstance(action, spaces.Discrete):
            self.action_space = spaces.MultiDiscrete([int(action.n)] * len(agents))
        else:
            self.action_space = spaces.Box(-1.0, 1.0, (3 * len(agents),), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode; see `PlanarEnv.reset`."""
        observations, infos = self.parallel.reset(seed=seed, options=options)
        super().reset(seed=None if seed is None else int(seed))  # after the check of the seed
        return self._joined(observations), {"robots": infos}

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Move and look with all robots; see `PlanarEnv.step`.

        Raises
        ------
        InvalidActionError
            If the action has the wrong size, or a robot's part of it is invalid.
        """
        agents = self.parallel.possible_agents
        flat: NDArray[Any] = np.asarray(action)
        if flat.shape != self.action_space.shape:
            raise InvalidActionError(
                f"the team's action must have shape {self.action_space.shape}, got {flat.shape}"
            )
        if isinstance(self.action_space, spaces.Box):
            flat = flat.reshape(len(agents), 3)
        parts = dict(zip(agents, flat, strict=True))
        observations, rewards, _, truncations, infos = self.parallel.step(parts)
        truncated = truncations[agents[0]]
        return (
            self._joined(observations),
            float(sum(rewards.values())),
            False,
            truncated,
            {"robots": infos},
        )

    def render(self) -> Any:
        """See `PlanarEnv.render`."""
        return self.parallel.render()

    def close(self) -> None:
        """See `PlanarEnv.close`."""
        self.parallel.close()

    @staticmethod
    def _joined(observations: dict[str, Observation]) -> Observation:
        each = list(observations.values())
        return {key: np.concatenate([o[key] for o in each]) for key in each[0]}


def _repeated(space: spaces.Space[Any], times: int) -> spaces.Box:
    assert isinstance(space, spaces.Box)
    return spaces.Box(
        np.concatenate([space.low] * times),
        np.concatenate([space.high] * times),
        dtype=space.low.dtype.type,
    )
