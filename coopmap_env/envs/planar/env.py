"""The planar environment: its parts, put together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
from gymnasium.utils import EzPickle
from numpy.typing import NDArray

from coopmap_env.core.files import brief
from coopmap_env.envs.mapping_env import MappingEnv
from coopmap_env.envs.planar._starts import sample_start_poses
from coopmap_env.envs.planar.actions import PlanarPoseMode
from coopmap_env.envs.planar.arguments import PlanarArguments
from coopmap_env.envs.planar.belief import PlanarBelief
from coopmap_env.envs.planar.observations import PlanarObserver
from coopmap_env.envs.planar.planning import PlanarPlanning
from coopmap_env.envs.planar.settings import PlanarSettings
from coopmap_env.envs.rewards import RewardScale
from coopmap_env.envs.step_data import EpisodeRngs, FusedScans, TeamMoveResult
from coopmap_env.envs.team import TeamEnv
from coopmap_env.information import PlanarRatingFunction
from coopmap_env.mapping import OccupancyMap, VoxelGrid
from coopmap_env.rendering import render_team
from coopmap_env.robots import PoseLattice
from coopmap_env.simulation import PlanarSimulator
from coopmap_env.simulation.scenes.planar import PlanarScene, PlanarWorld, make_planar_scene


class PlanarEnv(MappingEnv[PlanarBelief], EzPickle):
    """Cooperative active mapping with planar cameras; see `coopmap_env.planar_v1`.

    Parameters
    ----------
    *args, **kwargs
        `PlanarArguments`.

    Raises
    ------
    ValueError
        If an argument is not accepted.
    """

    metadata: ClassVar[dict[str, Any]] = {
        "name": "coopmap/Planar-v1",
        "render_modes": ["rgb_array", "human"],
        "render_fps": 4,
        "is_parallelizable": True,
    }

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        arguments = PlanarArguments(*args, **kwargs)
        EzPickle.__init__(self, **vars(arguments))
        super().__init__(arguments)
        self.scene = scene = make_planar_scene(arguments.scene)
        self._grid = VoxelGrid(scene.shape, scene.resolution, scene.origin)
        self.settings = arguments.settings or PlanarSettings.for_resolution(scene.resolution)
        self._belief = belief = self._empty_belief()
        self._set_up(
            belief.actions,
            RewardScale.for_camera(
                belief.rating_function.fan.max_visible_cells,
                belief.rating_function.settings.n_gray_bins,
                belief.map.grid.n_cells,
            ),
            PlanarObserver(
                belief,
                self.settings.crop_cells,
                self._candidate_mode.n_candidates if self._candidate_mode else None,
            ),
        )
        self._simulator: PlanarSimulator

    def _reset_world(self, rngs: EpisodeRngs) -> PlanarBelief:
        world = _make_world(self.scene, self._grid, rngs.scene)
        self._simulator = PlanarSimulator(world, self.settings.camera, self.settings.noise)
        self._belief.map.clear()
        starts, known = sample_start_poses(
            world,
            self._belief.lattice,
            len(self.possible_agents),
            self.settings.max_start_distance,
            self.settings.initial_free_radius,
            rngs.start,
        )
        self._belief.map.mark_free(known)
        belief = self._belief.with_poses(starts)
        self._simulator.set_poses([belief.lattice.pose(pose_id) for pose_id in starts])
        return belief

    def _move(
        self, belief: PlanarBelief, targets: Sequence[int | None], rng: np.random.Generator
    ) -> TeamMoveResult:
        lattice = belief.lattice
        moved = self._simulator.move(
            [None if target is None else lattice.pose(target) for target in targets], rng
        )
        poses, collision_cells = list(belief.pose_ids), []
        for robot, target in enumerate(targets):
            if target is not None and moved[robot].collided_with:
                collision_cells.append(target // lattice.n_headings)
            elif target is not None:
                poses[robot] = target
        collided_with = [result.collided_with for result in moved]
        return TeamMoveResult(tuple(poses), collided_with, collision_cells)

    def _fuse_scans(
        self, belief: PlanarBelief, rng: np.random.Generator
    ) -> FusedScans[PlanarBelief]:
        scans = [self._simulator.scan(robot, rng) for robot in range(len(belief.agents))]
        return FusedScans(belief, scans, belief.map.integrate(scans))

    @property
    def truth(self) -> PlanarWorld:
        """The true world, for scoring and rendering only; policies get `belief`."""
        self._require_reset()
        return self._simulator.world

    def _render_frame(self) -> NDArray[np.uint8]:
        map_, grid = self._belief.map, self._belief.map.grid
        poses = self._belief.camera_poses
        return render_team(
            self.truth.occupied,
            map_.probability,
            map_.sampled,
            np.column_stack([grid.to_cell_units(poses[:, :2]), poses[:, 2]]),
            self.settings.camera.field_of_view,
            self.settings.camera.depth_of_field / grid.resolution,
            [grid.to_cell_units(trail) for trail in self._trails],
            f"{self.scene.name}   scan {self._scans_done} of {self.max_scans} each   "
            f"observed {map_.observed_fraction:.1%}",
        )

    def _empty_belief(self) -> PlanarBelief:
        s, grid = self.settings, self._grid
        lattice = PoseLattice(grid, s.n_headings)
        return PlanarBelief(
            agents=tuple(self.possible_agents),
            map=OccupancyMap(grid, s.beam, s.log_odds_range),
            actions=self._candidate_mode or PlanarPoseMode(s.reach),
            planning=PlanarPlanning(),
            candidates=None,
            pose_ids=(0,) * len(self.possible_agents),
            rating_function=PlanarRatingFunction(s.camera, lattice, s.rating, s.log_odds_range),
            reach=s.reach,
        )


def _make_world(scene: PlanarScene, declared: VoxelGrid, rng: np.random.Generator) -> PlanarWorld:
    world = scene.world(rng)
    if not isinstance(world, PlanarWorld):
        raise ValueError(f"scene {scene.name!r} must make a PlanarWorld, not {brief(world)}")
    for name in ("shape", "resolution", "origin"):
        actual, expected = getattr(world, name), getattr(declared, name)
        if actual != expected:
            raise ValueError(
                f"scene {scene.name!r} made a world of {name} {actual}, not {expected}"
            )
    return world


class PlanarTeamEnv(TeamEnv):
    """`PlanarEnv` seen by a single agent; see `TeamEnv`."""

    metadata = PlanarEnv.metadata
    parallel_env = PlanarEnv
