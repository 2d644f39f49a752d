"""`PlanarVectorEnv`: many planar worlds, stepped by one compiled call."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from coopmap_env.core.arguments import check_count
from coopmap_env.envs import REWARD_TERMS
from coopmap_env.envs.budget import budget_fractions
from coopmap_env.envs.planar import PlanarEnv
from coopmap_env.envs.planar.env import PlanarWorldView
from coopmap_env.envs.planar.observations import ObservationArrays, TeamObservations
from coopmap_env.envs.planar.worlds import PlanarWorlds
from coopmap_env.envs.step_data import REWARD_PREFIX, EpisodeSeeds, SeedDraws
from coopmap_env.vector.rows import RowName
from coopmap_env.vector.step_arrays import StepArrays
from coopmap_env.vector.team_spaces import TeamSpaces
from coopmap_env.vector.vector_env import MappingVectorEnv
from coopmap_env.vector.world_access import naming_world

OUTCOMES = {
    "rejected_reason": "rejections",
    "collided": "collided",
    "new_information": "new_information",
    "distance": "distance",
    "new_cells": "new_cells",
    "entropy_reduction": "entropy_reduction",
}
"""Fields of a step's results that are the entries of infos."""


class PlanarVectorEnv(MappingVectorEnv[PlanarEnv]):
    """Planar worlds in arrays; see `coopmap_env.vector`.

    Parameters
    ----------
    n_envs : int
        Number of worlds.
    rows, autoreset_mode, double_buffer, with_state
        See `coopmap_env.vector`.
    num_threads : int
        Threads that step worlds at the same time; results do not depend on it.
    keep_surfaces : bool
        Whether the maps of `world` have surface Gaussians. Nothing else depends on them; they take
        120 bytes a cell, and some time.
    **arguments
        `PlanarArguments`.

    Raises
    ------
    ValueError
        If an argument is not accepted.
    """

    def __init__(
        self,
        n_envs: int,
        *,
        rows: RowName = "agents",
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        double_buffer: bool = False,
        with_state: bool = False,
        num_threads: int = 1,
        keep_surfaces: bool = False,
        **arguments: Any,
    ) -> None:
        n_envs = check_count("n_envs", n_envs)
        num_threads = check_count("num_threads", num_threads)
        self._env = env = PlanarEnv(**arguments)
        super().__init__(
            TeamSpaces.from_env(env, with_state),
            n_envs,
            rows=rows,
            autoreset_mode=autoreset_mode,
            double_buffer=double_buffer,
        )
        self._worlds = PlanarWorlds(env.task, env.scene, n_envs, keep_surfaces, num_threads)
        self._observations = [self._team_observations(arrays) for arrays in self._buffers]
        self._world_views = [PlanarWorldView(env, self._worlds, e) for e in range(n_envs)]
        self._seed_draws = [SeedDraws() for _ in range(n_envs)]
        team, (actions, _) = (n_envs, env.task.n_robots), self._plan.arrays(self._memory)
        is_choice = env.task.n_candidates > 0
        self._choices = actions if is_choice else np.empty((n_envs, 0), dtype=np.int64)
        self._poses = np.empty((n_envs, 0, 3)) if is_choice else actions.reshape(*team, 3)

    def world(self, index: int) -> PlanarEnv:
        """A view of one world; see `MappingVectorEnv.world`."""
        (index,) = self._check_worlds([index])
        return self._world_views[index]

    def close_extras(self, **kwargs: Any) -> None:
        """End the threads."""
        if hasattr(self, "_worlds"):  # the constructor may have failed
            self._worlds.close()
            for view in self._world_views:
                view.close()

    def _advance(
        self,
        buffer: int,
        stepped: Sequence[int],
        reset: Sequence[int],
        seeds: Sequence[int | None],
        options: dict[str, Any] | None,
    ) -> None:
        if reset:
            worlds = np.array(reset)
            own = self._draw_worlds(reset, seeds)
            self._worlds.start(worlds, own)
            self._worlds.observe(worlds, self._observations[buffer])
            for values in self._buffers[buffer].infos.values():
                values[worlds] = 0
            self._write_common(buffer, worlds)
        if stepped:
            worlds = np.array(stepped)
            poses = self._poses.astype(np.float64)  # as those of a single environment: one kernel
            self._worlds.step(worlds, poses, self._choices, self._observations[buffer])
            self._write_results(buffer, worlds)

    def _draw_worlds(
        self, worlds: Sequence[int], seeds: Sequence[int | None]
    ) -> list[EpisodeSeeds]:
        """Draw true worlds by the seeds of a single environment, which are returned."""
        draws = [self._seed_draws[world] for world in worlds]
        own = [
            draw.seeds_of(self._env.split, seed) for draw, seed in zip(draws, seeds, strict=True)
        ]
        self._worlds.truths.draw(worlds, own, naming_world)
        for draw, seed, mine in zip(draws, seeds, own, strict=True):
            if seed is not None:
                draw.follow(mine)
        return own

    def _write_common(self, buffer: int, worlds: NDArray[np.int64]) -> None:
        arrays, ours, at = self._buffers[buffer], self._worlds.arrays, self._at(worlds)
        n_cells = self._env.task.grid.n_cells
        arrays.infos["n_scans"][at] = ours.n_scans[at, None]
        arrays.infos["elapsed_time"][at] = ours.elapsed[at, None]
        arrays.infos["observed_fraction"][at] = ours.n_observed[at, None] / n_cells
        if self._env.reports_shown:
            arrays.infos["shown_fraction"][at] = ours.n_shown[at, None] / n_cells
        left = budget_fractions(
            ours.n_scans[at], ours.elapsed[at], self._env.max_scans, self._env.max_time
        )
        arrays.observations["budget"][at] = np.tile(left, self._env.task.n_robots)
        if "state" in arrays.observations:
            for world in worlds.tolist():
                state = self.world(world).state()
                arrays.observations["state"][world] = np.tile(state, self._rows.per_world)

    def _write_results(self, buffer: int, worlds: NDArray[np.int64]) -> None:
        arrays, results, at = self._buffers[buffer], self._worlds.results, self._at(worlds)
        infos = arrays.infos
        self._write_common(buffer, worlds)
        arrays.rewards[at] = results.rewards[at]
        arrays.terminations[at] = False
        arrays.truncations[at] = self._has_ended(at)[:, None]
        for key, name in OUTCOMES.items():
            infos[key][at] = getattr(results, name)[at]
        for number, name in enumerate(REWARD_TERMS):
            key = f"{REWARD_PREFIX}{name}"
            if key in infos:
                infos[key][at] = results.reward_terms[at, :, number]

    def _has_ended(self, at: Any) -> NDArray[np.bool_]:
        """Which of some worlds have no scan or no time left."""
        ours, env = self._worlds.arrays, self._env
        ended: NDArray[np.bool_] = ours.n_scans[at] >= env.max_scans
        return ended if env.max_time is None else ended | (ours.elapsed[at] >= env.max_time)

    def _at(self, worlds: NDArray[np.int64]) -> Any:
        """Index of some worlds: a slice where they are all, which numpy copies much faster."""
        return slice(None) if len(worlds) == self.n_worlds else worlds

    def _team_observations(self, arrays: StepArrays) -> TeamObservations:
        """The arrays of a buffer as the kernels write them: views of the same memory."""
        task, parts = self._env.task, arrays.observations
        n, m = task.n_robots, task.n_candidates
        blank = TeamObservations.empty(self.n_worlds, n, task.settings.crop_cells, m)

        def view(key: str, like: NDArray[Any]) -> NDArray[Any]:
            return parts[key].reshape(like.shape) if key in parts else like

        views = ObservationArrays(
            view("map", blank.views.maps),
            view("pose", blank.views.pose_vectors),
            view("teammates", blank.views.teammates),
        )
        return TeamObservations(
            views, view("candidates", blank.features), view("action_mask", blank.action_mask)
        )
