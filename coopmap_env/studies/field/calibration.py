"""Calibration of the 3-D map, and the search for its constants on training worlds, with a record.

    python -m coopmap_env.studies.field.calibration field_sensors.json       the search
    python -m coopmap_env.studies.field.calibration field_test.json test     v0 and v1, test worlds

`FieldSettings.beam` and `octomap_comparison.TUNED_OCTOMAP` come from this search. Voxels that are
known from the start are not scored (`observed_mask`).

The objective of the beam model is the log-loss, plus what the map misses (voxels with P < 0.05,
which links move into) beyond a target: what v0 misses in the same scans, less 2.6 points. These
points can be won; the others are voxels that no beam without noise hits. Without the second term
the search takes free = 0.005 for a fiftieth less log-loss. OctoMap's constants, its clamps among
them, have the lowest log-loss alone, on the same worlds.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.files import write_atomically
from coopmap_env.core.settings import Bounds, Settings
from coopmap_env.envs.field import FieldEnv, FieldSettings
from coopmap_env.evaluation import Policy, make_policy, rollout
from coopmap_env.evaluation.metrics import (
    SurfaceConsistency,
    log_loss,
    surface_chi2,
    surface_offsets,
)
from coopmap_env.mapping import BeamModel, LogOddsRange, OccupancyMap, VoxelGrid
from coopmap_env.mapping.files.octomap import sample_octree
from coopmap_env.sensing import Scan
from coopmap_env.studies.common.coordinate_search import search_coordinates
from coopmap_env.studies.common.map_scores import (
    ScoredCells,
    calibration_scores,
    compare_cells,
    pool,
)
from coopmap_env.studies.field.octomap_comparison import (
    OctomapConstants,
    fuse_octomap,
)

SEEDS = range(730_000, 730_006)
"""Worlds of the training split, 32 scans each."""
POLICY = "rating_function:search=100"
MISSED_GAIN = 0.026
"""Of the occupied voxels, by how much fewer should have P < 0.05 than in the map of v0."""
BEAM_CHOICES = {
    "behind": (0.5, 0.8, 0.9, 0.95, 0.97),
    "posterior_cutoff": (0.9, 0.95, 0.99),
    "free": (0.003, 0.005, 0.007, 0.01, 0.02, 0.03),
    "occupied": (0.99, 0.998, 0.9995),
    "max_probability": (0.998, 0.999, 0.9995, 0.9999),
}
"""A cutoff beyond 0.99 has less log-loss still, but counts more voxels as observed that lie behind
surfaces."""
OCTOMAP_CHOICES = {
    "hit": (0.7, 0.9, 0.97, 0.99, 0.998, 0.9995, 0.9999, 0.99999, 0.999999),
    "miss": (0.005, 0.01, 0.02, 0.03, 0.05, 0.1, 0.4),
    "lowest": (0.0001, 0.0005, 0.001, 0.002, 0.005, 0.01, 0.02),
    "highest": (0.998, 0.999, 0.9995, 0.9999, 0.99999, 0.999999),
}


VERSIONS = {"v0": FieldSettings.v0(), "v1": FieldSettings()}


@dataclass(frozen=True, eq=False)
class RecordedFieldWorld:
    """The scans of an episode as they were fused, and the truth."""

    scans: tuple[tuple[Scan, ...], ...]
    """Of each step."""
    occupied: NDArray[np.bool_]
    """Shape of the grid."""
    initial_free_mask: NDArray[np.bool_]
    """Shape of the grid."""
    triangles: NDArray[np.float64]
    """True surface (m, 3, 3), metres."""
    grid: VoxelGrid

    def fuse(self, map_: OccupancyMap) -> OccupancyMap:
        """Fuse the scans into an empty map."""
        map_.mark_free(np.flatnonzero(self.initial_free_mask))
        for scans in self.scans:
            map_.integrate(scans)
        return map_

    def score(self, map_: OccupancyMap) -> ScoredCells:
        """Fuse the scans into an empty map; its voxels without the initially known ones."""
        self.fuse(map_)
        return self.cells(map_.probability, map_.sampled)

    def cells(self, probability: NDArray[np.float64], sampled: NDArray[np.bool_]) -> ScoredCells:
        """Voxels of a map for scoring, flat."""
        scored = sampled & ~self.initial_free_mask
        return ScoredCells(probability.ravel(), self.occupied.ravel(), scored.ravel())


def record_worlds(
    env: FieldEnv, policy: Policy, seeds: Sequence[int]
) -> Iterator[RecordedFieldWorld]:
    """Play an episode in each world and keep its scans, with the poses that the robots believed."""
    for seed in seeds:
        scans = [tuple(env.last_scans) for _ in rollout(env, policy, seed)]
        yield RecordedFieldWorld(
            tuple(scans),
            env.truth.occupied,
            env.diagnostics.initial_free_mask,
            env.truth.triangles,
            env.scene.grid,
        )


@dataclass(frozen=True)
class FieldConstants(Settings):
    """The start is v0."""

    behind: float = 0.5
    posterior_cutoff: float = 0.95
    free: float = 0.02
    occupied: float = 0.998
    max_probability: Annotated[float, Bounds(above=0.5, below=1)] = 0.999

    def map(self, grid: VoxelGrid) -> OccupancyMap:
        """An empty map with these constants."""
        beam = BeamModel(
            self.free,
            self.occupied,
            "partial",
            behind=self.behind,
            posterior_cutoff=self.posterior_cutoff,
        )
        return OccupancyMap(grid, beam, LogOddsRange(self.max_probability))


def score_settings(
    worlds: Sequence[RecordedFieldWorld], settings: Mapping[str, FieldSettings]
) -> dict[str, dict[str, Any]]:
    """Scores of the maps that environments with these settings make of the same scans.

    Those of `compare_cells`, and ``surface``: the `SurfaceConsistency` of voxels with P > 1/2.
    """
    pooled, surfaces = {}, {}
    for name, s in settings.items():
        cells, chi2 = [], []
        for world in worlds:
            map_ = world.fuse(OccupancyMap(world.grid, s.beam, s.log_odds_range))
            cells.append(world.cells(map_.probability, map_.sampled))
            chi2.append(_surface_chi2(world, map_))
        pooled[name] = pool(cells)
        surfaces[name] = asdict(SurfaceConsistency.from_chi2(np.concatenate(chi2)))
    scores = compare_cells(pooled)
    return {name: {**scores[name], "surface": surfaces[name]} for name in settings}


def _surface_chi2(world: RecordedFieldWorld, map_: OccupancyMap) -> NDArray[np.float64]:
    cells, means, covariances = map_.surfaces()
    likely = map_.log_odds_fixed[cells] > 0
    offsets = surface_offsets(means[likely], world.triangles, world.grid)
    return surface_chi2(offsets, covariances[likely])


def tune_beam_model(worlds: Sequence[RecordedFieldWorld]) -> dict[str, Any]:
    """The best `FieldConstants`, and all that were tried, as JSON values."""

    def scores(constants: FieldConstants) -> dict[str, Any]:
        return calibration_scores(pool(world.score(constants.map(world.grid)) for world in worlds))

    allowed = scores(FieldConstants())["missed"] - MISSED_GAIN

    def loss(constants: FieldConstants) -> float:
        scored = scores(constants)
        return float(scored["log_loss"]) + max(0.0, scored["missed"] - allowed)

    return asdict(search_coordinates(FieldConstants(), BEAM_CHOICES, loss))


def tune_octomap(worlds: Sequence[RecordedFieldWorld]) -> dict[str, Any]:
    """The best constants of OctoMap, its clamps among them, and all that were tried."""
    counts = [
        [octomap_counts(scan, world.grid) for step in world.scans for scan in step]
        for world in worlds
    ]

    def loss(constants: OctomapConstants) -> float:
        maps = [
            (world, *apply_octomap_rule(updates, world.grid, constants))
            for world, updates in zip(worlds, counts, strict=True)
        ]
        return log_loss(*pool(world.cells(p, sampled) for world, p, sampled in maps))

    start = replace(OctomapConstants(), lowest=0.001, highest=0.999)
    return asdict(search_coordinates(start, OCTOMAP_CHOICES, loss))


class OctomapCounts(NamedTuple):
    """What OctoMap does with one scan: its hits and misses of each voxel that it updates."""

    cells: NDArray[np.int64]
    """Flat indices."""
    hits: NDArray[np.int64]
    misses: NDArray[np.int64]


def octomap_counts(scan: Scan, grid: VoxelGrid) -> OctomapCounts:
    """Hits and misses of a scan, read from OctoMap's own tree of that scan alone.

    A hit adds 1 there and a miss takes 1/64 away. To insert the scans again for each choice of the
    constants would take a minute a choice.
    """
    marked = OctomapConstants(1 / (1 + math.exp(-1)), 1 / (1 + math.exp(1 / 64)), 1e-6, 1 - 1e-6)
    tree, _ = fuse_octomap([scan], grid, marked)
    log_odds, known = sample_octree(tree, grid)
    cells = np.flatnonzero(known)
    sums = log_odds.ravel()[cells]
    hits = np.ceil(sums - 1e-4).astype(np.int64)
    return OctomapCounts(cells, hits, np.rint((hits - sums) * 64).astype(np.int64))


def apply_octomap_rule(
    updates: Sequence[OctomapCounts], grid: VoxelGrid, constants: OctomapConstants
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Probabilities and sampled voxels after some scans by OctoMap's rule, shape of the grid."""
    p = np.array([constants.hit, constants.miss, constants.lowest, constants.highest])
    hit, miss, lowest, highest = np.log(p / (1 - p))
    log_odds, sampled = np.zeros(grid.n_cells), np.zeros(grid.n_cells, dtype=np.bool_)
    for cells, hits, misses in updates:
        changed = log_odds[cells] + hit * hits + miss * misses
        log_odds[cells] = np.clip(changed, lowest, highest)
        sampled[cells] = True
    return (1 / (1 + np.exp(-log_odds))).reshape(grid.shape), sampled.reshape(grid.shape)


