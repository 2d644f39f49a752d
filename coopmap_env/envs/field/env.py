"""The field environment: its parts, put together."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from typing import Any, ClassVar, Literal

import numpy as np
from gymnasium.utils import EzPickle
from numpy.typing import NDArray

from coopmap_env.core.arguments import check_choice
from coopmap_env.envs.field.actions import JointMode
from coopmap_env.envs.field.belief import FieldBelief
from coopmap_env.envs.field.joint_space import JointSpace
from coopmap_env.envs.field.localizer import (
    TeamLocalizer,
    check_bases_in_search_range,
    local_base_pose,
    reset_local_maps,
)
from coopmap_env.envs.field.observations import FieldObserver
from coopmap_env.envs.field.settings import FieldSettings
from coopmap_env.envs.field.starts import initial_free_voxels
from coopmap_env.envs.mapping_env import EpisodeRngs, MappingEnv, TeamMoveResult
from coopmap_env.envs.rewards import RewardScale
from coopmap_env.geometry import Pose, displacement_between
from coopmap_env.information import FieldRatingFunction
from coopmap_env.mapping import OccupancyMap, ScanGain
from coopmap_env.rendering.field import overview_camera, render_field, scene_meshes
from coopmap_env.rendering.meshes import robot_triangles
from coopmap_env.robots import Mount, Vehicle, make_mount
from coopmap_env.sensing import Scan
from coopmap_env.simulation.field import FieldSimulator
from coopmap_env.simulation.scenes.field import FieldScene, FieldWorld, UserScene, make_field_scene


class FieldEnv(MappingEnv[FieldBelief], EzPickle):
    """Cooperative active mapping in the field; see `coopmap_env.field_v0` for its page.

    Parameters
    ----------
    n_robots : int
        Vehicles in the team.
    mount : str, Mount or sequence of them
        "mast", "husky_panda", "tiago" or a `Mount`; one for all vehicles, or one for each.
    action_mode : {"pose", "candidates"}
        See `coopmap_env.envs.actions`.
    reward : {"rating", "information", "coverage"}
        The term that is paid; see `coopmap_env.envs.rewards`. All are in `infos`.
    team_reward : {"individual", "shared"}
        Each robot its own, or all the mean of the team.
    scene : str, path or FieldScene
        "worksite", "clutter", "rubble", a YAML file, or an object.
    split : {"train", "validation", "test"}
        Which of the frozen splits seeds draw their worlds from.
    max_scans : int
        Scans of each robot until truncation.
    n_candidates : int
        m, in "candidates" mode.
    initialization : {"located", "search"}
        Whether robots know where they stand, or have to find the target first, parked with any
        heading (2.2).
    motion_correction : {"kinematic", "fiducials", "exact"}
        Where a robot takes its camera to be: where its encoders say, with the covariance of
        encoders, calibration and suspension; corrected by fiducials (2.5); or, for upper bounds
        only, where it truly is.
    settings : FieldSettings, optional
    render_mode : {None, "rgb_array", "human"}

    Raises
    ------
    ValueError
        If an argument is none of its choices.
    ImportError
        With the pip command, if an extra is missing.
    """

    metadata: ClassVar[dict[str, Any]] = {
        "name": "coopmap/Field-v0",
        "render_modes": ["rgb_array", "human"],
        "render_fps": 2,
        "is_parallelizable": True,
    }

    def __init__(
        self,
        n_robots: int = 2,
        mount: str | Mount | Sequence[str | Mount] = "mast",
        action_mode: Literal["pose", "candidates"] = "pose",
        reward: str = "rating",
        team_reward: Literal["individual", "shared"] = "individual",
        scene: str | os.PathLike[str] | FieldScene = "worksite",
        split: str = "train",
        max_scans: int = 16,
        n_candidates: int = 32,
        settings: FieldSettings | None = None,
        render_mode: str | None = None,
        initialization: Literal["located", "search"] = "located",
        motion_correction: Literal["kinematic", "fiducials", "exact"] = "kinematic",
    ) -> None:
        EzPickle.__init__(
            self, n_robots, mount, action_mode, reward, team_reward, scene, split, max_scans,
            n_candidates, settings, render_mode, initialization, motion_correction,
        )  # fmt: skip
        super().__init__(
            n_robots, action_mode, reward, team_reward, split, max_scans, n_candidates, render_mode
        )
        if not isinstance(settings, FieldSettings | None):
            raise ValueError(f"settings must be FieldSettings or None, got {settings!r}")
        check_choice("initialization", initialization, ("located", "search"))
        check_choice("motion_correction", motion_correction, ("kinematic", "fiducials", "exact"))
        self.settings = settings or FieldSettings()
        self.initialization = initialization
        self.motion_correction = motion_correction
        self.scene = make_field_scene(scene)
        self.mounts = _make_mounts(mount, len(self.possible_agents))
        self._simulator: FieldSimulator | None = None
        s, grid = self.settings, self.scene.grid
        self._map = OccupancyMap(grid, s.beam, s.log_odds_range)
        n_local_maps = len(self.possible_agents) if initialization == "search" else 0
        self._local_maps = tuple(
            OccupancyMap(grid, s.beam, s.log_odds_range) for _ in range(n_local_maps)
        )
        self._rating = FieldRatingFunction(s.camera, grid, s.rating, s.log_odds_range)
        chains = [mount.chain() for mount in self.mounts]
        self._joint_spaces = tuple(
            JointSpace(chain.lower, chain.upper, s.max_grid_poses) for chain in chains
        )
        self._field_observer = FieldObserver(
            grid,
            s,
            [chain.n_joints for chain in chains],
            self._candidate_mode.n_candidates if self._candidate_mode else None,
            include_located=initialization == "search",
        )
        self._set_up(
            self._candidate_mode
            or JointMode(self._joint_spaces, [mount.joints for mount in self.mounts]),
            RewardScale.for_camera(
                self._rating.max_visible_cells, s.rating.n_gray_bins, grid.n_cells
            ),
            self._field_observer,
            s.contact_cost,
        )

    def _reset_world(self, rngs: EpisodeRngs) -> FieldBelief:
        s, n = self.settings, len(self.possible_agents)
        world = _make_world(self.scene, rngs.scene, n)
        searching = self.initialization == "search"
        if searching:
            headings = rngs.start.uniform(-math.pi, math.pi, n)
            if not _has_fixed_bases(self.scene):
                world = world.with_headings(headings)
            check_bases_in_search_range(world, s.registration.search)
        simulator = FieldSimulator(world, self.mounts, s.camera, s.noise, s.physics, rngs.start)
        self._close_simulator()
        self._simulator = simulator
        self._map.clear()
        reset_local_maps(self._local_maps, s.initial_free_radius)
        if not searching:
            self._map.mark_free(
                initial_free_voxels(world.grid, world.base_poses, s.initial_free_radius)
            )
        bases = [local_base_pose(world.grid)] * n if searching else world.base_poses
        self._field_observer.set_bases(bases)
        belief = FieldBelief(
            agents=tuple(self.possible_agents),
            map=self._map,
            actions=self._actions,
            candidates=None,
            vehicles=_make_vehicles(self.mounts, bases),
            joints=(),
            estimates=(),
            rating=self._rating,
            joint_spaces=self._joint_spaces,
            motion=s.motion,
            local_maps=self._local_maps,
            use_motion_planner=s.motion_planner == "ompl",
        )
        self._collided_with = [""] * n
        belief = belief.with_poses([np.array(mount.home) for mount in self.mounts])
        self._localizer = TeamLocalizer(
            s, self.motion_correction, world.target_triangles, belief, world.base_poses
        )
        self._trails = [
            [position] if known else []
            for position, known in zip(belief.positions, belief.located, strict=True)
        ]
        return belief

    def _move(self, targets: list[NDArray[np.float64] | None]) -> TeamMoveResult:
        simulator = self._require_simulator()
        paths = [
            [None] if target is None else self._belief.path(robot, target)
            for robot, target in enumerate(targets)
        ]
        self._collided_with = [""] * len(paths)
        for leg in range(max(map(len, paths))):
            goals = [
                path[leg] if leg < len(path) and not collided_with else None
                for path, collided_with in zip(paths, self._collided_with, strict=True)
            ]
            moved = simulator.move(goals, self._rngs.noise)
            self._collided_with = [
                before or now.collided_with
                for before, now in zip(self._collided_with, moved, strict=True)
            ]
        return TeamMoveResult([reading for reading, _ in moved], self._collided_with)

    def _take_scans(self) -> list[Scan]:
        simulator, noise = self._require_simulator(), self._rngs.noise
        scans = []
        for robot in range(len(self.possible_agents)):
            cloud = simulator.scan(robot, noise)
            true = simulator.true_camera_pose(robot)
            estimate, scan = self._localizer.localize_scan(self._belief, robot, cloud, true)
            if estimate is not self._belief.estimates[robot]:
                self._belief = self._belief.with_camera_estimate(robot, estimate)
            scans.append(scan)
        return scans

    def _fuse(self, scans: list[Scan]) -> list[ScanGain]:
        """Fuse each scan into the map that its robot plans on, then look for the target in it."""
        before = self._belief.located
        if all(before):
            gains = super()._fuse(scans)
        else:
            shared = [robot for robot, known in enumerate(before) if known]
            shared_gains = dict(
                zip(shared, super()._fuse([scans[robot] for robot in shared]), strict=True)
            )
            gains = [
                shared_gains[robot]
                if known
                else self._belief.planning_map(robot).integrate(scan)[0]
                for robot, (scan, known) in enumerate(zip(scans, before, strict=True))
            ]
            self._belief = self._localizer.search_target(self._belief)
            if self._belief.located != before:
                for robot, known in enumerate(before):
                    if self._belief.located[robot] and not known:
                        scans[robot] = self._localizer.last_scan(robot)
                self._field_observer.set_bases([v.T_world_base for v in self._belief.vehicles])
        for trail, estimate, known in zip(
            self._trails, self._belief.estimates, self._belief.located, strict=True
        ):
            if known:
                trail.append(estimate.pose.translation)
        return gains

    def _extra_info(self, robot: int) -> dict[str, Any]:
        belief, corrected = self._belief, self._localizer.corrections[robot]
        true = self.true_cameras[robot]
        base, known = self.truth.base_poses[robot], belief.located[robot]
        camera_error = displacement_between(self.estimated_camera_pose(robot), true)
        base_error = displacement_between(belief.vehicles[robot].T_world_base, base)
        return {
            "collided_with": self._collided_with[robot],
            "camera_error": float(np.linalg.norm(camera_error[:3])),
            "camera_angle_error": float(np.linalg.norm(camera_error[3:])),
            "located": known,
            "localization_failure": "" if known else self._localizer.failure_reason(robot),
            "base_error": float(np.linalg.norm(base_error[:3])) if known else None,
            "base_angle_error": float(np.linalg.norm(base_error[3:])) if known else None,
            "corrected_directions": corrected.n_directions if corrected else 0,
            "correction_failure": corrected.reason if corrected else "",
        }

    @property
    def localizer(self) -> TeamLocalizer:
        """What the team knows of where it is, and how it came to know it; for studies."""
        self._require_reset()
        return self._localizer

    def estimated_camera_pose(self, robot: int) -> Pose:
        """T_world_camera as a robot takes it to be, for scoring and pictures.

        Of one that is not located: in its own frame, put where that truly is.
        """
        belief = self.belief()
        taken = belief.estimates[robot].pose
        if belief.located[robot]:
            return taken
        own = belief.vehicles[robot].T_world_base
        return self.truth.base_poses[robot] @ own.inverse() @ taken

    @property
    def true_cameras(self) -> list[Pose]:
        """T_world_camera as it is, for scoring only."""
        simulator = self._require_simulator()
        return [simulator.true_camera_pose(k) for k in range(len(self.possible_agents))]

    @property
    def initial_free_mask(self) -> NDArray[np.bool_]:
        """Voxels, shape of the grid, that are known without a look once all are located."""
        world = self.truth
        room = np.zeros(world.grid.n_cells, dtype=np.bool_)
        room[
            initial_free_voxels(world.grid, world.base_poses, self.settings.initial_free_radius)
        ] = True
        return room.reshape(world.grid.shape)

    @property
    def true_vehicles(self) -> tuple[Vehicle, ...]:
        """The vehicles where they truly stand, for scoring only."""
        return _make_vehicles(self.mounts, self.truth.base_poses)

    @property
    def truth(self) -> FieldWorld:
        """The true world, for scoring and rendering only; policies get `belief`."""
        self._require_reset()
        return self._require_simulator().world

    def _render_frame(self) -> NDArray[np.uint8]:
        belief, world = self._belief, self.truth
        known = [robot for robot, located in enumerate(belief.located) if located]
        return render_field(
            scene_meshes(world),
            belief.map,
            [robot_triangles(belief.vehicles[robot], belief.joints[robot]) for robot in known],
            [belief.estimates[robot].pose for robot in known],
            self.settings.camera,
            overview_camera(world.target_triangles, world.base_poses),
            [self._trails[robot] for robot in known],
            f"{self.scene.name}   scan {self._scans_done} of {self.max_scans} each   "
            f"viewed {belief.map.observed_fraction:.1%}",
            known,
            {
                robot: robot_triangles(vehicle, belief.joints[robot])
                for robot, vehicle in enumerate(self.true_vehicles)
                if robot not in known
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


def _has_fixed_bases(scene: FieldScene) -> bool:
    """Whether a scene's file names the poses of the bases."""
    return isinstance(scene, UserScene) and bool(scene.bases)


def _make_vehicles(mounts: Sequence[Mount], bases: Sequence[Pose]) -> tuple[Vehicle, ...]:
    return tuple(Vehicle.from_mount(mount, base) for mount, base in zip(mounts, bases, strict=True))


def _make_world(scene: FieldScene, rng: np.random.Generator, n_robots: int) -> FieldWorld:
    world = scene.world(rng, n_robots)
    if world.grid != scene.grid:
        raise ValueError(f"scene {scene.name!r} made a world of {world.grid}, not {scene.grid}")
    if world.n_robots != n_robots:
        raise ValueError(
            f"scene {scene.name!r} made room for {world.n_robots} robots, not {n_robots}"
        )
    return world
