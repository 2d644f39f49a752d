"""The planar environment: its parts, put together."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.choices import check_keywords
from coopmap_env.envs.actions import CandidateMode
from coopmap_env.envs.belief import Observation
from coopmap_env.envs.mapping_env import MappingEnv
from coopmap_env.envs.planar._observation_kernels import TeamObservations
from coopmap_env.envs.planar.actions import PlanarPoseMode
from coopmap_env.envs.planar.arguments import PlanarArguments
from coopmap_env.envs.planar.belief import PlanarBelief
from coopmap_env.envs.planar.observations import PlanarObserver
from coopmap_env.envs.planar.planning import PlanarPlanning
from coopmap_env.envs.planar.settings import PlanarSettings
from coopmap_env.envs.planar.worlds import PlanarWorlds
from coopmap_env.envs.reasons import RejectedReason
from coopmap_env.envs.step_data import EpisodeSeeds, TeamStep
from coopmap_env.envs.team import TeamEnv
from coopmap_env.mapping import VoxelGrid
from coopmap_env.rendering import render_team
from coopmap_env.sensing import Scan
from coopmap_env.simulation.scenes.planar import PlanarWorld, make_planar_scene

ONE_WORLD = np.zeros(1, dtype=np.int64)
OBSTACLE = "an obstacle in a cell that is mapped as free"
VIEWS_PER_WINDOW = 3
"""Depths of field along the smallest window in which pictures show the explored part of a map."""
NO_POSES = np.empty((1, 0, 3))
NO_CHOICES = np.empty((1, 0), dtype=np.int64)


class PlanarEnv(MappingEnv[PlanarBelief]):
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

    _actions: PlanarPoseMode | CandidateMode
    _observer: PlanarObserver

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        check_keywords("planar_v1", kwargs, PlanarArguments)
        arguments = PlanarArguments(*args, **kwargs)
        super().__init__(arguments)
        self.scene = scene = make_planar_scene(arguments.scene)
        grid = VoxelGrid(scene.shape, scene.resolution, scene.origin)
        self.settings = arguments.settings or PlanarSettings.for_resolution(scene.resolution)
        self.task = arguments.task(grid, self.settings)
        self._planning = PlanarPlanning()
        self._set_up(
            self._candidate_mode or PlanarPoseMode(self.settings.reach), PlanarObserver(self.task)
        )
        self._attach(self._make_worlds(), 0)

    def _make_worlds(self) -> PlanarWorlds:
        return PlanarWorlds(self.task, self.scene, 1, keep_surfaces=True)

    def _attach(self, worlds: PlanarWorlds, index: int) -> None:
        """Be the environment of one of these worlds."""
        self._worlds, self._index = worlds, index
        self._map, self._regions = worlds.map(index), worlds.regions(index)

    def _start(self, seeds: EpisodeSeeds) -> tuple[PlanarBelief, list[Observation]]:
        self._worlds.truths.draw([0], [seeds])
        observations = self._worlds.empty_observations()
        self._worlds.start(ONE_WORLD, [seeds])
        self._worlds.observe(ONE_WORLD, observations)
        return self._current_belief(), self._observations_of_robots(observations)

    def _advance(self, actions: dict[str, Any]) -> TeamStep[PlanarBelief]:
        worlds = self._worlds
        parsed = [self._actions.parse(agent, action) for agent, action in actions.items()]
        observations = worlds.empty_observations()
        if worlds.task.n_candidates:
            worlds.step(ONE_WORLD, NO_POSES, np.array([parsed]), observations)
        else:
            worlds.step(ONE_WORLD, np.array([parsed]), NO_CHOICES, observations)
        return TeamStep(
            self._current_belief(),
            worlds.outcomes(0),
            worlds.reward_terms(0),
            worlds.results.collided[0].tolist(),
            worlds.results.rejections[0].tolist(),
            self._observations_of_robots(observations),
        )

    def _current_belief(self) -> PlanarBelief:
        worlds, index = self._worlds, self._index
        return PlanarBelief(
            agents=tuple(self.possible_agents),
            map=self._map,
            actions=self._actions,
            planning=self._planning,
            candidates=worlds.candidates(index),
            budget=self._budget,
            scan_time=float(self.settings.scan_time),
            pose_ids=tuple(worlds.arrays.pose_ids[index].tolist()),
            rating_function=worlds.rating_function,
            reach=self.settings.reach,
            speeds=worlds.constants.speeds,
            known_regions=self._regions,
        )

    def _observations_of_robots(self, observations: TeamObservations) -> list[Observation]:
        parts = self._observer.name_parts(observations)
        return [
            {name: part[0, robot] for name, part in parts.items()}
            for robot in range(len(self.possible_agents))
        ]

    @property
    def _scans_done(self) -> int:
        return int(self._worlds.arrays.n_scans[self._index])

    @property
    def _elapsed_time(self) -> float:
        return float(self._worlds.arrays.elapsed[self._index])

    @property
    def last_scans(self) -> list[Scan]:
        """Scans of the last step, as they were fused."""
        return self._worlds.scans(self._index) if self._scans_done else []

    def _common_info(self) -> dict[str, Any]:
        observed = int(self._worlds.arrays.n_observed[self._index]) / self._map.grid.n_cells
        return {
            "n_scans": self._scans_done,
            "elapsed_time": self._elapsed_time,
            "observed_fraction": observed,
            **self._shown_info(),
        }

    def _shown_mask(self) -> NDArray[np.bool_]:
        return self._worlds.arrays.shown_mask[self._index].astype(np.bool_)

    def _shown_info(self) -> dict[str, float]:
        if not self.reports_shown:
            return {}
        n_shown = int(self._worlds.arrays.n_shown[self._index])
        return {"shown_fraction": n_shown / self._map.grid.n_cells}

    def _explain(self, robot: int) -> dict[str, str]:
        if not self._scans_done:
            return {}
        results, at = self._worlds.results, (self._index, robot)
        return {
            "rejected_reason": RejectedReason(results.rejections[at]).words,
            "collided": OBSTACLE if results.collided[at] else "",
        }

    @property
    def truth(self) -> PlanarWorld:
        """The true world, for scoring and rendering only; policies get `belief`."""
        self._require_reset()
        return self._worlds.truths.world(self._index)

    def _render_frame(self) -> NDArray[np.uint8]:
        belief = self.belief()
        map_, grid, poses = belief.map, belief.map.grid, belief.camera_poses
        depth_of_field = self.settings.camera.depth_of_field / grid.resolution
        return render_team(
            self.truth.occupied,
            map_.probability,
            map_.sampled,
            np.column_stack([grid.to_cell_units(poses[:, :2]), poses[:, 2]]),
            self.settings.camera.field_of_view,
            depth_of_field,
            [grid.to_cell_units(np.reshape(trail, (-1, 2))) for trail in self._trails],
            f"{self.scene.name}   scan {self._scans_done} of {self.max_scans} each   "
            f"observed {map_.observed_fraction:.1%}",
            VIEWS_PER_WINDOW * depth_of_field,
        )


class PlanarWorldView(PlanarEnv):
    """One of many planar worlds, to look at: its belief, truth, scans and picture.

    It shows the world as it is now. The robots' trails are not kept.

    Parameters
    ----------
    env : PlanarEnv
        An environment with the arguments of the worlds.
    worlds : PlanarWorlds
    index : int
        Which one.
    """

    def __init__(self, env: PlanarEnv, worlds: PlanarWorlds, index: int) -> None:
        own = dict(env.__dict__)
        self._limits = own.pop("max_scans"), own.pop("max_time")
        self.__dict__.update(own)
        self._attach(worlds, index)
        self._trails = [[] for _ in self.possible_agents]

    def __reduce__(self) -> Any:
        """Raise TypeError: a view has no world of its own."""
        raise TypeError("a view of a world cannot be copied or pickled; its belief's map can")

    def belief(self) -> PlanarBelief:
        """See `MappingEnv.belief`."""
        self._require_reset()
        return self._current_belief()

    # What changes from step to step is that of the worlds; what the engine goes by cannot be set.
    @property
    def _has_reset(self) -> bool:  # type: ignore[override]
        return self._worlds.has_reset(self._index)

    @property
    def max_scans(self) -> int:  # type: ignore[override]
        """Scans of each robot in an episode."""
        return self._limits[0]

    @property
    def max_time(self) -> float | None:  # type: ignore[override]
        """Seconds until truncation."""
        return self._limits[1]

    @property
    def agents(self) -> list[str]:  # type: ignore[override]
        """Robots that act in the next step: none before a reset and after an end."""
        is_running = self._has_reset and not self._has_ended
        return list(self.possible_agents) if is_running else []

    def reset(self, *args: Any, **kwargs: Any) -> Any:
        """Raise RuntimeError: the vector environment resets its worlds."""
        raise RuntimeError("this is a view of a world: reset the vector environment")

    def step(self, *args: Any, **kwargs: Any) -> Any:
        """Raise RuntimeError: the vector environment steps its worlds."""
        raise RuntimeError("this is a view of a world: step the vector environment")


class PlanarTeamEnv(TeamEnv):
    """`PlanarEnv` seen by a single agent; see `TeamEnv`."""

    metadata = PlanarEnv.metadata
    parallel_env = PlanarEnv
