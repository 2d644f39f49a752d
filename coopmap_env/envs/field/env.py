"""The field environment: its parts, put together."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from typing import Any, ClassVar, Literal

import numpy as np
from gymnasium.utils import EzPickle
from numpy.typing import NDArray

from coopmap_env.core.arguments import one_of
from coopmap_env.envs.field.actions import JointMode
from coopmap_env.envs.field.belief import FieldBelief
from coopmap_env.envs.field.joint_space import JointSpace
from coopmap_env.envs.field.localizer import Locating, begin_alone, check_in_reach, own_base
from coopmap_env.envs.field.observations import FieldObserver
from coopmap_env.envs.field.settings import FieldSettings
from coopmap_env.envs.field.starts import known_around
from coopmap_env.envs.mapping_env import MappingEnv, Motion, Streams
from coopmap_env.envs.rewards import Scale
from coopmap_env.geometry import Pose, displacement_between
from coopmap_env.information import FieldRatingFunction
from coopmap_env.mapping import OccupancyMap, ScanGain
from coopmap_env.rendering.field import overview, render_field, surfaces_of
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
        one_of("initialization", initialization, ("located", "search"))
        one_of("motion_correction", motion_correction, ("kinematic", "fiducials", "exact"))
        self.settings = settings or FieldSettings()
        self.initialization = initialization
        self.motion_correction = motion_correction
        self.scene = make_field_scene(scene)
        self.mounts = _mounts_of(mount, len(self.possible_agents))
        self._simulator: FieldSimulator | None = None
        s, grid = self.settings, self.scene.grid
        self._map = OccupancyMap(grid, s.beam, s.log_odds_range)
        alone = len(self.possible_agents) if initialization == "search" else 0
        self._own_maps = tuple(OccupancyMap(grid, s.beam, s.log_odds_range) for _ in range(alone))
        self._rating = FieldRatingFunction(s.camera, grid, s.rating, s.log_odds_range)
        chains = [mount.chain() for mount in self.mounts]
        self._joint_spaces = tuple(
            JointSpace(chain.lower, chain.upper, s.grid_size) for chain in chains
        )
        self._field_observer = FieldObserver(
            grid,
            s,
            [chain.n_joints for chain in chains],
            self._candidates.n_candidates if self._candidates else None,
            tells_located=initialization == "search",
        )
        self._prepare(
            self._candidates
            or JointMode(self._joint_spaces, [mount.joints for mount in self.mounts]),
            Scale.of(self._rating.n_visible, s.rating.n_gray, grid.n_cells),
            self._field_observer,
            s.contact_cost,
        )

    def _start(self, streams: Streams) -> FieldBelief:
        s, n = self.settings, len(self.possible_agents)
        world = _world_of(self.scene, streams.scene, n)
        searching = self.initialization == "search"
        if searching:
            headings = streams.start.uniform(-math.pi, math.pi, n)
            if not _says_headings(self.scene):
                world = world.turned(headings)
            check_in_reach(world, s.registration.search)
        simulator = FieldSimulator(world, self.mounts, s.camera, s.noise, s.physics, streams.start)
        self._close_simulator()
        self._simulator = simulator
        self._map.clear()
        begin_alone(self._own_maps, s.start_radius)
        if not searching:
            self._map.mark_free(known_around(world.grid, world.base_poses, s.start_radius))
        bases = [own_base(world.grid)] * n if searching else world.base_poses
        self._field_observer.place(bases)
        belief = FieldBelief(
            agents=tuple(self.possible_agents),
            map=self._map,
            actions=self._actions,
            offers=None,
            vehicles=_vehicles(self.mounts, bases),
            joints=(),
            estimates=(),
            rating=self._rating,
            joint_spaces=self._joint_spaces,
            motion=s.motion,
            own_maps=self._own_maps,
            ways_around=s.paths == "ompl",
        )
        self._touched = [""] * n
        belief = belief.moved([np.array(mount.home) for mount in self.mounts])
        self._locating = Locating(
            s, self.motion_correction, world.target_triangles, belief, world.base_poses
        )
        self._trails = [
            [position] if known else []
            for position, known in zip(belief.positions, belief.located, strict=True)
        ]
        return belief

    def _move(self, targets: list[NDArray[np.float64] | None]) -> Motion:
        simulator = self._open_simulator()
        ways = [
            [None] if target is None else self._belief.way(robot, target)
            for robot, target in enumerate(targets)
        ]
        self._touched = [""] * len(ways)
        for leg in range(max(map(len, ways))):
            goals = [
                way[leg] if leg < len(way) and not touched else None
                for way, touched in zip(ways, self._touched, strict=True)
            ]
            moved = simulator.move(goals, self._streams.noise)
            self._touched = [
                before or now.touched for before, now in zip(self._touched, moved, strict=True)
            ]
        return Motion([reading for reading, _ in moved], self._touched)

    def _scans(self) -> list[Scan]:
        simulator, noise = self._open_simulator(), self._streams.noise
        scans = []
        for robot in range(len(self.possible_agents)):
            cloud = simulator.scan(robot, noise)
            true = simulator.true_camera_pose(robot)
            estimate, scan = self._locating.look(self._belief, robot, cloud, true)
            if estimate is not self._belief.estimates[robot]:
                self._belief = self._belief.with_estimate(robot, estimate)
            scans.append(scan)
        return scans

    def _fuse(self, scans: list[Scan]) -> list[ScanGain]:
        """Fuse each scan into the map that its robot plans on, then look for the target in it."""
        before = self._belief.located
        if all(before):
            gains = super()._fuse(scans)
        else:
            shared = [robot for robot, known in enumerate(before) if known]
            brought = dict(
                zip(shared, super()._fuse([scans[robot] for robot in shared]), strict=True)
            )
            gains = [
                brought[robot] if known else self._belief.map_of(robot).integrate(scan)[0]
                for robot, (scan, known) in enumerate(zip(scans, before, strict=True))
            ]
            self._belief = self._locating.search(self._belief)
            if self._belief.located != before:
                for robot, known in enumerate(before):
                    if self._belief.located[robot] and not known:
                        scans[robot] = self._locating.last_scan(robot)
                self._field_observer.place([v.T_world_base for v in self._belief.vehicles])
        for trail, estimate, known in zip(
            self._trails, self._belief.estimates, self._belief.located, strict=True
        ):
            if known:
                trail.append(estimate.pose.translation)
        return gains

    def _own_info(self, robot: int) -> dict[str, Any]:
        belief, corrected = self._belief, self._locating.corrections[robot]
        true = self.true_cameras[robot]
        base, known = self.truth.base_poses[robot], belief.located[robot]
        off = displacement_between(self.taken_camera(robot), true)
        base_off = displacement_between(belief.vehicles[robot].T_world_base, base)
        return {
            "touched": self._touched[robot],
            "camera_error": float(np.linalg.norm(off[:3])),
            "camera_angle_error": float(np.linalg.norm(off[3:])),
            "located": known,
            "not_located": "" if known else self._locating.why_not(robot),
            "base_error": float(np.linalg.norm(base_off[:3])) if known else None,
            "base_angle_error": float(np.linalg.norm(base_off[3:])) if known else None,
            "corrected_directions": corrected.directions if corrected else 0,
            "uncorrected": corrected.reason if corrected else "",
        }

    @property
    def locating(self) -> Locating:
        """What the team knows of where it is, and how it came to know it; for studies."""
        self._require_reset()
        return self._locating

    def taken_camera(self, robot: int) -> Pose:
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
        simulator = self._open_simulator()
        return [simulator.true_camera_pose(k) for k in range(len(self.possible_agents))]

    @property
    def parking_room(self) -> NDArray[np.bool_]:
        """Voxels, shape of the grid, that are known without a look once all are located."""
        world = self.truth
        room = np.zeros(world.grid.n_cells, dtype=np.bool_)
        room[known_around(world.grid, world.base_poses, self.settings.start_radius)] = True
        return room.reshape(world.grid.shape)

    @property
    def true_vehicles(self) -> tuple[Vehicle, ...]:
        """The vehicles where they truly stand, for scoring only."""
        return _vehicles(self.mounts, self.truth.base_poses)

    @property
    def truth(self) -> FieldWorld:
        """The true world, for scoring and rendering only; policies get `belief`."""
        self._require_reset()
        return self._open_simulator().world

    def _frame(self) -> NDArray[np.uint8]:
        belief, world = self._belief, self.truth
        known = [robot for robot, located in enumerate(belief.located) if located]
        return render_field(
            surfaces_of(world),
            belief.map,
            [robot_triangles(belief.vehicles[robot], belief.joints[robot]) for robot in known],
            [belief.estimates[robot].pose for robot in known],
            self.settings.camera,
            overview(world.target_triangles, world.base_poses),
            [self._trails[robot] for robot in known],
            f"{self.scene.name}   scan {self._scans_done} of {self.max_scans} each   "
            f"viewed {belief.map.viewed_share:.1%}",
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

    def _open_simulator(self) -> FieldSimulator:
        if self._simulator is None:
            raise RuntimeError("the environment is closed: call reset()")
        return self._simulator

    def _close_simulator(self) -> None:
        if self._simulator is not None:
            self._simulator.close()
            self._simulator = None


def _mounts_of(mount: str | Mount | Sequence[str | Mount], n_robots: int) -> tuple[Mount, ...]:
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


def _says_headings(scene: FieldScene) -> bool:
    """Whether a scene's file names the poses of the bases."""
    return isinstance(scene, UserScene) and bool(scene.bases)


def _vehicles(mounts: Sequence[Mount], bases: Sequence[Pose]) -> tuple[Vehicle, ...]:
    return tuple(Vehicle.of(mount, base) for mount, base in zip(mounts, bases, strict=True))


def _world_of(scene: FieldScene, rng: np.random.Generator, n_robots: int) -> FieldWorld:
    world = scene.world(rng, n_robots)
    if world.grid != scene.grid:
        raise ValueError(f"scene {scene.name!r} made a world of {world.grid}, not {scene.grid}")
    if world.n_robots != n_robots:
        raise ValueError(
            f"scene {scene.name!r} made room for {world.n_robots} robots, not {n_robots}"
        )
    return world
