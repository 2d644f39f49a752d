"""The field environment: its parts, put together."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.choices import check_keywords
from coopmap_env.core.files import brief
from coopmap_env.envs.actions import CandidateMode
from coopmap_env.envs.belief import Observation
from coopmap_env.envs.budget import Budget
from coopmap_env.envs.field._episode_world import (
    check_bases_in_search_range,
    check_cameras_in_map,
    has_fixed_bases,
    make_world,
)
from coopmap_env.envs.field._initial_knowledge import (
    initial_free_voxels,
    local_base_pose,
    make_vehicles,
    reset_local_maps,
)
from coopmap_env.envs.field._joint_space import JointSpace
from coopmap_env.envs.field.actions import FieldPoseMode
from coopmap_env.envs.field.arguments import FieldArguments
from coopmap_env.envs.field.belief import FieldBelief
from coopmap_env.envs.field.diagnostics import FieldDiagnostics
from coopmap_env.envs.field.localizer import TeamLocalizer
from coopmap_env.envs.field.observations import FieldObserver
from coopmap_env.envs.field.planning import FieldPlanning
from coopmap_env.envs.field.reachability import MotionLimits, Reachability
from coopmap_env.envs.field.settings import FieldSettings
from coopmap_env.envs.field.team_state import Joints, TeamState
from coopmap_env.envs.field.transition import (
    FieldRngs,
    FusedScans,
    TeamMoveResult,
    path_time,
    step_outcomes,
)
from coopmap_env.envs.field.true_poses import TruePoses
from coopmap_env.envs.mapping_env import MappingEnv
from coopmap_env.envs.rewards import RewardScale, reward_terms
from coopmap_env.envs.step_data import EpisodeSeeds, InfoTypes, TeamStep
from coopmap_env.envs.team import TeamEnv
from coopmap_env.information import FieldRatingFunction
from coopmap_env.mapping import OccupancyMap, VoxelGrid
from coopmap_env.rendering import overview_camera, render_field, robot_triangles, scene_meshes
from coopmap_env.robots import Mount, make_mount
from coopmap_env.sensing import Scan
from coopmap_env.simulation import FieldSimulator, draw_true_mount
from coopmap_env.simulation.physics import MAX_VEHICLES
from coopmap_env.simulation.scenes.field import FieldWorld, make_field_scene


class FieldEnv(MappingEnv[FieldBelief]):
    """Cooperative active mapping with depth cameras on mounts; see `coopmap_env.field_v1`.

    Parameters
    ----------
    *args, **kwargs
        `FieldArguments`.

    Raises
    ------
    ValueError
        If an argument is not accepted.
    ImportError
        With the pip command, if an extra is missing.
    """

    metadata: ClassVar[dict[str, Any]] = {
        "name": "coopmap/Field-v1",
        "render_modes": ["rgb_array", "human"],
        "render_fps": 2,
        "is_parallelizable": True,
    }
    _own_info_types: ClassVar[InfoTypes] = {
        "located": bool,
        "localization_failure": int,
        "corrected_directions": int,
        "correction_failure": int,
        "camera_error": float,
        "camera_angle_error": float,
        "base_error": float,
        "base_angle_error": float,
    }

    _actions: FieldPoseMode | CandidateMode
    _observer: FieldObserver

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        check_keywords("field_v1", kwargs, FieldArguments)
        arguments = FieldArguments(*args, **kwargs)
        super().__init__(arguments)
        if arguments.n_robots > MAX_VEHICLES:
            raise ValueError(
                f"n_robots must be at most {MAX_VEHICLES}, as many as the physics engine keeps "
                f"apart, got {arguments.n_robots}"
            )
        self.settings = arguments.settings or FieldSettings()
        self.initialization = arguments.initialization
        self.motion_correction = arguments.motion_correction
        self.scene = make_field_scene(arguments.scene)
        self.mounts = _make_mounts(arguments.mount, len(self.possible_agents))
        self._simulator: FieldSimulator | None = None
        s, grid = self.settings, self.scene.grid
        if not isinstance(grid, VoxelGrid) or grid.dimension != 3:
            raise ValueError(
                f"the grid of a scene must be a VoxelGrid of three axes, got {brief(grid)}"
            )
        self._map = OccupancyMap(grid, s.beam, s.log_odds_range)
        n_local_maps = len(self.possible_agents) if arguments.initialization == "search" else 0
        self._local_maps = tuple(
            OccupancyMap(grid, s.beam, s.log_odds_range) for _ in range(n_local_maps)
        )
        self._rating = FieldRatingFunction(s.camera, grid, s.rating, s.log_odds_range)
        if self._rating.max_visible_cells == 0:  # observations are shares of them
            raise ValueError(
                f"camera must see a voxel of {grid.resolution:g} m or more: widen its fields of "
                f"view or enlarge far, got {s.camera}"
            )
        chains = [mount.chain() for mount in self.mounts]
        joint_spaces = tuple(
            JointSpace(chain.lower, chain.upper, s.max_grid_poses) for chain in chains
        )
        self._limits = MotionLimits(joint_spaces, s.motion, s.motion_planner == "ompl")
        self._planning = FieldPlanning()
        self._set_up(
            self._candidate_mode
            or FieldPoseMode(joint_spaces, [mount.joints for mount in self.mounts]),
            FieldObserver(
                grid,
                s,
                [chain.n_joints for chain in chains],
                self._candidate_mode.n_candidates if self._candidate_mode else None,
                include_located=arguments.initialization == "search",
            ),
        )
        self._reward_scale = RewardScale.for_camera(
            self._rating.max_visible_cells, s.rating.n_gray_bins, grid.n_cells
        )
        self._last_scans: list[Scan] = []
        self._outcome_words: list[dict[str, str]] = []
        self._n_scans, self._seconds = 0, 0.0

    @property
    def uncorrected_poses(self) -> Literal["encoders", "kinematic"]:
        """How camera poses follow from readings, where nothing corrects them, and in plans."""
        if self.motion_correction in ("encoders", "kinematic"):
            return self.motion_correction
        return self.settings.correction.prior

    def _start(self, seeds: EpisodeSeeds) -> tuple[FieldBelief, list[Observation]]:
        rngs = FieldRngs.from_seeds(seeds)
        belief = self._reset_world(rngs)
        self._rngs = rngs
        self._last_scans = []
        self._outcome_words = [{} for _ in self.possible_agents]
        self._n_scans, self._seconds = 0, 0.0
        belief = self._with_candidates(replace(belief, budget=self._budget))
        return belief, self._observer.observe(belief)

    def _advance(self, actions: dict[str, Any]) -> TeamStep[FieldBelief]:
        belief, rng = self._belief, self._rngs.noise
        decoded = [self._actions.decode(agent, action, belief) for agent, action in actions.items()]
        rejections = [
            belief.infeasibility_reason(robot, one.pose)
            if one.rejected_reason and one.pose is not None
            else one.rejected_reason.words
            for robot, one in enumerate(decoded)
        ]
        move = self._move(belief, [one.target for one in decoded], rng)
        self._outcome_words = [
            {"rejected_reason": rejection, "collided": name}
            for rejection, name in zip(rejections, move.collided_with, strict=True)
        ]
        rated = belief.rate_team(move.poses)
        fused = self._fuse_scans(belief.with_poses(move.poses), rng)
        costs = [self.settings.collision_cost if name else 0.0 for name in move.collided_with]
        outcomes = step_outcomes(rated, fused.gains, costs, self._require_simulator().newly_shown)
        self._last_scans = fused.scans
        self._n_scans += 1
        self._seconds += move.duration + self.settings.scan_time
        belief = self._with_candidates(replace(fused.belief, budget=self._budget))
        return TeamStep(
            belief,
            outcomes,
            [reward_terms(one, self._reward_scale, self.reports_shown) for one in outcomes],
            [bool(name) for name in move.collided_with],
            [one.rejected_reason for one in decoded],
            self._observer.observe(belief),
        )

    @property
    def _scans_done(self) -> int:
        return self._n_scans

    @property
    def _elapsed_time(self) -> float:
        return self._seconds

    @property
    def last_scans(self) -> list[Scan]:
        """Scans of the last step, as they were fused."""
        return self._last_scans

    def _with_candidates(self, belief: FieldBelief) -> FieldBelief:
        """The belief with new candidates in "candidates" mode, otherwise the belief itself."""
        if self._candidate_mode is None:
            return belief
        m, rng = self._candidate_mode.n_candidates, self._rngs.candidates
        robots = range(len(self.possible_agents))
        return belief.with_candidates([belief.random_poses(robot, m, rng) for robot in robots])

    def _reset_world(self, rngs: FieldRngs) -> FieldBelief:
        s, n = self.settings, len(self.possible_agents)
        world = make_world(self.scene, rngs.scene, n)
        searching = self.initialization == "search"
        if searching:
            headings = rngs.start.uniform(-math.pi, math.pi, n)
            if not has_fixed_bases(self.scene):
                world = world.with_headings(headings)
            check_bases_in_search_range(world, s.registration.search)
        bases = [local_base_pose(world.grid)] * n if searching else world.base_poses
        vehicles = make_vehicles(self.mounts, bases, self.uncorrected_poses == "kinematic")
        check_cameras_in_map(world.name, vehicles, world.grid)
        if searching and has_fixed_bases(self.scene):
            true_vehicles = make_vehicles(self.mounts, world.base_poses)
            check_cameras_in_map(world.name, true_vehicles, world.grid)
        mounts = [
            draw_true_mount(mount, s.max_stiffness_error, rngs.vehicles) for mount in self.mounts
        ]
        simulator = FieldSimulator(world, mounts, s.camera, s.noise, s.physics, rngs.start)
        if self.reports_shown:
            known = initial_free_voxels(world.grid, world.base_poses, s.initial_free_radius)
            simulator.keep_shown(known)
        self._close_simulator()
        self._simulator = simulator
        self._map.clear()
        reset_local_maps(self._local_maps, s.initial_free_radius)
        if not searching:
            self._map.mark_free(
                initial_free_voxels(world.grid, world.base_poses, s.initial_free_radius)
            )
        home = [np.array(mount.home) for mount in self.mounts]
        local_maps = self._local_maps or (None,) * n
        team = TeamState(vehicles, tuple(home), self._map, local_maps)
        belief = FieldBelief(
            agents=tuple(self.possible_agents),
            map=self._map,
            actions=self._actions,
            planning=self._planning,
            candidates=None,
            budget=Budget(self.max_scans),
            scan_time=s.scan_time,
            team=team,
            estimates=(),
            rating_function=self._rating,
            limits=self._limits,
            reachability=Reachability(self._limits, team),
        ).with_poses(home)
        self._localizer = TeamLocalizer(
            s, self.motion_correction, world.target_triangles, belief, TruePoses(world.base_poses)
        )
        return belief

    def _move(
        self, belief: FieldBelief, targets: Sequence[Joints | None], rng: np.random.Generator
    ) -> TeamMoveResult:
        """Move all mounts along their paths, one waypoint at a time; a collision ends a path."""
        simulator = self._require_simulator()
        paths: list[Sequence[Joints | None]] = [
            [None] if target is None else list(belief.reachability.path(robot, target))
            for robot, target in enumerate(targets)
        ]
        duration = max(
            path_time(belief.vehicles[robot].chain, belief.joints[robot], path)
            for robot, path in enumerate(paths)
        )
        collided_with = [""] * len(paths)
        for leg in range(max(map(len, paths))):
            goals = [
                path[leg] if leg < len(path) and not obstacle else None
                for path, obstacle in zip(paths, collided_with, strict=True)
            ]
            moved = simulator.move(goals, rng)
            collided_with = [
                before or result.collided_with
                for before, result in zip(collided_with, moved, strict=True)
            ]
        measured = [result.measured_configuration for result in moved]
        return TeamMoveResult(measured, collided_with, duration)

    def _fuse_scans(self, belief: FieldBelief, rng: np.random.Generator) -> FusedScans:
        simulator, robots = self._require_simulator(), range(len(belief.agents))
        clouds = [simulator.scan(robot, rng) for robot in robots]
        true_cameras = [simulator.true_camera_pose(robot) for robot in robots]
        return self._localizer.fuse(belief, clouds, true_cameras)

    def _own_info(self, robot: int) -> dict[str, Any]:
        localizer, located = self._localizer, self._belief.located[robot]
        correction = localizer.corrections[robot]
        return {
            "located": located,
            "localization_failure": 0 if located else int(localizer.failure(robot)[0]),
            "corrected_directions": correction.n_directions if correction else 0,
            "correction_failure": int(correction.failure) if correction else 0,
            **self.diagnostics.pose_errors(robot),
        }

    def _explain(self, robot: int) -> dict[str, str]:
        localizer, located = self._localizer, self._belief.located[robot]
        correction = localizer.corrections[robot]
        return {
            **self._outcome_words[robot],
            "localization_failure": "" if located else localizer.failure(robot)[1],
            "correction_failure": correction.reason if correction else "",
        }

    @property
    def localizer(self) -> TeamLocalizer:
        """How the team estimates its poses; for studies."""
        self._require_reset()
        return self._localizer

    @property
    def diagnostics(self) -> FieldDiagnostics:
        """The truth beside the belief, for scoring and rendering only; policies get `belief`."""
        return FieldDiagnostics(
            self.belief(),
            self._require_simulator(),
            self.mounts,
            self.settings.initial_free_radius,
        )

    @property
    def truth(self) -> FieldWorld:
        """The true world, for scoring and rendering only; policies get `belief`."""
        self._require_reset()
        return self._require_simulator().world

    def _shown_mask(self) -> NDArray[np.bool_]:
        return self._require_simulator().shown_mask

    def _render_frame(self) -> NDArray[np.uint8]:
        belief, world = self._belief, self.truth
        located = [robot for robot, is_located in enumerate(belief.located) if is_located]
        return render_field(
            scene_meshes(world),
            belief.map,
            [robot_triangles(belief.vehicles[robot], belief.joints[robot]) for robot in located],
            [belief.estimates[robot].pose for robot in located],
            self.settings.camera,
            overview_camera(world.target_triangles, world.base_poses),
            [self._trails[robot] for robot in located],
            f"{self.scene.name}   scan {self._scans_done} of {self.max_scans} each   "
            f"observed {belief.map.observed_fraction:.1%}",
            located,
            {
                robot: robot_triangles(vehicle, belief.joints[robot])
                for robot, vehicle in enumerate(self.diagnostics.true_vehicles)
                if robot not in located
            },
        )

    def close(self) -> None:
        """Close the window and the physics."""
        super().close()
        self._close_simulator()

    def _require_simulator(self) -> FieldSimulator:
        if self._simulator is None:
            raise RuntimeError("the environment is closed: call reset()")
        return self._simulator

    def _close_simulator(self) -> None:
        if self._simulator is not None:
            self._simulator.close()
            self._simulator = None


def _make_mounts(mount: str | Mount | Sequence[str | Mount], n_robots: int) -> tuple[Mount, ...]:
    """One mount for each robot.

    Raises
    ------
    ValueError
        If there is another number of mounts than of robots, or a name is unknown.
    """
    if isinstance(mount, str | Mount) or not isinstance(mount, Sequence):
        return (make_mount(mount),) * n_robots
    if len(mount) != n_robots:
        raise ValueError(
            f"mount must be one for all or one for each of {n_robots} robots, got {len(mount)}"
        )
    return tuple(make_mount(one) for one in mount)


class FieldTeamEnv(TeamEnv):
    """`FieldEnv` seen by a single agent; see `TeamEnv`.

    Stable-Baselines3 takes the smallest side of an image for its channels. With two robots and
    more, the layers of all maps together are more than the sides: give it the parallel environment
    through `coopmap_agents.sb3.SharedPolicyVecEnv`, or a smaller `crop_cells[1]`.
    """

    metadata = FieldEnv.metadata
    parallel_env = FieldEnv
