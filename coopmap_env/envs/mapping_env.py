"""What every environment of cooperative mapping does; each world's environment adds its parts."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from functools import cached_property
from math import prod
from typing import Any, ClassVar, Generic

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

from coopmap_env.core.files import brief
from coopmap_env.core.linear_algebra import total
from coopmap_env.envs.actions import CandidateMode, action_of_each
from coopmap_env.envs.arguments import TRUE_TERMS, MappingArguments
from coopmap_env.envs.belief import ActionMode, Observation, Observer
from coopmap_env.envs.budget import BUDGET_SIZE, Budget, budget_fractions, budget_space
from coopmap_env.envs.rewards import REWARD_TERMS
from coopmap_env.envs.step_data import (
    COMMON_INFO_TYPES,
    OUTCOME_INFO_TYPES,
    REWARD_PREFIX,
    BeliefT,
    EpisodeSeeds,
    Infos,
    InfoTypes,
    SeedDraws,
    TeamStep,
    outcome_info,
)
from coopmap_env.rendering import HumanWindow
from coopmap_env.sensing import Scan


class MappingEnv(ParallelEnv[str, Observation, Any], ABC, Generic[BeliefT]):
    """Conducts an episode and computes nothing itself: decode, move, scan, fuse, reward, observe.

    A world's environment calls `_set_up` once and provides `_start`, `_advance`, `_scans_done`,
    `_elapsed_time`, `last_scans`, `_shown_mask`, `_explain`, `_render_frame` and `truth`.

    `copy.deepcopy` and `pickle` keep the episode: a copy goes on as the original does. It is made
    by playing the episode again, so that it takes as long as the steps so far.
    """

    metadata: ClassVar[dict[str, Any]] = {}
    _own_info_types: ClassVar[InfoTypes] = {}
    """Types of the entries of infos that only this kind of world has."""
    _belief: BeliefT

    def __init__(self, arguments: MappingArguments) -> None:
        self._arguments = arguments
        self.possible_agents = [f"robot_{i}" for i in range(arguments.n_robots)]
        self.agents: list[str] = []
        self.max_scans = arguments.n_scans
        self.max_time = arguments.max_time
        self.split = arguments.split
        self.render_mode = arguments.render_mode
        self._candidate_mode = (
            CandidateMode(arguments.n_candidates) if arguments.action_mode == "candidates" else None
        )
        self._reward_term = arguments.reward
        self._reports_shown = arguments.keeps_shown
        self._shares_reward = arguments.team_reward == "shared"
        self._window: HumanWindow | None = None
        self._seed_draws = SeedDraws()
        self._has_reset = False
        self._episode: tuple[EpisodeSeeds, list[dict[str, Any]]] | None = None
        """Seeds of the episode and the actions so far: they determine all else."""
        self._trails: list[list[NDArray[np.float64]]] = []

    def _set_up(
        self,
        actions: ActionMode,
        observer: Observer,
    ) -> None:
        """Set the parts that depend on the kind of world, and declare the spaces.

        What is left of the episode is observed in both kinds of world: it is added here.
        """
        self._actions = actions
        self._observer = observer
        agents = list(enumerate(self.possible_agents))
        self.action_spaces = {agent: actions.space(robot) for robot, agent in agents}
        self.observation_spaces = {
            agent: spaces.Dict({**observer.space(robot).spaces, "budget": budget_space()})
            for robot, agent in agents
        }
        size = prod(observer.state_space().shape) + BUDGET_SIZE
        self.state_space = spaces.Box(-1.0, 1.0, (size,), np.float32)

    @property
    def reports_shown(self) -> bool:
        """Whether it keeps what scans truly show; see the argument `report_shown`."""
        return self._reports_shown

    @cached_property
    def info_types(self) -> InfoTypes:
        """Types of the entries of infos; vector environments make arrays of them."""
        names = [name for name in REWARD_TERMS if self.reports_shown or name not in TRUE_TERMS]
        return {
            **COMMON_INFO_TYPES,
            **({"shown_fraction": float} if self.reports_shown else {}),
            **OUTCOME_INFO_TYPES,
            **{f"{REWARD_PREFIX}{name}": float for name in names},
            **self._own_info_types,
        }

    @abstractmethod
    def _start(self, seeds: EpisodeSeeds) -> tuple[BeliefT, list[Observation]]:
        """Make a new world, put the team into it, and observe."""

    @abstractmethod
    def _advance(self, actions: dict[str, Any]) -> TeamStep[BeliefT]:
        """Move, scan, fuse and observe, by an action for each robot.

        Raises
        ------
        InvalidActionError
            If an action is not in its space; nothing has changed then.
        """

    @property
    @abstractmethod
    def _scans_done(self) -> int:
        """Scans of each robot in this episode."""

    @property
    @abstractmethod
    def _elapsed_time(self) -> float:
        """Seconds on the clock of the team in this episode."""

    @property
    def _budget(self) -> Budget:
        """What is left of the episode."""
        scans = self.max_scans - self._scans_done
        if self.max_time is None:
            return Budget(scans)
        return Budget(scans, max(self.max_time - self._elapsed_time, 0.0))

    @property
    def _budget_fractions(self) -> NDArray[np.float32]:
        """The same as it is observed, a new array."""
        return budget_fractions(self._scans_done, self._elapsed_time, self.max_scans, self.max_time)

    @property
    def _has_ended(self) -> bool:
        scans, time = self._budget
        return scans <= 0 or time <= 0.0

    @property
    @abstractmethod
    def last_scans(self) -> list[Scan]:
        """Scans of the last step, as they were fused."""

    @abstractmethod
    def _shown_mask(self) -> NDArray[np.bool_]:
        """Mask (n_cells,) of what is shown or known, where it is reported."""

    @abstractmethod
    def _render_frame(self) -> NDArray[np.uint8]:
        """Draw a picture (H, W, 3) of the truth, the map and the team."""

    def _own_info(self, robot: int) -> dict[str, Any]:
        """Entries of a robot's info that only this kind of world has."""
        return {}

    @abstractmethod
    def _explain(self, robot: int) -> dict[str, str]:
        """See `explain`; entries may be empty."""

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """Space of one robot's observations; always the same object."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """Space of one robot's actions; always the same object."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observation], Infos]:
        """Start an episode: a world, the team somewhere in its free space, an empty map.

        Parameters
        ----------
        seed : int, optional
            Index of the world in the split; determines everything up to the next reset. Without
            it, one is drawn from the last seed that was given, or from the operating system.
        options : dict, optional
            Ignored.

        Raises
        ------
        ValueError
            If the seed is not an integer of at least 0, the options are no dictionary, or the scene
            makes a world of another shape, resolution or origin than it declares. A running episode
            and later draws of seeds are not affected.
        """
        if options is not None and not isinstance(options, Mapping):
            raise ValueError(f"options must be a dict or None, got {brief(options)}")
        seeds = self._seed_draws.seeds_of(self.split, seed)
        observed = self._begin(seeds)
        if seed is not None:
            self._seed_draws.follow(seeds)
        observations = self._observations_of_agents(observed)
        blank = {key: kind() for key, kind in self.info_types.items()}
        infos = self._infos([blank] * len(self.agents))
        if self.render_mode == "human":
            self.render()
        return observations, infos

    def step(
        self, actions: Mapping[str, Any]
    ) -> tuple[dict[str, Observation], dict[str, float], dict[str, bool], dict[str, bool], Infos]:
        """Move all cameras, scan with all of them, fuse the scans, reward, observe.

        A pose that is infeasible on the known map does not move the camera: it scans from where it
        is, and ``infos[agent]["rejected_reason"]`` is why, a `RejectedReason`. Where the map is
        wrong, the robot collides with what is there and is stopped: ``infos[agent]["collided"]`` is
        true.

        Raises
        ------
        InvalidActionError
            If an action is missing, superfluous or not in its space; the environment is unchanged
            and the step can be repeated.
        RuntimeError
            Before the first reset and after the end of an episode.
        """
        self._require_reset()
        if not self.agents:
            raise RuntimeError(f"the episode ended after {self._scans_done} scans: call reset()")
        step = self._play(action_of_each(self.agents, actions))
        observations = self._observations_of_agents(step.observations)
        rewards = self._assign_rewards(step.reward_terms)
        infos = self._infos([outcome_info(step, robot) for robot in range(len(self.agents))])
        ended = self._has_ended
        terminations = dict.fromkeys(self.agents, False)
        truncations = dict.fromkeys(self.agents, ended)
        if self.render_mode == "human":
            self.render()
        if ended:
            self.agents = []
        return observations, rewards, terminations, truncations, infos

    def state(self) -> NDArray[np.float32]:
        """Observation of a centralised critic; see the world's `observations`."""
        state = self._observer.state(self.belief())
        return np.concatenate([state, self._budget_fractions], dtype=np.float32)

    def belief(self) -> BeliefT:
        """What the robots know: the input of planners. Never the truth.

        Raises
        ------
        RuntimeError
            Before the first reset.
        """
        self._require_reset()
        return self._belief

    def explain(self, agent: str) -> dict[str, str]:
        """What the codes in a robot's last infos mean, in words, with names and figures.

        Only the entries that there are: ``rejected_reason``, ``collided``, in the field also
        ``localization_failure`` and ``correction_failure``.

        Raises
        ------
        RuntimeError
            Before the first reset.
        """
        self._require_reset()
        words = self._explain(self.possible_agents.index(agent))
        return {key: text for key, text in words.items() if text}

    @property
    @abstractmethod
    def truth(self) -> Any:
        """The true world, for scoring and rendering only; policies get `belief`."""

    @property
    def shown_mask(self) -> NDArray[np.bool_]:
        """Cells, shape of the grid, that the scans truly show or that were known, for scoring only.

        Those that beams without noise cross up to the first true surface, that of the surface
        included; see the argument `report_shown`.

        Raises
        ------
        RuntimeError
            Before the first reset, and without ``report_shown=True``.
        """
        self._require_reset()
        if not self.reports_shown:
            raise RuntimeError("what scans show is not kept: make it with report_shown=True")
        return self._shown_mask().reshape(self.belief().map.grid.shape)

    def render(self) -> NDArray[np.uint8] | None:
        """Truth, team map and cameras as an (H, W, 3) image, or in a window."""
        if self.render_mode is None:
            return None
        self._require_reset()
        frame = self._render_frame()
        if self.render_mode == "human":
            self._window = self._window or HumanWindow()
            self._window.show(frame)
            return None
        return frame

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._window is not None:
            self._window.close()
            self._window = None

    def __getstate__(self) -> dict[str, Any]:
        """How to come to the same state: copies and pickles play the episode again."""
        return {
            "arguments": vars(self._arguments),
            "spaces": (self.action_spaces, self.observation_spaces),
            "seed_draws": self._seed_draws,
            "episode": self._episode,
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Play the episode up to the same step."""
        type(self).__init__(self, **state["arguments"])
        self.action_spaces, self.observation_spaces = state["spaces"]  # with their random numbers
        self._seed_draws = state["seed_draws"]
        if state["episode"] is not None:
            seeds, actions = state["episode"]
            self._begin(seeds)
            for one in actions:
                self._play(one)
            if self._has_ended:
                self.agents = []

    def _begin(self, seeds: EpisodeSeeds) -> list[Observation]:
        """Begin the episode of these seeds; what the robots observe."""
        self._belief, observed = self._start(seeds)
        self._episode = seeds, []
        self._has_reset = True
        self.agents = list(self.possible_agents)
        self._trails = [[] for _ in self.agents]
        self._record_positions()
        return observed

    def _play(self, actions: dict[str, Any]) -> TeamStep[BeliefT]:
        """Take one step of the episode."""
        assert self._episode is not None
        step = self._advance(actions)
        self._episode[1].append({agent: np.array(one) for agent, one in actions.items()})
        self._belief = step.belief
        self._record_positions()
        return step

    def _require_reset(self) -> None:
        if not self._has_reset:
            raise RuntimeError("call reset() first: there is no world yet")

    def _observations_of_agents(self, observed: Sequence[Observation]) -> dict[str, Observation]:
        """Observations of all robots by their names, with what is left of the episode."""
        left = self._budget_fractions
        return {
            agent: {**observation, "budget": left.copy()}
            for agent, observation in zip(self.agents, observed, strict=True)
        }

    def _record_positions(self) -> None:
        """Append the known camera positions to the trails, which pictures show."""
        if self.render_mode is None:
            return
        positions = self._belief.positions
        unknown = np.isnan(positions[:, 0]).tolist()
        for trail, position, is_unknown in zip(self._trails, positions, unknown, strict=True):
            if not is_unknown:
                trail.append(position)

    def _assign_rewards(self, terms: Sequence[dict[str, float]]) -> dict[str, float]:
        rewards = [term[self._reward_term] for term in terms]
        if self._shares_reward:
            rewards = [total(rewards) / len(rewards)] * len(rewards)
        return dict(zip(self.agents, rewards, strict=True))

    def _infos(self, outcomes: Sequence[dict[str, Any]]) -> Infos:
        """Infos of all robots, from what came of the step of each."""
        common = self._common_info()
        return {
            agent: {**outcome, **common, **self._own_info(robot)}
            for robot, (agent, outcome) in enumerate(zip(self.agents, outcomes, strict=True))
        }

    def _common_info(self) -> dict[str, Any]:
        return {
            "n_scans": self._scans_done,
            "elapsed_time": self._elapsed_time,
            "observed_fraction": self._belief.map.observed_fraction,
            **self._shown_info(),
        }

    def _shown_info(self) -> dict[str, float]:
        """What infos say of the cells that scans have shown."""
        if not self.reports_shown:
            return {}
        return {"shown_fraction": float(np.mean(self._shown_mask()))}
