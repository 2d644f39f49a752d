"""A team as rows of a vectorised environment of Stable-Baselines3: one policy for all robots.

Row ``i * n_robots + r`` is robot r of parallel environment i. When the robots of an environment are
done, it is reset in the same step:

==============================  ==================================================================
returned observation            the first of the next episode
info "terminal_observation"     the last of the ended one
info "TimeLimit.truncated"      whether it ended by truncation: then the robot could have gone on,
                                and PPO adds the value of "terminal_observation"
==============================  ==================================================================
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

from coopmap_env.envs.belief import Observation

from . import NEEDS_RL

try:
    from stable_baselines3.common.vec_env import VecEnv
except ImportError as error:
    raise ImportError(NEEDS_RL) from error

EnvFactory = Callable[[], ParallelEnv[str, Observation, Any]]
Indices = int | Iterable[int] | None
Info = dict[str, Any]


def stack(observations: Iterable[Observation]) -> Observation:
    """Observations of n robots as one, each entry with a new first axis of length n."""
    rows = list(observations)
    return {key: np.stack([row[key] for row in rows]) for key in rows[0]}


class SharedPolicyVecEnv(VecEnv):
    """`n_envs` parallel environments in this process; each robot is one row.

    Parameters
    ----------
    env_factory : callable
        Makes a new parallel environment, such as ``lambda: planar_v0.parallel_env(n_robots=3)``.
        Its robots must have the same spaces and end their episode together.
    n_envs : int
        Number of parallel environments; ``num_envs``, the number of rows, is n_robots times that.

    Raises
    ------
    ValueError
        If there is no environment, the factory gives one twice, or robots differ in their spaces.
    """

    def __init__(self, env_factory: EnvFactory, n_envs: int) -> None:
        if n_envs < 1:
            raise ValueError(f"n_envs must be at least 1, got {n_envs}")
        self.envs = [env_factory() for _ in range(n_envs)]
        if len({id(env) for env in self.envs}) < n_envs:
            raise ValueError("env_factory must make a new environment on each call")
        self.robots = tuple(self.envs[0].possible_agents)
        observation_space, action_space = self._common_spaces()
        self._actions: NDArray[Any] = np.empty(0)
        self._observations: Observation = {}
        super().__init__(n_envs * len(self.robots), observation_space, action_space)

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Give every environment its own seed at the next reset; None draws a fresh one.

        The seeds are drawn from `seed`, not counted up from it: trainings with seeds 0 and 1 would
        otherwise share all worlds but one.

        Returns
        -------
        list of int
            One for each row; the robots of an environment share it.
        """
        drawn = np.random.SeedSequence(seed).generate_state(len(self.envs))
        self._seeds = [int(number) for number in drawn for _ in self.robots]
        return self._seeds

    def reset(self) -> Observation:
        """Start an episode in each environment; seeds and options count once."""
        rows: list[Observation] = []
        for i, env in enumerate(self.envs):
            first = i * len(self.robots)
            rows += self._reset_one(
                i, env.reset(seed=self._seeds[first], options=self._options[first] or None)
            )
        self._reset_seeds()
        self._reset_options()
        self._observations = stack(rows)
        return self._observations

    def step_async(self, actions: NDArray[Any]) -> None:
        """Keep the actions, one for each row, for `step_wait`."""
        self._actions = actions

    def step_wait(
        self,
    ) -> tuple[Observation, NDArray[np.float32], NDArray[np.bool_], list[Info]]:
        """Step all environments, and reset those that are done."""
        observations: list[Observation] = []
        rewards, dones = np.empty(self.num_envs, np.float32), np.empty(self.num_envs, np.bool_)
        infos: list[Info] = []
        for i in range(len(self.envs)):
            rows = self._rows(i)
            step = self._step_one(i, self._actions[rows])
            observations += step[0]
            rewards[rows], dones[rows] = step[1], step[2]
            infos += step[3]
        self._observations = stack(observations)
        return self._observations, rewards, dones, infos

    def action_masks(self) -> NDArray[np.bool_]:
        """Which candidates each robot can take now, shape (num_envs, m).

        Also there as ``env_method("action_masks")``, where sb3-contrib's MaskablePPO looks.

        Raises
        ------
        AttributeError
            If observations have no mask, as in "pose" mode.
        RuntimeError
            Before the first reset.
        """
        if not self._is_masked:
            raise AttributeError("observations have no action_mask: these actions are not masked")
        if not self._observations:
            raise RuntimeError("call reset() first: there are no observations yet")
        return self._observations["action_mask"].astype(bool)

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        """An attribute of the environment of each row."""
        rows = self._get_indices(indices)
        if attr_name == "action_masks" and self._is_masked:
            return [self.action_masks for _ in rows]
        return [getattr(self.envs[row // len(self.robots)], attr_name) for row in rows]

    def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
        """Set an attribute of the environment of each row, which other rows share."""
        for row in self._get_indices(indices):
            setattr(self.envs[row // len(self.robots)], attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: Indices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method of the environments, once for each; its rows share the result."""
        rows = list(self._get_indices(indices))
        if method_name == "action_masks":
            return list(self.action_masks()[rows])
        numbers = [row // len(self.robots) for row in rows]
        results = {
            i: getattr(self.envs[i], method_name)(*method_args, **method_kwargs)
            for i in dict.fromkeys(numbers)
        }
        return [results[i] for i in numbers]

    def env_is_wrapped(self, wrapper_class: type[Any], indices: Indices = None) -> list[bool]:
        """Never: Gymnasium's wrappers do not fit parallel environments."""
        return [False for _ in self._get_indices(indices)]

    def get_images(self) -> list[NDArray[np.uint8] | None]:
        """One picture of each environment, not of each row; `render` tiles them."""
        return [env.render() for env in self.envs]

    def close(self) -> None:
        """Close all environments."""
        for env in self.envs:
            env.close()

    @property
    def _is_masked(self) -> bool:
        return "action_mask" in self.observation_space.spaces  # type: ignore[attr-defined]

    def _rows(self, i: int) -> slice:
        return slice(i * len(self.robots), (i + 1) * len(self.robots))

    def _step_one(
        self, i: int, actions: NDArray[Any]
    ) -> tuple[list[Observation], list[float], bool, list[Info]]:
        """Step environment i, and reset it if it is done."""
        robots, env = self.robots, self.envs[i]
        observations, rewards, terminated, truncated, infos = env.step(
            dict(zip(robots, actions, strict=True))
        )
        done = {robot: bool(terminated[robot] or truncated[robot]) for robot in robots}
        if len(set(done.values())) > 1:
            raise RuntimeError(f"robots must end their episode together, got {done}")
        rows = [observations[robot] for robot in robots]
        each: list[Info] = [dict(infos[robot]) for robot in robots]
        for robot, info in zip(robots, each, strict=True):
            info["TimeLimit.truncated"] = bool(truncated[robot] and not terminated[robot])
        ended = done[robots[0]]
        if ended:
            for info, row in zip(each, rows, strict=True):
                info["terminal_observation"] = row
            rows = self._reset_one(i, env.reset())
        return rows, [rewards[robot] for robot in robots], ended, each

    def _reset_one(
        self, i: int, reset: tuple[dict[str, Observation], dict[str, Info]]
    ) -> list[Observation]:
        """Keep the infos of a reset of environment i, and give its observations in order."""
        observations, infos = reset
        self.reset_infos[self._rows(i)] = [infos[robot] for robot in self.robots]
        return [observations[robot] for robot in self.robots]

    def _common_spaces(self) -> tuple[spaces.Dict, spaces.Space[Any]]:
        env, first = self.envs[0], self.robots[0]
        observation_space, action_space = env.observation_space(first), env.action_space(first)
        if not isinstance(observation_space, spaces.Dict):
            raise ValueError(f"observations must be a Dict space, got {observation_space}")
        for robot in self.robots:
            both = (env.observation_space(robot), env.action_space(robot))
            if both != (observation_space, action_space):
                raise ValueError(
                    f"robots that share a policy must share their spaces: {robot} has {both}, "
                    f"{first} has {(observation_space, action_space)}"
                )
        return observation_space, action_space
