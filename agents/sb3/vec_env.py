"""A vector environment as one of Stable-Baselines3: one policy for all robots.

Row ``world * n_robots + robot`` is a robot. When the robots of a world are done, it is reset in the
same step:

==============================  ==================================================================
returned observation            the first of the next episode
info "terminal_observation"     the last of the episode that ended
info "TimeLimit.truncated"      whether it ended by truncation: then PPO bootstraps with the value
                                of "terminal_observation"
==============================  ==================================================================

Stable-Baselines3 keeps what it gets, so all arrays are copies.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from operator import methodcaller
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from coopmap_env.envs import Observation
from coopmap_env.vector import MappingVectorEnv

Indices = int | Iterable[int] | None
Info = dict[str, Any]


class SharedPolicyVecEnv(VecEnv):
    """The rows of a vector environment; each robot is one row.

    Parameters
    ----------
    env : MappingVectorEnv
        With ``rows="agents"`` and ``autoreset_mode="SameStep"``; see `make_rows`.

    Raises
    ------
    ValueError
        If it has other rows or another mode.
    """

    def __init__(self, env: MappingVectorEnv[Any]) -> None:
        if env.rows != "agents" or env.autoreset_mode is not AutoresetMode.SAME_STEP:
            raise ValueError(
                'a SharedPolicyVecEnv needs rows="agents" and autoreset_mode="SameStep", got '
                f"{env.rows!r} and {env.autoreset_mode.value!r}"
            )
        self.env = env
        self.robots = env.robots
        self._observations: Observation = {}
        self._actions: NDArray[Any] | None = None
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seed all worlds at the next reset, each differently; None for random seeds.

        The seeds are drawn from `seed`. Consecutive seeds would not do: trainings with seeds 0 and
        1 would share all worlds but one.

        Returns
        -------
        list of int
            One seed for each row; the robots of a world have the same.
        """
        drawn = np.random.SeedSequence(seed).generate_state(self.env.n_worlds)
        self._seeds = [int(number) for number in drawn for _ in self.robots]
        return self._seeds

    def reset(self) -> Observation:
        """Start an episode in each world; seeds and options are used once."""
        options = self._options[0]
        if any(own != options for own in self._options):
            raise ValueError("all rows share their options, got different ones")
        observations, infos = self.env.reset(
            seed=self._seeds[:: len(self.robots)], options=options or None
        )
        self._reset_seeds()
        self._reset_options()
        self.reset_infos = _by_row(infos, self.num_envs)
        self._observations = {key: values.copy() for key, values in observations.items()}
        return self._observations

    def step_async(self, actions: NDArray[Any]) -> None:
        """Store the actions, one for each row, for `step_wait`."""
        self._actions = actions

    def step_wait(
        self,
    ) -> tuple[Observation, NDArray[np.float32], NDArray[np.bool_], list[Info]]:
        """Step all worlds, and reset those that are done.

        Raises
        ------
        RuntimeError
            If there was no `step_async` before.
        """
        if self._actions is None:
            raise RuntimeError("call step_async() before step_wait(): there are no actions")
        actions, self._actions = self._actions, None
        observations, rewards, terminated, truncated, infos = self.env.step(actions)
        self._observations = {key: values.copy() for key, values in observations.items()}
        by_row, dones = _by_row(infos, self.num_envs), terminated | truncated
        if dones.any():
            final_infos = _by_row(infos["final_info"], self.num_envs)
            for row in np.flatnonzero(dones).tolist():
                self.reset_infos[row], by_row[row] = by_row[row], final_infos[row]
                last = infos["final_obs"][row]
                by_row[row]["terminal_observation"] = {k: own.copy() for k, own in last.items()}
        for info, is_cut in zip(by_row, (truncated & ~terminated).tolist(), strict=True):
            info["TimeLimit.truncated"] = is_cut
        return self._observations, rewards.astype(np.float32), dones, by_row

    def action_masks(self) -> NDArray[np.bool_]:
        """Mask of the candidates that each robot can take now, shape (num_envs, m).

        Also available as ``env_method("action_masks")``, which sb3-contrib's MaskablePPO calls.

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

    def has_attr(self, attr_name: str) -> bool:
        """Whether all environments have an attribute, which need not be picklable."""
        if attr_name == "action_masks" and self._is_masked:
            return True
        return all(self._apply(None, hasattr, attr_name))

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        """An attribute of the environment of each row; from workers, a copy."""
        if attr_name == "action_masks" and self._is_masked:
            return [self.action_masks for _ in self._get_indices(indices)]
        return self._apply(indices, getattr, attr_name)

    def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
        """Set an attribute of the environment of each row; rows of one environment share it."""
        self._apply(indices, setattr, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: Indices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method of each environment once; its rows share the result."""
        if method_name == "action_masks":
            return list(self.action_masks()[list(self._get_indices(indices))])
        return self._apply(indices, methodcaller(method_name, *method_args, **method_kwargs))

    def env_is_wrapped(self, wrapper_class: type[Any], indices: Indices = None) -> list[bool]:
        """False: Gymnasium's wrappers do not apply to parallel environments."""
        return [False for _ in self._get_indices(indices)]

    def get_images(self) -> list[NDArray[np.uint8] | None]:
        """One image of each environment, not of each row; `render` tiles them."""
        return list(self.env.render())

    def close(self) -> None:
        """Close the vector environment; repeated calls do nothing."""
        self.env.close()

    @property
    def _is_masked(self) -> bool:
        return "action_mask" in self.observation_space.spaces  # type: ignore[attr-defined]

    def _apply(self, indices: Indices, *call: Any) -> list[Any]:
        """Results of a function of each row's environment, `call` is (function, *arguments)."""
        rows = [range(self.num_envs)[index] for index in self._get_indices(indices)]
        world_of_row = [row // len(self.robots) for row in rows]
        worlds = sorted(set(world_of_row))
        results = dict(zip(worlds, self.env.apply(*call, worlds=worlds), strict=True))
        return [results[world] for world in world_of_row]


def _by_row(infos: Mapping[str, Any], n_rows: int) -> list[Info]:
    """One dictionary for each row, of the entries that it has."""
    by_row: list[Info] = [{} for _ in range(n_rows)]
    for key, values in infos.items():
        if key.startswith(("_", "final_")):
            continue
        own, mask = values.tolist(), infos[f"_{key}"].tolist()
        for info, value, has_value in zip(by_row, own, mask, strict=True):
            if has_value:
                info[key] = value
    return by_row
