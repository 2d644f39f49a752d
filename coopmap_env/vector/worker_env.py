"""`WorkerVectorEnv`: any parallel environments of teams, in this process or in workers."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

from gymnasium.vector import AutoresetMode

from coopmap_env.core.arguments import check_count
from coopmap_env.vector.rows import RowName
from coopmap_env.vector.team_spaces import Team
from coopmap_env.vector.vector_env import MappingVectorEnv
from coopmap_env.vector.workers import LocalBlock, Requests, WorkerPool, shared_memory
from coopmap_env.vector.world_block import EnvFactory, WorldBlock


class WorkerVectorEnv(MappingVectorEnv[Team]):
    """Parallel environments, each stepped by itself; see `coopmap_env.vector`.

    Parameters
    ----------
    env_factory : callable
        Makes a new environment, such as ``lambda: planar_v1.parallel_env(n_robots=3)``. Its robots
        must end their episode together. Each worker gets a copy of the factory, by cloudpickle: it
        must not depend on the number of its calls. This process makes an environment too, to learn
        its spaces.
    n_envs : int
        Number of worlds.
    rows, autoreset_mode, double_buffer, with_state
        See `coopmap_env.vector`.
    num_workers : int
        Number of processes, which share the worlds evenly and have one thread each; 0 steps all
        worlds in this process. Results do not depend on it. Workers are spawned and import the main
        script: protect its body by ``if __name__ == "__main__":``.

    Raises
    ------
    ValueError
        If an argument is not accepted, or the factory makes no such environments.

    Notes
    -----
    An exception of an environment is raised with the world and the worker's traceback as notes:
    call `reset` afterwards. A `WorkerError` reports that a worker has ended: call `close`. Ctrl-C
    while the main process waits for workers closes them.
    """

    _blocks: LocalBlock | WorkerPool | None = None

    def __init__(
        self,
        env_factory: EnvFactory,
        n_envs: int,
        *,
        rows: RowName = "agents",
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        double_buffer: bool = False,
        with_state: bool = False,
        num_workers: int = 0,
    ) -> None:
        n_envs = check_count("n_envs", n_envs)
        num_workers = check_count("num_workers", num_workers, at_least=0)
        if num_workers > n_envs:
            raise ValueError(f"num_workers must be 0 to n_envs ({n_envs}), got {num_workers}")
        n_blocks = num_workers or 1
        bounds = [n_envs * i // n_blocks for i in range(n_blocks + 1)]
        self._worlds_of_block = [range(*pair) for pair in pairwise(bounds)]
        block = WorldBlock(env_factory, range(1 if num_workers else n_envs), with_state)
        with contextlib.ExitStack() as stack:
            stack.callback(block.close)
            super().__init__(
                block.team,
                n_envs,
                rows=rows,
                autoreset_mode=autoreset_mode,
                double_buffer=double_buffer,
                allocate=shared_memory if num_workers else bytearray,
            )
            n_states = self._rows.per_world
            if not num_workers:
                block.connect(self._plan, self._memory, n_states)
                self._blocks = LocalBlock(block)
                stack.pop_all()
        if num_workers:
            self._blocks = WorkerPool(
                env_factory, self._worlds_of_block, with_state, n_states, self._plan, self._memory
            )

    def world(self, index: int) -> Team:
        """The environment of one world itself; see `MappingVectorEnv.world`."""
        (index,) = self._check_worlds([index])
        if not isinstance(self._blocks, LocalBlock):
            raise RuntimeError(
                f"world {index} is in a worker process: use apply(function, worlds=[{index}]), or "
                "num_workers=0"
            )
        return self._blocks.block.world(index)

    def apply(
        self, function: Callable[..., Any], *arguments: Any, worlds: Sequence[int] | None = None
    ) -> list[Any]:
        """See `MappingVectorEnv.apply`; function, arguments and results are pickled for workers."""
        self._require_open()
        chosen = self._check_worlds(worlds)
        parts = {
            block: own
            for block, ours in enumerate(self._worlds_of_block)
            if (own := [world for world in chosen if world in ours])
        }
        replies = self._call_blocks(
            "apply", {block: (own, function, *arguments) for block, own in parts.items()}
        )
        results: dict[int, Any] = {}
        for block, own in parts.items():
            results.update(zip(own, replies[block], strict=True))
        return [results[world] for world in chosen]

    def close_extras(self, **kwargs: Any) -> None:
        """Close all environments and end their workers."""
        if self._blocks is not None:
            self._blocks.close()

    def _advance(
        self,
        buffer: int,
        stepped: Sequence[int],
        reset: Sequence[int],
        seeds: Sequence[int | None],
        options: dict[str, Any] | None,
    ) -> None:
        seed_of = dict(zip(reset, seeds, strict=True))
        requests = {}
        for block, ours in enumerate(self._worlds_of_block):
            steps = [world for world in stepped if world in ours]
            resets = [world for world in reset if world in ours]
            if steps or resets:
                requests[block] = (buffer, steps, resets, [seed_of[w] for w in resets], options)
        self._call_blocks("advance", requests)

    def _call_blocks(self, method: str, arguments: Requests) -> dict[int, Any]:
        """Results of a method of some blocks, by their numbers."""
        assert self._blocks is not None
        try:
            self._blocks.request(method, arguments)
            return self._blocks.replies()
        except Exception:
            raise
        except BaseException:  # the pool was killed
            self.close()
            raise
