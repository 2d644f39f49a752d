"""The contract of vector environments: `MappingVectorEnv`; see the package's page."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, get_args

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from coopmap_env.core.arguments import check_choice
from coopmap_env.core.files import brief
from coopmap_env.envs import Observation
from coopmap_env.vector.reset_arguments import parse_reset_mask, parse_seeds
from coopmap_env.vector.row_actions import ActionParser
from coopmap_env.vector.row_infos import all_arrays, select_infos
from coopmap_env.vector.rows import RowName, Rows, RowViews
from coopmap_env.vector.step_arrays import ArrayPlan, StepArrays
from coopmap_env.vector.team_spaces import TeamSpaces
from coopmap_env.vector.world_access import WorldAccess, WorldT

Step = tuple[Observation, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]


class MappingVectorEnv(
    WorldAccess[WorldT], VectorEnv[Observation, NDArray[Any], NDArray[Any]], ABC
):
    """Many worlds in one call; see `coopmap_env.vector`.

    A subclass provides `_advance`, which steps and resets worlds and writes their arrays, and
    `world`. All else is the same for each: rows, automatic resets, infos, checks. Beside `_advance`
    a step costs about 50 us, with any number of worlds.

    Parameters
    ----------
    team : TeamSpaces
        Of each world; with a state, that is observed too.
    n_worlds : int
    rows, autoreset_mode, double_buffer
        See `coopmap_env.vector`.
    allocate : callable
        Gives memory of a number of bytes, zeros.
    """

    def __init__(
        self,
        team: TeamSpaces,
        n_worlds: int,
        *,
        rows: RowName = "agents",
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        double_buffer: bool = False,
        allocate: Callable[[int], Any] = bytearray,
    ) -> None:
        check_choice("rows", rows, get_args(RowName))
        modes = tuple(mode.value for mode in AutoresetMode)
        mode = autoreset_mode.value if isinstance(autoreset_mode, AutoresetMode) else autoreset_mode
        check_choice("autoreset_mode", mode, modes)
        self.autoreset_mode = AutoresetMode(mode)
        self.team = team
        self.robots = team.robots
        self.n_worlds = n_worlds
        self._rows = Rows(team, n_worlds, rows)
        self.rows = rows
        self.num_envs = n_worlds * self._rows.per_world
        self.metadata = {**team.metadata, "autoreset_mode": self.autoreset_mode}
        self.render_mode = team.render_mode
        self.single_observation_space = self._rows.observation_space
        self.single_action_space = self._rows.action_space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        n_states = self._rows.per_world
        self._plan = ArrayPlan.make(team, n_worlds, n_states, 1 + double_buffer)
        self._memory = allocate(self._plan.n_bytes)
        self._actions, self._buffers = self._plan.arrays(self._memory)
        """Actions (see `action_spec`) and results; `_advance` reads and writes them."""
        self._parse_actions = ActionParser(self._rows, self._actions)
        self._views = [self._rows.views(arrays) for arrays in self._buffers]
        self._current = 0
        self._finals: list[StepArrays | None] = [None] * (1 + double_buffer)
        """What worlds showed at their ends, for each buffer; made when first needed."""
        self._ready = np.zeros(n_worlds, dtype=bool)
        """Worlds that were reset, and have not failed since."""
        self._ended = np.zeros(n_worlds, dtype=bool)
        """Worlds whose episode has ended, and that were not reset since."""

    @abstractmethod
    def _advance(
        self,
        buffer: int,
        stepped: Sequence[int],
        reset: Sequence[int],
        seeds: Sequence[int | None],
        options: dict[str, Any] | None,
    ) -> None:
        """Step some worlds by `_actions`, and reset others.

        Writes into the arrays of the buffer: the observations and infos of both, rewards and ends
        of the stepped ones.

        Parameters
        ----------
        buffer : int
            Index into `_buffers`.
        stepped, reset : sequence of int
            Worlds, in order; no world is in both.
        seeds : sequence of int or None
            Of the reset worlds; None for a seed that the world draws, as a single environment does.
        options : dict, optional
            Of the reset worlds.
        """

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode in each world, or in those of a mask.

        Parameters
        ----------
        seed : int or sequence of int or None, optional
            One for each world; a single one is that of world 0, and the next numbers are those of
            the next worlds. A world without a seed draws it as a single environment does.
        options : dict, optional
            ``reset_mask``: bool (num_envs,), the rows to reset; those of a world agree. Other
            entries reach each environment's `reset`.

        Raises
        ------
        ValueError
            If a seed or the mask is not as described; no world has changed.
        """
        self._require_open()
        if options is not None and not isinstance(options, Mapping):
            raise ValueError(f"options must be a dict or None, got {brief(options)}")
        others = dict(options or {})
        resets = parse_reset_mask(
            others.pop("reset_mask", None), self.n_worlds, self._rows.per_world
        )
        seeds = parse_seeds(seed, self.n_worlds)
        last = self._buffers[self._current]
        self._next_buffer()
        if not resets.all():
            self._copy_worlds(last, self._buffers[self._current], ~resets)
        self._run(np.zeros_like(resets), resets, seeds, others or None)
        self._ended[resets] = False
        return dict(self._views[self._current].observations), self._infos(resets)

    def step(self, actions: Any) -> Step:
        """Step all worlds; see `coopmap_env.vector` for what becomes of those that have ended.

        Parameters
        ----------
        actions : array, shape (num_envs, ...)
            In `action_space`, integers or floats of any type.

        Raises
        ------
        InvalidActionError
            Naming the world, the robot and the value; no world has changed.
        RuntimeError
            Before the first reset of each world and after an error in one, or if a world has ended
            that nothing resets; no world has changed.
        """
        self._require_open()
        self._require_ready()
        resets = self._ended & (self.autoreset_mode is AutoresetMode.NEXT_STEP)
        self._parse_actions(actions, ~resets)
        self._next_buffer()
        self._run(~resets, resets)
        views = self._finish_rewards()
        self._ended = (
            self._buffers[self._current].terminations[:, 0]
            | (self._buffers[self._current].truncations[:, 0])
        )
        final: dict[str, Any] = {}
        if self.autoreset_mode is AutoresetMode.SAME_STEP and self._ended.any():
            resets = self._ended
            self._ended = np.zeros_like(resets)
            final = self._store_final(resets)
            self._run(np.zeros_like(resets), resets, keep_ends=True)
        observations = dict(views.observations)
        infos = self._infos(np.ones_like(resets)) | final
        return observations, views.rewards, views.terminations, views.truncations, infos

    @property
    def final_observations(self) -> Observation:
        """Last observations of episodes that ended in the last step, in the rows of ``_final_obs``.

        The arrays that ``infos["final_obs"]`` gives row by row, with autoreset_mode="SameStep".
        """
        return self._rows.views(self._final_arrays()).observations

    def _infos(self, fresh: NDArray[np.bool_]) -> dict[str, Any]:
        """Infos of the worlds that were stepped or reset."""
        return select_infos(self._views[self._current], self._rows.of_worlds(fresh))

    def _run(
        self,
        stepped: NDArray[np.bool_],
        reset: NDArray[np.bool_],
        seeds: Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
        keep_ends: bool = False,
    ) -> None:
        """Step and reset worlds in the current buffer; after an error they need a reset."""
        resets = np.flatnonzero(reset).tolist()
        drawn = [None] * len(resets) if seeds is None else [seeds[world] for world in resets]
        arrays, was_ready = self._buffers[self._current], self._ready
        self._ready = self._ready & ~(stepped | reset)
        self._advance(self._current, np.flatnonzero(stepped).tolist(), resets, drawn, options)
        self._ready = was_ready | reset
        if resets and not keep_ends:
            arrays.rewards[reset] = 0.0
            arrays.terminations[reset] = arrays.truncations[reset] = False

    def _finish_rewards(self) -> RowViews:
        """Views of the current buffer, with the rewards of teams."""
        views = self._views[self._current]
        if self.rows == "teams":
            views.rewards[:] = 0.0
            for robot in self._buffers[self._current].rewards.T:  # in the order of `TeamEnv`'s sum
                views.rewards[:] += robot
        return views

    def _store_final(self, ended: NDArray[np.bool_]) -> dict[str, Any]:
        """Keep what worlds show at their end, and give it as gymnasium's infos do."""
        final, rows = self._final_arrays(), self._rows
        self._copy_worlds(self._buffers[self._current], final, ended)
        mask, views = rows.of_worlds(ended), rows.views(final)
        observations = np.full(self.num_envs, None, dtype=object)
        for row in np.flatnonzero(mask).tolist():
            observations[row] = {key: own[row] for key, own in views.observations.items()}
        return {
            "final_obs": observations,
            "_final_obs": mask,
            "final_info": select_infos(views, mask),
            "_final_info": mask,
        }

    def _final_arrays(self) -> StepArrays:
        final = self._finals[self._current]
        if final is None:
            plan = ArrayPlan.make(self.team, self.n_worlds, self._rows.per_world, 1)
            final = self._finals[self._current] = plan.arrays(bytearray(plan.n_bytes))[1][0]
        return final

    def _copy_worlds(
        self, source: StepArrays, target: StepArrays, worlds: NDArray[np.bool_]
    ) -> None:
        if source is not target:
            for ours, theirs in zip(all_arrays(source), all_arrays(target), strict=True):
                theirs[worlds] = ours[worlds]

    def _next_buffer(self) -> None:
        self._current = (self._current + 1) % len(self._buffers)

    def _require_ready(self) -> None:
        if not self._ready.all():
            world = int(np.flatnonzero(~self._ready)[0])
            raise RuntimeError(
                f"world {world} has no episode: call reset() first, and after an error again"
            )
        if self.autoreset_mode is AutoresetMode.DISABLED and self._ended.any():
            raise RuntimeError(
                f"the episodes of worlds {np.flatnonzero(self._ended).tolist()} have ended: reset "
                'them by reset(options={"reset_mask": terminations | truncations})'
            )

    def _require_open(self) -> None:
        if self.closed:
            raise RuntimeError("this vector environment is closed: make a new one")