def main(path: Path, seeds: Sequence[int] = SEEDS, max_scans: int = 16) -> None:
    """Record the scans, search, and write the record as JSON."""
    env = FieldEnv(split="train", max_scans=max_scans)
    try:
        worlds = list(record_worlds(env, make_policy(POLICY), seeds))
    finally:
        env.close()
    record = {
        "split": "train",
        "seeds": [min(seeds), max(seeds)],
        "policy": POLICY,
        "scans": sum(len(step) for world in worlds for step in world.scans),
        "gaussian_beam": tune_beam_model(worlds),
        "octomap": tune_octomap(worlds),
        "scores": score_settings(worlds, VERSIONS),
    }
    write_atomically(path, json.dumps(record, indent=1) + "\n")


def score_test_worlds(path: Path, n_worlds: int = 100, max_scans: int = 16) -> None:
    """Write the scores of v0 and v1 on test worlds, each world and all of them, as JSON."""
    env = FieldEnv(split="test", max_scans=max_scans)
    try:
        worlds = list(record_worlds(env, make_policy(POLICY), range(n_worlds)))
    finally:
        env.close()
    record = {
        "split": "test",
        "worlds": [score_settings([world], VERSIONS) for world in worlds],
        "all": score_settings(worlds, VERSIONS),
    }
    write_atomically(path, json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    (score_test_worlds if sys.argv[2:] == ["test"] else main)(Path(sys.argv[1]))
