"""A team as rows of a vectorised environment of Stable-Baselines3: one policy for all robots.

Row ``i * n_robots + r`` is robot r of parallel environment i. When the robots of an environment are
done, it is reset in the same step:

==============================  ==================================================================
returned observation            the first of the next episode
info "terminal_observation"     the last of the ended one
info "TimeLimit.truncated"      whether it ended by truncation: then the robot could have gone on,
                                and PPO adds the value of "terminal_observation"
observation "state"             only ``with_state``: the environment's ``state()``, the same for all
                                of its robots, for a centralised critic
==============================  ==================================================================

With worker processes, rows, order and numbers are the same as without.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from operator import methodcaller
from typing import Any

import numpy as np
from coopmap_agents import RL_EXTRA_HINT
from coopmap_agents.rollouts.team_block import (
    BlockStep,
    EnvFactory,
    Info,
    concatenate_blocks,
    stack,
)
from coopmap_agents.rollouts.workers import LocalBlock, Requests, WorkerPool
from numpy.typing import NDArray

from coopmap_env.envs.belief import Observation

try:
    from stable_baselines3.common.vec_env import VecEnv
except ImportError as error:
    raise ImportError(RL_EXTRA_HINT) from error

__all__ = ["EnvFactory", "SharedPolicyVecEnv", "stack"]

Indices = int | Iterable[int] | None


class SharedPolicyVecEnv(VecEnv):
    """`n_envs` parallel environments; each robot is one row.

    Parameters
    ----------
    env_factory : callable
        Makes a new parallel environment, such as ``lambda: planar_v0.parallel_env(n_robots=3)``.
        Its robots must have the same spaces and end their episode together. Workers get copies of
        it, by cloudpickle: it should not count its calls.
    n_envs : int
        Number of parallel environments; ``num_envs``, the number of rows, is n_robots times that.
    workers : int
        Processes over which they are spread evenly; 0 steps all of them in this process. Workers
        are spawned and import the main script: what it runs belongs under
        ``if __name__ == "__main__":``.
    with_state : bool
        Adds the environment's state to the observations of its robots, as entry "state".

    Raises
    ------
    ValueError
        If `n_envs` or `workers` is out of its range, the factory gives an environment twice, robots
        differ in their spaces, or there is no state.

    Notes
    -----
    What an environment raises in a worker is raised here, with the worker's traceback as a note; a
    RuntimeError tells of a worker that has ended. Call `reset` after the former, `close` after the
    latter. An interruption (Ctrl-C) while workers are awaited closes them.
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
            WorkerPool(env_factory, [len(members) for members in self._envs_of_block], with_state)
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
        """Give every environment its own seed at the next reset; None draws a fresh one.

        The seeds are drawn from `seed`, not counted up from it: trainings with seeds 0 and 1 would
        otherwise share all worlds but one.

        Returns
        -------
        list of int
            One for each row; the robots of an environment share it.
        """
        drawn = np.random.SeedSequence(seed).generate_state(self._envs_of_block[-1].stop)
        self._seeds = [int(number) for number in drawn for _ in self.robots]
        return self._seeds

    def reset(self) -> Observation:
        """Start an episode in each environment; seeds and options count once."""
        n_robots = len(self.robots)  # which share the seed and options of their environment
        seeds, options = self._seeds[::n_robots], self._options[::n_robots]
        replies = self._call(
            "reset",
            {
                i: ([seeds[k] for k in own], [options[k] or None for k in own])
                for i, own in enumerate(self._envs_of_block)
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
        """Send the actions, one for each row; without workers, keep them for `step_wait`."""
        self._request("step", {i: (actions[rows],) for i, rows in enumerate(self._rows)})

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

    def has_attr(self, attr_name: str) -> bool:
        """Whether all environments have an attribute, be it one that no worker can send."""
        if attr_name == "action_masks" and self._is_masked:
            return True
        return all(self._apply(None, hasattr, attr_name))

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        """An attribute of the environment of each row; from workers, a copy."""
        if attr_name == "action_masks" and self._is_masked:
            return [self.action_masks for _ in self._get_indices(indices)]
        return self._apply(indices, getattr, attr_name)

    def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
        """Set an attribute of the environment of each row, which other rows share."""
        self._apply(indices, setattr, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: Indices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method of the environments, once for each; its rows share the result."""
        if method_name == "action_masks":
            return list(self.action_masks()[list(self._get_indices(indices))])
        return self._apply(indices, methodcaller(method_name, *method_args, **method_kwargs))

    def env_is_wrapped(self, wrapper_class: type[Any], indices: Indices = None) -> list[bool]:
        """Never: Gymnasium's wrappers do not fit parallel environments."""
        return [False for _ in self._get_indices(indices)]

    def get_images(self) -> list[NDArray[np.uint8] | None]:
        """One picture of each environment, not of each row; `render` tiles them."""
        return self.env_method("render")[:: len(self.robots)]

    def close(self) -> None:
        """Close all environments and end their workers; more calls do nothing."""
        self._blocks.close()

    @property
    def _is_masked(self) -> bool:
        return "action_mask" in self.observation_space.spaces  # type: ignore[attr-defined]

    @property
    def _rows(self) -> list[slice]:
        """Of each block."""
        n = len(self.robots)
        return [slice(n * members.start, n * members.stop) for members in self._envs_of_block]

    def _apply(self, indices: Indices, function: Callable[..., Any], *arguments: Any) -> list[Any]:
        """Results of ``function(env, *arguments)``, computed once for all rows of an env."""
        rows = [range(self.num_envs)[index] for index in self._get_indices(indices)]
        numbers = [row // len(self.robots) for row in rows]
        wanted = {i: sorted(set(own) & set(numbers)) for i, own in enumerate(self._envs_of_block)}
        wanted = {i: own for i, own in wanted.items() if own}
        replies = self._call(
            "apply",
            {
                i: ([number - self._envs_of_block[i].start for number in own], function, *arguments)
                for i, own in wanted.items()
            },
        )
        results: dict[int, Any] = {}
        for own, values in zip(wanted.values(), replies, strict=True):
            results.update(zip(own, values, strict=True))
        return [results[number] for number in numbers]

    def _call(self, method: str, arguments: Requests) -> list[Any]:
        """Replies of the blocks that are asked, in order."""
        self._request(method, arguments)
        return list(self._blocks.replies().values())

    def _request(self, method: str, arguments: Requests) -> None:
        if self._blocks.closed:
            raise RuntimeError("these environments are closed: make a new SharedPolicyVecEnv")
        self._blocks.request(method, arguments)
