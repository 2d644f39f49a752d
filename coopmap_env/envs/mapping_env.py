"""What every environment of cooperative mapping does in a step; the worlds fill in the rest."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Generic, NamedTuple, Protocol, TypeVar

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

from coopmap_env.core.arguments import check_choice, check_positive_int
from coopmap_env.envs.actions import ActionMode, CandidateMode, InvalidActionError
from coopmap_env.envs.belief import Belief, Observation
from coopmap_env.envs.rewards import REWARD_TERMS, RewardScale, StepOutcome, reward_terms
from coopmap_env.mapping import ScanGain
from coopmap_env.rendering.window import HumanWindow
from coopmap_env.sensing import Scan
from coopmap_env.simulation.scenes import world_seed

Infos = dict[str, dict[str, Any]]
BeliefT = TypeVar("BeliefT", bound=Belief)


class EpisodeRngs(NamedTuple):
    """The random numbers of an episode, one Generator for each purpose."""

    scene: np.random.Generator
    start: np.random.Generator
    noise: np.random.Generator
    candidates: np.random.Generator
    seeds: np.random.Generator
    """Of the episodes that follow without a seed."""


class TeamMoveResult(NamedTuple):
    """How the motion of the team ended."""

    poses: Any
    """Where each robot is now as far as it knows: lattice numbers or joints."""
    collided_with: Sequence[str]
    """What each robot bumped into; empty if nothing."""
    collision_cells: Sequence[int] = ()
    """Cells of the map that were found to be occupied by it."""


class Observer(Protocol):
    """Fills observations; their spaces are declared beside."""

    def space(self, robot: int) -> spaces.Dict:
        """Make a new observation space of one robot."""

    def observe(self, belief: Any) -> list[Observation]:
        """Observations of all robots, as new arrays."""

    def state_space(self) -> spaces.Box:
        """Make a new space of `state`."""

    def state(self, belief: Any) -> NDArray[np.float32]:
        """What a centralised critic may see, as one vector."""


class MappingEnv(ParallelEnv[str, Observation, Any], ABC, Generic[BeliefT]):
    """Conducts a step and computes nothing itself: move, look, fuse, reward, observe.

    A world's environment checks its own arguments, calls `_set_up` once and provides `_reset_world`,
    `_move`, `_take_scans`, `_render_frame` and `truth`.
    """

    metadata: ClassVar[dict[str, Any]] = {}
    _belief: BeliefT

    def __init__(
        self,
        n_robots: int,
        action_mode: str,
        reward: str,
        team_reward: str,
        split: str,
        max_scans: int,
        n_candidates: int,
        render_mode: str | None,
    ) -> None:
        self.possible_agents = [
            f"robot_{i}" for i in range(check_positive_int("n_robots", n_robots))
        ]
        self.agents: list[str] = []
        self.max_scans = check_positive_int("max_scans", max_scans)
        check_choice("action_mode", action_mode, ("pose", "candidates"))
        check_choice("reward", reward, tuple(REWARD_TERMS))
        check_choice("team_reward", team_reward, ("individual", "shared"))
        check_choice("render_mode", render_mode, (None, *self.metadata["render_modes"]))
        world_seed(split, 0)  # refuses an unknown split
        n_candidates = check_positive_int("n_candidates", n_candidates)
        self.split = split
        self.render_mode = render_mode
        self._candidate_mode = CandidateMode(n_candidates) if action_mode == "candidates" else None
        self._reward_term = reward
        self._shares_reward = team_reward == "shared"
        self._window: HumanWindow | None = None
        self._seed_rng = np.random.default_rng()
        self._scans_done = 0
        self._has_reset = False
        self.scans: list[Scan] = []
        """Of the last step, as they were fused."""

    def _set_up(
        self, actions: ActionMode, scale: RewardScale, observer: Observer, contact_cost: float = 0.0
    ) -> None:
        """Take over the world's parts; declares the spaces."""
        self._actions = actions
        self._reward_scale = scale
        self._observer = observer
        self._contact_cost = contact_cost
        agents = list(enumerate(self.possible_agents))
        self.action_spaces = {agent: actions.space(robot) for robot, agent in agents}
        self.observation_spaces = {agent: observer.space(robot) for robot, agent in agents}
        self.state_space = observer.state_space()

    @abstractmethod
    def _reset_world(self, rngs: EpisodeRngs) -> BeliefT:
        """Make a new world and put the team into it."""

    @abstractmethod
    def _move(self, targets: list[Any]) -> TeamMoveResult:
        """Move all robots to their targets; None lets a robot stay."""

    @abstractmethod
    def _take_scans(self) -> list[Scan]:
        """Let every robot look from where it is."""

    def _fuse(self, scans: list[Scan]) -> list[ScanGain]:
        """Fuse the scans of a step; what each of them brought."""
        return self._belief.map.integrate(scans)

    @abstractmethod
    def _render_frame(self) -> NDArray[np.uint8]:
        """Draw a picture (H, W, 3) of the truth, the map and the team."""

    def _extra_info(self, robot: int) -> dict[str, Any]:
        """Entries of a world's own in the infos of a step."""
        return {}

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
            Number of the world in the split; decides everything up to the next reset. Without a
            seed, the last seed (or the machine, if there was none) decides the next one.
        options : dict, optional
            Ignored.

        Raises
        ------
        ValueError
            If the seed is no whole number of at least 0, or the scene makes a world that is not of
            the shape, resolution and origin that it says. A running episode goes on then.
        """
        if seed is None:
            seed = int(self._seed_rng.integers(2**31))
        rngs = EpisodeRngs(
            *(np.random.default_rng(child) for child in world_seed(self.split, seed).spawn(5))
        )
        self._belief = self._reset_world(rngs)
        self._rngs, self._seed_rng = rngs, rngs.seeds
        self._has_reset = True
        self._scans_done = 0
        self.scans = []
        self.agents = list(self.possible_agents)
        self._sample_candidates()
        observations = self._observe()
        infos = {agent: self._common_info() for agent in self.agents}
        _copy_masks(observations, infos)
        if self.render_mode == "human":
            self.render()
        return observations, infos

    def step(
        self, actions: Mapping[str, Any]
    ) -> tuple[dict[str, Observation], dict[str, float], dict[str, bool], dict[str, bool], Infos]:
        """Move all cameras, look with all of them, fuse, reward, observe.

        A pose that is infeasible on the known map does not move the camera: it stays, looks from
        where it is, and ``infos[agent]["rejected_reason"]`` says why. Where the map is wrong and something
        stands in the way, the robot bumps into it and is stopped: ``infos[agent]["contact"]`` is
        true.

        Raises
        ------
        InvalidActionError
            If an action is missing, superfluous or no member of its space; nothing has happened
            then and the step can be repeated.
        RuntimeError
            Before the first reset and after the end of an episode.
        """
        decoded = self._decode(actions)
        before = self._belief
        move = self._move([None if reason else pose for pose, reason in decoded])
        rated = before.rate_team(move.poses)
        if move.collision_cells:
            before.map.mark_occupied(move.collision_cells)
        self._belief = before.with_poses(move.poses)
        self.scans = self._take_scans()
        gains = self._fuse(self.scans)
        self._scans_done += 1
        self._sample_candidates()
        outcomes = [
            StepOutcome(*values)
            for values in zip(
                rated.new_information.tolist(),
                rated.distance.tolist(),
                rated.motion_cost.tolist(),
                rated.rating.tolist(),
                gains,
                [
                    self._contact_cost if collided_with else 0.0
                    for collided_with in move.collided_with
                ],
                strict=True,
            )
        ]
        terms = [reward_terms(outcome, self._reward_scale) for outcome in outcomes]
        common = self._common_info()
        infos = {
            agent: {
                **common,
                "rejected_reason": decoded[robot][1],
                "contact": bool(move.collided_with[robot]),
                "reward_terms": terms[robot],
                "new_information": outcomes[robot].new_information,
                "distance": outcomes[robot].distance,
                "new_cells": gains[robot].new_cells,
                "entropy_reduction": gains[robot].entropy_reduction,
                **self._extra_info(robot),
            }
            for robot, agent in enumerate(self.agents)
        }
        rewards = self._assign_rewards(terms)
        ended = self._scans_done >= self.max_scans
        observations = self._observe()
        _copy_masks(observations, infos)
        terminations = dict.fromkeys(self.agents, False)
        truncations = dict.fromkeys(self.agents, ended)
        if self.render_mode == "human":
            self.render()
        if ended:
            self.agents = []
        return observations, rewards, terminations, truncations, infos

    def state(self) -> NDArray[np.float32]:
        """Return what centralised critics may see; see the world's `observations`."""
        return self._observer.state(self.belief())

    def belief(self) -> BeliefT:
        """Return what the robots know: the input of planners. Never the truth.

        Raises
        ------
        RuntimeError
            Before the first reset.
        """
        self._require_reset()
        return self._belief

    @property
    @abstractmethod
    def truth(self) -> Any:
        """The true world, for scoring and rendering only; policies get `belief`."""

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

    def _require_reset(self) -> None:
        if not self._has_reset:
            raise RuntimeError("call reset() first: there is no world yet")

    def _decode(self, actions: Mapping[str, Any]) -> list[tuple[Any, str]]:
        self._require_reset()
        if not self.agents:
            raise RuntimeError(f"the episode ended after {self.max_scans} scans: call reset()")
        if not isinstance(actions, Mapping) or set(actions) != set(self.agents):
            given = sorted(map(str, actions)) if isinstance(actions, Mapping) else repr(actions)
            raise InvalidActionError(f"one action for each of {self.agents} is needed, got {given}")
        return [self._actions.decode(agent, actions[agent], self._belief) for agent in self.agents]

    def _sample_candidates(self) -> None:
        if self._candidate_mode is not None:
            m, rng = self._candidate_mode.n_candidates, self._rngs.candidates
            candidates = [
                self._belief.random_poses(robot, m, rng)
                for robot in range(len(self.possible_agents))
            ]
            self._belief = self._belief.with_candidates(candidates)

    def _observe(self) -> dict[str, Observation]:
        return dict(zip(self.agents, self._observer.observe(self._belief), strict=True))

    def _assign_rewards(self, terms: list[dict[str, float]]) -> dict[str, float]:
        rewards = [term[self._reward_term] for term in terms]
        if self._shares_reward:
            rewards = [sum(rewards) / len(rewards)] * len(rewards)
        return dict(zip(self.agents, rewards, strict=True))

    def _common_info(self) -> dict[str, Any]:
        return {"scans": self._scans_done, "observed_fraction": self._belief.map.observed_fraction}


def _copy_masks(observations: Mapping[str, Observation], infos: Infos) -> None:
    """Put the action masks where engines look for them besides the observation."""
    for agent, observation in observations.items():
        if "action_mask" in observation:
            infos[agent]["action_mask"] = observation["action_mask"].copy()
