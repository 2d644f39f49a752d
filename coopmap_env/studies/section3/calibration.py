"""Calibration of the map: Brier score, log-loss and reliability against the truth.

The scans of whole episodes are fused by the Gaussian beam model and by a constant hit/miss model.
Each map is scored on the cells that it sampled, and both on those that both sampled. The constants
of both models were tuned by `sensor_tuning` on training worlds, those of v0's beam were not;
reports use test worlds.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.envs.planar import PlanarEnv
from coopmap_env.evaluation import Policy, rollout
from coopmap_env.evaluation.metrics import (
    SurfaceConsistency,
    cell_face_offsets,
    surface_chi2,
)
from coopmap_env.mapping import OccupancyMap, VoxelGrid
from coopmap_env.sensing import Scan
from coopmap_env.simulation import PlanarSimulator
from coopmap_env.studies.common.hit_miss import HitMissMap
from coopmap_env.studies.common.map_scores import (
    MapModel,
    ScoredCells,
    compare_cells,
    pool,
    reliability_intervals,
)

NOISE_SPAWN_KEY = 0x5CA9
"""Spawn key of the noise of these scans, which is independent of the episode's own."""


@dataclass(frozen=True)
class RecordedWorld:
    """Scans that a policy took in one world, and the truth."""

    scans: tuple[Scan, ...]
    occupied: NDArray[np.bool_]


def record_scans(env: PlanarEnv, policy: Policy, seeds: Sequence[int]) -> Iterator[RecordedWorld]:
    """Play an episode in each world and take new scans from all visited poses.

    Parameters
    ----------
    env : PlanarEnv
    policy : Policy
    seeds : sequence of int
        One for each world.

    Yields
    ------
    RecordedWorld
        For each seed.
    """
    for seed in seeds:
        steps = rollout(env, policy, seed)
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(NOISE_SPAWN_KEY,)))
        simulator = PlanarSimulator(env.truth, env.settings.camera, env.settings.noise)
        scans: list[Scan] = []
        for _ in steps:
            scans += [simulator.scan_from(pose, rng) for pose in env.belief().camera_poses]
        yield RecordedWorld(tuple(scans), env.truth.occupied)


def fuse_scans(world: RecordedWorld, map_: OccupancyMap | HitMissMap) -> ScoredCells:
    """Fuse the scans of a world into an empty map; return its cells."""
    for scan in world.scans:
        map_.integrate(scan)
    return ScoredCells(map_.probability.ravel(), world.occupied.ravel(), map_.sampled.ravel())


def pool_cells(worlds: Sequence[RecordedWorld], grid: VoxelGrid, model: MapModel) -> ScoredCells:
    """All cells of all worlds, each fused with the same model."""
    return pool(fuse_scans(world, model.map(grid)) for world in worlds)


def compare_models(
    worlds: Sequence[RecordedWorld], grid: VoxelGrid, models: Mapping[str, MapModel]
) -> dict[str, dict[str, Any]]:
    """`compare_cells` of the maps of each model, with `reliability_intervals` of several worlds."""
    cells = {
        name: [fuse_scans(world, model.map(grid)) for world in worlds]
        for name, model in models.items()
    }
    scores = compare_cells({name: pool(parts) for name, parts in cells.items()})
    if len(worlds) > 1:
        for name, parts in cells.items():
            scores[name]["reliability"] |= reliability_intervals(parts)
    return scores


def surface_consistency(
    worlds: Sequence[RecordedWorld], grid: VoxelGrid, model: MapModel
) -> dict[str, Any]:
    """`SurfaceConsistency` of surfaces in cells with P > 1/2, over all worlds, as JSON values."""
    chi2 = []
    for world in worlds:
        map_ = model.map(grid)
        assert isinstance(map_, OccupancyMap)
        for scan in world.scans:
            map_.integrate(scan)
        cells, means, covariances = map_.surfaces()
        likely = map_.log_odds_fixed[cells] > 0
        offsets = cell_face_offsets(means[likely], world.occupied, grid)
        chi2.append(surface_chi2(offsets, covariances[likely]))
    return asdict(SurfaceConsistency.from_chi2(np.concatenate(chi2)))
