"""A team as rows of a vectorised environment of Stable-Baselines3: one policy for all robots.

Row ``i * n_robots + r`` is robot r of parallel environment i. When the robots of an environment are
done, it is reset in the same step:

==============================  ==================================================================
returned observation            the first of the next episode
info "terminal_observation"     the last of the episode that ended
info "TimeLimit.truncated"      whether it ended by truncation: then PPO bootstraps with the value
                                of "terminal_observation"
observation "state"             only ``with_state``: the environment's ``state()``, the same for all
                                of its robots, for a centralised critic
==============================  ==================================================================

Worker processes change neither the rows nor their order nor any value.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise
from operator import methodcaller
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from coopmap_agents.rollouts import (
    BlockStep,
    EnvFactory,
    Info,
    LocalBlock,
    Requests,
    WorkerPool,
    concatenate_blocks,
)
from coopmap_env.envs import Observation

Indices = int | Iterable[int] | None


class SharedPolicyVecEnv(VecEnv):
    """`n_envs` parallel environments; each robot is one row.

    Parameters
    ----------
    env_factory : callable
        Makes a new parallel environment, such as ``lambda: planar_v1.parallel_env(n_robots=3)``.
        Its robots must have the same spaces and end their episode together. Each worker gets a
        copy of the factory, by cloudpickle: it must not depend on the number of its calls.
    n_envs : int
        Number of parallel environments; ``num_envs``, the number of rows, is n_robots times that.
    workers : int
        Number of processes, which share the environments evenly; 0 steps all of them in this
        process. Workers are spawned and import the main script: protect its body by
        ``if __name__ == "__main__":``.
    with_state : bool
        Adds the environment's state to the observations of its robots, as entry "state".

    Raises
    ------
    ValueError
        If `n_envs` or `workers` is out of range, the factory returns the same environment twice,
        robots have different spaces, or there is no state.

    Notes
    -----
    An exception of an environment in a worker is raised here, with the worker's traceback as a
    note: call `reset` afterwards. A RuntimeError reports that a worker has ended: call `close`.
    Ctrl-C while the main process waits for workers closes them.
    """

    def __init__(
        self, env_factory: EnvFactory, n_envs: int, workers: int = 0, with_state: bool = False
    ) -> None:
        if n_envs < 1:
            raise ValueError(f"n_envs must be at least 1, got {n_envs}")
        if not 0 <= workers <= n_envs:
            raise ValueError(f"workers must be 0 to n_envs ({n_envs}), got {workers}")
        n_blocks = workers or 1
        bounds = [n_envs * i // n_blocks for i in range(n_blocks + 1)]
        self._envs_of_block = [range(*pair) for pair in pairwise(bounds)]
        self._blocks: LocalBlock | WorkerPool = (
            WorkerPool(env_factory, [len(envs) for envs in self._envs_of_block], with_state)
            if workers
            else LocalBlock(env_factory, n_envs, with_state)
        )
        try:
            team_spaces = self._call("team_spaces", dict.fromkeys(range(n_blocks), ()))
            self.robots, observation_space, action_space = team_spaces[0]
            self._observations: Observation = {}
            super().__init__(n_envs * len(self.robots), observation_space, action_space)
        except BaseException:
            self.close()
            raise

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seed all environments at the next reset, each differently; None for random seeds.

        The seeds are drawn from `seed`. Consecutive seeds would not do: trainings with seeds 0 and
        1 would share all worlds but one.

        Returns
        -------
        list of int
            One seed for each row; the robots of an environment have the same.
        """
        drawn = np.random.SeedSequence(seed).generate_state(self._envs_of_block[-1].stop)
        self._seeds = [int(number) for number in drawn for _ in self.robots]
        return self._seeds

    def reset(self) -> Observation:
        """Start an episode in each environment; seeds and options are used once."""
        n_robots = len(self.robots)  # which share the seed and options of their environment
        seeds, options = self._seeds[::n_robots], self._options[::n_robots]
        replies = self._call(
            "reset",
            {
                block: ([seeds[k] for k in envs], [options[k] or None for k in envs])
                for block, envs in enumerate(self._envs_of_block)
            },
        )
        self._reset_seeds()
        self._reset_options()
        self.reset_infos = [info for _, infos in replies for info in infos]
        self._observations = concatenate_blocks(
            (observation for observation, _ in replies), n_robots
        )
        return self._observations

    def step_async(self, actions: NDArray[Any]) -> None:
        """Send the actions, one for each row; without workers, `step_wait` uses them."""
        self._request("step", {block: (actions[rows],) for block, rows in enumerate(self._rows)})

    def step_wait(
        self,
    ) -> tuple[Observation, NDArray[np.float32], NDArray[np.bool_], list[Info]]:
        """Step all environments, and reset those that are done.

        Raises
        ------
        RuntimeError
            If there was no `step_async` before.
        """
        steps: list[BlockStep] = list(self._blocks.replies().values())
        if not steps:
            raise RuntimeError("call step_async() before step_wait(): there are no actions")
        self._observations = concatenate_blocks(
            (step.observation for step in steps), len(self.robots)
        )
        new_infos = [info for step in steps for info in step.reset_infos]
        for row, info in enumerate(new_infos):
            if info is not None:
                self.reset_infos[row] = info
        rewards = np.concatenate([step.rewards for step in steps])
        dones = np.concatenate([step.dones for step in steps])
        infos = [info for step in steps for info in step.infos]
        return self._observations, rewards, dones, infos

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
        return self.env_method("render")[:: len(self.robots)]

    def close(self) -> None:
        """Close all environments and end their workers; repeated calls do nothing."""
        self._blocks.close()

    @property
    def _is_masked(self) -> bool:
        return "action_mask" in self.observation_space.spaces  # type: ignore[attr-defined]

    @property
    def _rows(self) -> list[slice]:
        """Rows of each block."""
        n = len(self.robots)
        return [slice(n * envs.start, n * envs.stop) for envs in self._envs_of_block]

    def _apply(self, indices: Indices, *call: Any) -> list[Any]:
        """Results of a function of each row's environment, `call` is (function, *arguments)."""
        rows = [range(self.num_envs)[index] for index in self._get_indices(indices)]
        env_of_row = [row // len(self.robots) for row in rows]
        env_numbers = {
            block: numbers
            for block, envs in enumerate(self._envs_of_block)
            if (numbers := sorted(set(envs) & set(env_of_row)))
        }
        replies = self._call(
            "apply",
            {
                block: ([number - self._envs_of_block[block].start for number in numbers], *call)
                for block, numbers in env_numbers.items()
            },
        )
        results: dict[int, Any] = {}
        for numbers, values in zip(env_numbers.values(), replies, strict=True):
            results.update(zip(numbers, values, strict=True))
        return [results[number] for number in env_of_row]

    def _call(self, method: str, arguments: Requests) -> list[Any]:
        """Results of a method of some blocks, in order."""
        self._request(method, arguments)
        return list(self._blocks.replies().values())

    def _request(self, method: str, arguments: Requests) -> None:
        if self._blocks.closed:
            raise RuntimeError("these environments are closed: make a new SharedPolicyVecEnv")
        self._blocks.request(method, arguments)
