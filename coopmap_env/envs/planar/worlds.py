"""Planar worlds that are stepped together: arrays of all worlds, and the compiled step."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import make_plain
from coopmap_env.core.random_streams import KEY_WORDS
from coopmap_env.envs.planar._observation_kernels import TeamObservations
from coopmap_env.envs.planar._starts import StartSettings
from coopmap_env.envs.planar._step_kernels import observe_worlds, start_worlds, step_worlds
from coopmap_env.envs.planar._world_arrays import (
    StepConstants,
    StepResults,
    StepScratch,
    WorldArrays,
)
from coopmap_env.envs.planar.observations import observation_tables
from coopmap_env.envs.planar.task import PlanarTask
from coopmap_env.envs.planar.true_worlds import TrueWorlds
from coopmap_env.envs.rewards import REWARD_TERMS, RewardScale, StepOutcome, name_terms
from coopmap_env.envs.step_data import STREAMS, EpisodeSeeds
from coopmap_env.information import PlanarRatingFunction
from coopmap_env.information.planar.view_arrays import ViewTables
from coopmap_env.mapping import OccupancyMap, ScanGain, SurfaceArrays
from coopmap_env.mapping.arrays import MapStorage
from coopmap_env.robots import PoseLattice
from coopmap_env.robots.planar.feasible_poses import PoseSampling, check_reach
from coopmap_env.robots.planar.reachable_regions import RegionArrays
from coopmap_env.sensing import Scan
from coopmap_env.simulation.planar import camera_arrays
from coopmap_env.simulation.scenes.planar import PlanarScene


class PlanarWorlds:
    """E planar worlds with a team in each.

    Parameters
    ----------
    task : PlanarTask
    scene : PlanarScene
        Makes the true worlds.
    n_worlds : int
        E.
    keep_surfaces : bool
        Whether the maps have surface Gaussians; nothing in a step depends on them, and they take
        120 bytes a cell.
    n_threads : int, optional
        Threads that step worlds at the same time; results do not depend on it.
    """

    def __init__(
        self,
        task: PlanarTask,
        scene: PlanarScene,
        n_worlds: int,
        keep_surfaces: bool,
        n_threads: int = 1,
    ) -> None:
        s, grid, n, m = task.settings, task.grid, task.n_robots, task.n_candidates
        self.task = task
        self.lattice = PoseLattice(grid, s.n_headings)
        sampling = PoseSampling(self.lattice.geometry, grid.shape_3d, float(s.reach))
        check_reach(sampling)
        self.rating_function = PlanarRatingFunction(
            s.camera, self.lattice, s.rating, s.log_odds_range
        )
        self.constants = step_constants(task, self.rating_function, sampling)
        surfaces = SurfaceArrays.empty(
            n_worlds * grid.n_cells if keep_surfaces else 0, 2, s.beam.surface_fusion == "mean"
        )
        self.truths = TrueWorlds(scene, grid, n_worlds)
        self.arrays = WorldArrays.empty(
            self.truths.occupied,
            n,
            m,
            SurfaceArrays(*(a.reshape(n_worlds, -1, *a.shape[1:]) for a in surfaces)),
            task.keeps_shown,
        )
        self.results = StepResults.empty(n_worlds, n, s.camera.n_beams)
        scratch = [StepScratch.empty(self.constants, n, m) for _ in range(n_threads)]
        self._queue = scratch[0].queue
        self._plain_arrays, self._plain_constants = (
            make_plain(self.arrays),
            make_plain(self.constants),
        )
        self._plain_results, self._plain_scratch = (
            make_plain(self.results),
            list(map(make_plain, scratch)),
        )
        self._pool = ThreadPoolExecutor(n_threads) if n_threads > 1 else None
        self._has_started = np.zeros(n_worlds, dtype=bool)

    def has_reset(self, e: int) -> bool:
        """Whether an episode has started in a world."""
        return bool(self._has_started[e])

    def start(self, worlds: NDArray[np.int64], seeds: Sequence[EpisodeSeeds]) -> None:
        """Start an episode in some worlds whose truths were drawn; see `start_worlds`."""
        arrays = self.arrays
        streams = arrays.start_streams, arrays.noise_streams, arrays.candidate_streams
        keys = EpisodeSeeds.states(seeds, STREAMS, KEY_WORDS * len(streams))
        for k, stream in enumerate(streams):
            stream[worlds, :KEY_WORDS] = keys[:, KEY_WORDS * k : KEY_WORDS * (k + 1)]
            stream[worlds, KEY_WORDS:] = 0
        self._run(start_worlds, worlds, (self._plain_arrays, self._plain_constants))
        self._has_started[worlds] = True

    def observe(self, worlds: NDArray[np.int64], observations: TeamObservations) -> None:
        """Write the first observations of some worlds; see `observe_worlds`."""
        parts = (self._plain_arrays, self._plain_constants, make_plain(observations))
        self._run(observe_worlds, worlds, parts)

    def step(
        self,
        worlds: NDArray[np.int64],
        actions: NDArray[np.float64],
        choices: NDArray[np.int64],
        observations: TeamObservations,
    ) -> None:
        """Step some worlds with valid actions of all; see `step_worlds`."""
        parts = (self._plain_arrays, self._plain_constants, self._plain_results)
        self._run(step_worlds, worlds, (actions, choices, *parts, make_plain(observations)))

    def _run(
        self, kernel: Callable[..., None], worlds: NDArray[np.int64], arguments: tuple[Any, ...]
    ) -> None:
        """Call a kernel for some worlds: a part of them in each thread, with its own scratch."""
        if self._pool is None:
            kernel(worlds, *arguments, self._plain_scratch[0])
            return
        parts = np.array_split(worlds, len(self._plain_scratch))
        futures = [
            self._pool.submit(kernel, part, *arguments, scratch)
            for part, scratch in zip(parts, self._plain_scratch, strict=True)
            if len(part)
        ]
        for future in futures:
            future.result()

    def close(self) -> None:
        """End the threads."""
        if self._pool is not None:
            self._pool.shutdown()

    def empty_observations(self) -> TeamObservations:
        """Room for the observations of all worlds."""
        side = self.task.settings.crop_cells
        return TeamObservations.empty(
            len(self._has_started), self.task.n_robots, side, self.task.n_candidates
        )

    def map(self, e: int) -> OccupancyMap:
        """The map of a world; its arrays are those of the world."""
        s, arrays = self.task.settings, self.arrays
        storage = MapStorage(
            arrays.log_odds_fixed[e],
            arrays.sampled_mask[e],
            SurfaceArrays(*(a[e] if a.size else a[0] for a in arrays.surfaces)),
        )
        return OccupancyMap(self.task.grid, s.beam, s.log_odds_range, storage)

    def regions(self, e: int) -> RegionArrays:
        """The regions that the team of a world reaches."""
        arrays = self.arrays
        return RegionArrays(arrays.labels[e], arrays.access[e], arrays.n_labels[e], self._queue)

    def outcomes(self, e: int) -> list[StepOutcome]:
        """What the last step of a world brought, for each robot."""
        r = self.results
        rated = (r.new_information, r.distance, r.motion_cost, r.rating)
        gains = map(ScanGain, r.new_cells[e].tolist(), r.entropy_reduction[e].tolist())
        free = [0.0] * self.task.n_robots
        parts = (part[e].tolist() for part in rated)
        return list(map(StepOutcome, *parts, gains, free, r.newly_shown[e].tolist()))

    def reward_terms(self, e: int) -> list[dict[str, float]]:
        """Every reward term of the last step of a world by its name, for each robot."""
        rows = self.results.reward_terms[e]
        return [name_terms(row, self.task.keeps_shown) for row in rows]

    def candidates(self, e: int) -> tuple[NDArray[np.int64], ...] | None:
        """Candidates of each robot of a world, as new arrays; None in "pose" mode."""
        if not self.task.n_candidates:
            return None
        counts = self.arrays.n_candidates[e].tolist()
        rows = self.arrays.candidates[e]
        return tuple(row[:count].copy() for row, count in zip(rows, counts, strict=True))

    def scans(self, e: int) -> list[Scan]:
        """The scans of the last step of a world, as new arrays."""
        results, poses = self.results, self.lattice.poses(self.arrays.pose_ids[e])
        parts = (results.points[e], results.covariances[e], results.hit[e])
        return [
            Scan(pose[:2].copy(), *(part[robot].copy() for part in parts))
            for robot, pose in enumerate(poses)
        ]


def step_constants(
    task: PlanarTask, rating: PlanarRatingFunction, sampling: PoseSampling
) -> StepConstants:
    """What is the same for all worlds and steps of a task."""
    s, grid, n_visible = task.settings, task.grid, rating.max_visible_cells
    return StepConstants(
        grid.geometry,
        s.log_odds_range.clamp,
        StartSettings(
            rating.lattice.n_headings,
            s.max_start_distance / grid.resolution,
            s.initial_free_radius / grid.resolution,
        ),
        sampling,
        rating.fan.arrays(grid.shape[1]),
        ViewTables.from_fan(rating.fan, rating.gray, rating.codes),
        rating.codes.of_log_odds,
        camera_arrays(s.camera, s.noise),
        s.beam.parameters,
        s.log_odds_range.entropy,
        s.log_odds_range.probability,
        (float(s.rating.K), float(s.rating.exponent)),
        (float(s.rating.alpha_position), float(s.rating.alpha_heading)),
        RewardScale.for_camera(n_visible, s.rating.n_gray_bins, grid.n_cells),
        list(REWARD_TERMS).index(task.reward),
        task.is_reward_shared,
        *observation_tables(task, rating),
        s.lattice_speeds(grid.resolution),
        float(s.scan_time),
    )
