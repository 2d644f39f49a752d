"""The planar environment: it conducts one step and computes nothing itself."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any, ClassVar, Literal

import numpy as np
from gymnasium import spaces
from gymnasium.utils import EzPickle
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

from coopmap_env.envs.actions import ActionMode, CandidateMode, InvalidActionError, PoseMode
from coopmap_env.envs.arguments import at_least_one, one_of
from coopmap_env.envs.belief import Belief
from coopmap_env.envs.observations import Observation, Observer
from coopmap_env.envs.rendering import HumanWindow, render_team
from coopmap_env.envs.rewards import TERMS, Look, Scale, terms_of
from coopmap_env.envs.settings import PlanarSettings
from coopmap_env.envs.starts import place_team
from coopmap_env.information import RatingFunction
from coopmap_env.mapping import OccupancyMap, ScanGain, VoxelGrid
from coopmap_env.robots import PoseLattice
from coopmap_env.simulation import PlanarSimulator
from coopmap_env.simulation.scenes import Scene, World, make_scene, world_seed

Infos = dict[str, dict[str, Any]]


class PlanarEnv(ParallelEnv[str, Observation, Any], EzPickle):
    """Cooperative active mapping in the plane; see `coopmap_env.planar_v0` for its page.

    Parameters
    ----------
    n_robots : int
        Cameras in the team.
    action_mode : {"pose", "candidates"}
        See `coopmap_env.envs.actions`.
    reward : {"rating", "information", "coverage"}
        The term that is paid; see `coopmap_env.envs.rewards`. All are in `infos`.
    team_reward : {"individual", "shared"}
        Each robot its own, or all the mean of the team.
    scene : str, path or Scene
        "obstacles", "rooms", "house", a ROS map_server YAML file, or an object.
    split : {"train", "validation", "test"}
        Which of the frozen splits seeds draw their worlds from.
    max_scans : int
        Scans of each robot until truncation.
    n_candidates : int
        m, in "candidates" mode.
    settings : PlanarSettings, optional
        Default: `PlanarSettings.for_resolution` of the scene.
    render_mode : {None, "rgb_array", "human"}

    Raises
    ------
    ValueError
        If an argument is none of its choices.
    """

    metadata: ClassVar[dict[str, Any]] = {
        "name": "coopmap/Planar-v0",
        "render_modes": ["rgb_array", "human"],
        "render_fps": 4,
        "is_parallelizable": True,
    }

    def __init__(
        self,
        n_robots: int = 2,
        action_mode: Literal["pose", "candidates"] = "pose",
        reward: str = "rating",
        team_reward: Literal["individual", "shared"] = "individual",
        scene: str | os.PathLike[str] | Scene = "obstacles",
        split: str = "train",
        max_scans: int = 16,
        n_candidates: int = 32,
        settings: PlanarSettings | None = None,
        render_mode: str | None = None,
    ) -> None:
        EzPickle.__init__(
            self, n_robots, action_mode, reward, team_reward, scene, split, max_scans,
            n_candidates, settings, render_mode,
        )  # fmt: skip
        n_robots = at_least_one("n_robots", n_robots)
        self.max_scans = at_least_one("max_scans", max_scans)
        n_candidates = at_least_one("n_candidates", n_candidates)
        one_of("action_mode", action_mode, ("pose", "candidates"))
        one_of("reward", reward, tuple(TERMS))
        one_of("team_reward", team_reward, ("individual", "shared"))
        one_of("render_mode", render_mode, (None, *self.metadata["render_modes"]))
        world_seed(split, 0)  # refuses an unknown split
        if not isinstance(settings, PlanarSettings | None):
            raise ValueError(f"settings must be PlanarSettings or None, got {settings!r}")
        self.scene = make_scene(scene)
        self.split = split
        self.settings = settings or PlanarSettings.for_resolution(self.scene.resolution)
        self.render_mode = render_mode
        self.possible_agents = [f"robot_{i}" for i in range(n_robots)]
        self.agents: list[str] = []
        self._reward = reward
        self._shared = team_reward == "shared"
        self._actions: ActionMode = (
            PoseMode(self.settings.reach) if action_mode == "pose" else CandidateMode(n_candidates)
        )
        self._belief = self._blank_belief()
        self._scale = Scale.of(self._belief.rating)
        self._observer = Observer(
            self._belief,
            self.settings.view_cells,
            n_candidates if action_mode == "candidates" else None,
        )
        self.action_spaces = {agent: self._actions.space() for agent in self.possible_agents}
        self.observation_spaces = {agent: self._observer.space() for agent in self.possible_agents}
        self.state_space = self._observer.state_space()
        self._window: HumanWindow | None = None
        self._seeds = np.random.default_rng()
        self._simulator: PlanarSimulator | None = None
        self._scans_done = 0

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
            If the seed is no whole number of at least 0, or the scene makes a world of another
            shape, resolution or origin than it says. A running episode goes on then.
        """
        if seed is None:
            seed = int(self._seeds.integers(2**31))
        scene_rng, start_rng, noise_rng, candidate_rng, seeds = (
            np.random.default_rng(child) for child in world_seed(self.split, seed).spawn(5)
        )
        world = _world_of(self.scene, scene_rng)
        self._noise_rng, self._candidate_rng, self._seeds = noise_rng, candidate_rng, seeds
        self._simulator = PlanarSimulator(world, self.settings.camera, self.settings.noise)
        self._belief.map.clear()
        starts, known = place_team(
            world,
            self._belief.lattice,
            len(self.possible_agents),
            self.settings.start_spread,
            self.settings.start_radius,
            start_rng,
        )
        self._belief.map.mark_free(known)
        self._belief = self._belief.moved(starts)
        self._trails = [[pose] for pose in self._belief.poses[:, :2]]
        self._scans_done = 0
        self.agents = list(self.possible_agents)
        self._offer_candidates()
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
        where it is, and ``infos[agent]["refused"]`` says why. Where the map is wrong and the goal
        is truly occupied, the camera bumps into it: it stays too, ``infos[agent]["contact"]`` is
        true, and the map learns of the cell.

        Raises
        ------
        InvalidActionError
            If an action is missing, superfluous or no member of its space; nothing has happened
            then and the step can be repeated.
        RuntimeError
            Before the first reset and after the end of an episode.
        """
        wanted = self._decode(actions)
        before = self._belief
        contacts = [not refused and self._collides(pose_id) for pose_id, refused in wanted]
        executed = tuple(
            before.pose_ids[robot] if refused or contacts[robot] else pose_id
            for robot, (pose_id, refused) in enumerate(wanted)
        )
        rated = before.rating.rate_team(before.map, executed, before.pose_ids)
        for robot in range(len(wanted)):
            if contacts[robot]:
                before.map.mark_occupied([wanted[robot][0] // before.lattice.n_headings])
        self._belief = before.moved(executed)
        gains = self._scan()
        self._scans_done += 1
        self._offer_candidates()
        looks = [
            Look(*values)
            for values in zip(
                rated.new_information.tolist(),
                rated.distance.tolist(),
                rated.motion_cost.tolist(),
                rated.rating.tolist(),
                gains,
                strict=True,
            )
        ]
        terms = [terms_of(look, self._scale) for look in looks]
        common = self._common_info()
        infos = {
            agent: {
                **common,
                "refused": wanted[robot][1],
                "contact": contacts[robot],
                "terms": terms[robot],
                "new_information": looks[robot].new_information,
                "distance": looks[robot].distance,
                "new_cells": gains[robot].new_cells,
                "entropy_drop": gains[robot].entropy_drop,
            }
            for robot, agent in enumerate(self.agents)
        }
        rewards = self._pay(terms)
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
        """Return the team map and all poses, for centralised critics; see `Observer.state`."""
        return self._observer.state(self.belief())

    def belief(self) -> Belief:
        """Return what the robots know: the input of planners. Never the truth.

        Raises
        ------
        RuntimeError
            Before the first reset.
        """
        self._require_reset()
        return self._belief

    @property
    def truth(self) -> World:
        """The true world, for scoring and rendering only; policies get `belief`."""
        return self._require_reset().world

    def render(self) -> NDArray[np.uint8] | None:
        """Truth, team map and cameras as an (H, W, 3) image, or in a window."""
        if self.render_mode is None:
            return None
        simulator, map_, grid = self._require_reset(), self._belief.map, self._belief.map.grid
        poses = self._belief.poses
        frame = render_team(
            simulator.world.occupied,
            map_.probability,
            map_.sampled,
            np.column_stack([grid.cells(poses[:, :2]), poses[:, 2]]),
            self.settings.camera.field_of_view,
            self.settings.camera.depth_of_field / grid.resolution,
            [grid.cells(trail) for trail in self._trails],
            f"{self.scene.name}   scan {self._scans_done} of {self.max_scans} each   "
            f"viewed {map_.viewed_share:.1%}",
        )
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

    def _blank_belief(self) -> Belief:
        s = self.settings
        grid = VoxelGrid(self.scene.shape, self.scene.resolution, self.scene.origin)
        lattice = PoseLattice(grid, s.n_headings)
        return Belief(
            tuple(self.possible_agents),
            OccupancyMap(grid, s.beam, s.log_odds_range),
            (0,) * len(self.possible_agents),
            RatingFunction(s.camera, lattice, s.rating, s.log_odds_range),
            s.reach,
            self._actions,
        )

    def _require_reset(self) -> PlanarSimulator:
        if self._simulator is None:
            raise RuntimeError("call reset() first: there is no world yet")
        return self._simulator

    def _decode(self, actions: Mapping[str, Any]) -> list[tuple[int, str]]:
        self._require_reset()
        if not self.agents:
            raise RuntimeError(f"the episode ended after {self.max_scans} scans: call reset()")
        if not isinstance(actions, Mapping) or set(actions) != set(self.agents):
            given = sorted(map(str, actions)) if isinstance(actions, Mapping) else repr(actions)
            raise InvalidActionError(f"one action for each of {self.agents} is needed, got {given}")
        return [self._actions.decode(agent, actions[agent], self._belief) for agent in self.agents]

    def _collides(self, pose_id: int) -> bool:
        return self._require_reset().collides(self._belief.lattice.pose(pose_id))

    def _scan(self) -> list[ScanGain]:
        simulator, poses = self._require_reset(), self._belief.poses
        for trail, pose in zip(self._trails, poses, strict=True):
            trail.append(pose[:2])
        return self._belief.map.integrate([simulator.scan(pose, self._noise_rng) for pose in poses])

    def _offer_candidates(self) -> None:
        if isinstance(self._actions, CandidateMode):
            offers = tuple(
                self._belief.random_poses(robot, self._actions.n_candidates, self._candidate_rng)
                for robot in range(len(self.possible_agents))
            )
            self._belief = self._belief.moved(self._belief.pose_ids, offers)

    def _observe(self) -> dict[str, Observation]:
        return dict(zip(self.agents, self._observer.observe(self._belief), strict=True))

    def _pay(self, terms: list[dict[str, float]]) -> dict[str, float]:
        paid = [term[self._reward] for term in terms]
        if self._shared:
            paid = [sum(paid) / len(paid)] * len(paid)
        return dict(zip(self.agents, paid, strict=True))

    def _common_info(self) -> dict[str, Any]:
        return {"scans": self._scans_done, "viewed_share": self._belief.map.viewed_share}


def _copy_masks(observations: Mapping[str, Observation], infos: Infos) -> None:
    """Put action masks into infos too: training libraries differ in where they look."""
    for agent, observation in observations.items():
        if "action_mask" in observation:
            infos[agent]["action_mask"] = observation["action_mask"].copy()


def _world_of(scene: Scene, rng: np.random.Generator) -> World:
    world = scene.world(rng)
    for name in ("shape", "resolution", "origin"):
        made, said = getattr(world, name), getattr(scene, name)
        if made != said:
            raise ValueError(f"scene {scene.name!r} made a world of {name} {made}, not {said}")
    return world
