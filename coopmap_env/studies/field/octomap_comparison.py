"""The same scans fused by OctoMap and by `OccupancyMap`: log-loss, errors of each kind, and time.

OctoMap (Hornung et al. 2013, extra ``octomap``) updates each voxel once per scan by one of two
constants and clamps the sum. It does not model the uncertainty of the range. Two sets of constants
are compared: its defaults, which are made for quick change, and constants tuned for the log-loss,
clamps among them, on the same scans of six training worlds as those of `OccupancyMap`
(`studies.field.calibration`), for which what the map misses counted too. The second is the
opponent; the first shows what the defaults are for. Scores are over the voxels that all maps
sampled. The times are process times of one `insertPointCloud` and of one `OccupancyMap.integrate`
call, medians over the scans.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.extras import import_optional
from coopmap_env.core.settings import OpenUnitInterval, Settings
from coopmap_env.evaluation.metrics import log_loss
from coopmap_env.mapping import (
    FREE_PROBABILITY,
    BeamModel,
    LogOddsRange,
    OccupancyMap,
    VoxelGrid,
)
from coopmap_env.mapping.files.octomap import octomap_shift, sample_octree
from coopmap_env.sensing import Scan
from coopmap_env.studies.common.map_scores import fraction

FREE_BEAM_EXTENSION = 2.0
"""Metres by which beams without return are lengthened. OctoMap enters a point as a surface unless
it lies beyond the maximum range; then the beam is free up to that range."""


@dataclass(frozen=True)
class OctomapConstants(Settings):
    """The constants of OctoMap's update; the defaults are OctoMap's own."""

    hit: OpenUnitInterval = 0.7
    """Occupancy that one scan gives to a voxel in which a beam ends."""
    miss: OpenUnitInterval = 0.4
    """Occupancy that one scan gives to a voxel that beams only cross."""
    lowest: OpenUnitInterval = 0.12
    """Lowest P of a voxel."""
    highest: OpenUnitInterval = 0.97
    """Highest P of a voxel."""


DEFAULT_OCTOMAP = OctomapConstants()
TUNED_OCTOMAP = OctomapConstants(0.9999, 0.02, 0.005, 0.9999)
"""The lowest log-loss on the scans of six training worlds, by `studies.field.calibration`."""


@dataclass(frozen=True)
class MapScores:
    """Scores of one of the maps."""

    cells: int
    """Voxels that it sampled."""
    log_loss: float
    """Nats, over the voxels that all maps sampled."""
    log_loss_free: float
    """Nats, over those of them that are truly free."""
    log_loss_occupied: float
    """Nats, over those of them that are truly occupied."""
    missed: float
    """Fraction of the truly occupied ones with P < 0.05, which a mount would enter."""
    not_cleared: float
    """Fraction of the truly free ones with P >= 0.05, which a mount avoids."""
    accuracy: float
    """Fraction whose state it predicts right (occupied if P >= 1/2)."""
    milliseconds: float
    """Median time to fuse a scan."""


@dataclass(frozen=True)
class OctomapComparison:
    """Maps of the same scans, compared with the truth and with each other."""

    n_scans: int
    common_cells: int
    """Voxels that all maps sampled."""
    agreement: float
    """Fraction of these that ours and the tuned one predict occupied (P >= 1/2), or both free."""
    ours: MapScores
    tuned: MapScores
    """OctoMap with constants tuned on training worlds."""
    default: MapScores
    """OctoMap with its own constants."""

    def as_dict(self) -> dict[str, Any]:
        """JSON values."""
        return asdict(self)


@dataclass(frozen=True, eq=False)
class FusedMap:
    """What a map says after all scans."""

    probability: NDArray[np.float64]
    """Shape of the grid."""
    sampled: NDArray[np.bool_]
    """Shape of the grid."""
    seconds: float
    """Median time to fuse a scan."""

    def scores(self, occupied: NDArray[np.bool_], common: NDArray[np.bool_]) -> MapScores:
        """Scores over the common voxels, against the truth."""
        p = self.probability
        return MapScores(
            cells=int(self.sampled.sum()),
            log_loss=log_loss(p, occupied, common),
            log_loss_free=log_loss(p, occupied, common & ~occupied),
            log_loss_occupied=log_loss(p, occupied, common & occupied),
            missed=fraction(p[common & occupied] < FREE_PROBABILITY),
            not_cleared=fraction(p[common & ~occupied] >= FREE_PROBABILITY),
            accuracy=fraction(((p >= 0.5) == occupied)[common]),
            milliseconds=1e3 * self.seconds,
        )


def compare_with_octomap(
    scans: Sequence[Scan],
    occupied: ArrayLike,
    grid: VoxelGrid,
    model: BeamModel | None = None,
    log_odds_range: LogOddsRange | None = None,
) -> OctomapComparison:
    """Fuse scans one after the other into each map, and score all.

    Parameters
    ----------
    scans : sequence of Scan
        3-D, at least one.
    occupied : array_like of bool, shape of the grid
        The truth.
    grid : VoxelGrid
    model : BeamModel, optional
        Sensor model of the `OccupancyMap`.
    log_odds_range : LogOddsRange, optional
        Clamp of the `OccupancyMap`.

    Raises
    ------
    ValueError
        If there is no scan, the truth is not of the grid's shape, or the grid is not 3-D.
    ImportError
        With the pip command, if OctoMap's library is not installed.
    """
    truth = np.asarray(occupied, dtype=np.bool_)
    if not scans or grid.dimension != 3 or truth.shape != grid.shape:
        raise ValueError(
            f"expected scans, a 3-D grid and its truth, got {len(scans)} scans, {grid.shape}, "
            f"{truth.shape}"
        )
    ours = fuse_coopmap(scans, grid, model, log_odds_range)
    tuned, default = (
        read_octomap(*fuse_octomap(scans, grid, constants), grid)
        for constants in (TUNED_OCTOMAP, DEFAULT_OCTOMAP)
    )
    common = ours.sampled & tuned.sampled & default.sampled
    agrees = ((ours.probability >= 0.5) == (tuned.probability >= 0.5))[common]
    return OctomapComparison(
        n_scans=len(scans),
        common_cells=int(common.sum()),
        agreement=fraction(agrees),
        ours=ours.scores(truth, common),
        tuned=tuned.scores(truth, common),
        default=default.scores(truth, common),
    )


def fuse_coopmap(
    scans: Sequence[Scan],
    grid: VoxelGrid,
    model: BeamModel | None = None,
    log_odds_range: LogOddsRange | None = None,
) -> FusedMap:
    """The `OccupancyMap` of the scans."""
    map_ = OccupancyMap(grid, model, log_odds_range)
    map_.integrate(scans[0])  # compiles
    map_.clear()
    seconds = []
    for scan in scans:
        start = time.process_time()
        map_.integrate(scan)
        seconds.append(time.process_time() - start)
    return FusedMap(map_.probability, map_.sampled, float(np.median(seconds)))


def fuse_octomap(
    scans: Sequence[Scan], grid: VoxelGrid, constants: OctomapConstants = DEFAULT_OCTOMAP
) -> tuple[Any, float]:
    """OctoMap's tree of the scans, in the coordinates of `to_octree`, and the median time, seconds.

    The maximum range is an argument of a whole call. Therefore beams without return that end
    before the longest one (at the body of a robot, for instance) take one call for each length, in
    steps of a voxel.
    """
    tree = import_optional("pyoctomap", "octomap").OcTree(grid.resolution)
    tree.setProbHit(constants.hit)
    tree.setProbMiss(constants.miss)
    tree.setClampingThresMin(constants.lowest)
    tree.setClampingThresMax(constants.highest)
    shift = octomap_shift(grid)
    seconds = []
    for scan in scans:
        batches = [
            (points - shift, max_range)
            for points, max_range in _insertion_batches(scan, grid.resolution)
        ]
        start = time.process_time()
        for points, max_range in batches:
            tree.insertPointCloud(points, scan.origin - shift, max_range=max_range)
        seconds.append(time.process_time() - start)
    return tree, float(np.median(seconds))


def read_octomap(tree: Any, seconds: float, grid: VoxelGrid) -> FusedMap:
    """OctoMap's tree, sampled at the voxels of a grid."""
    log_odds, known = sample_octree(tree, grid)
    return FusedMap(1.0 / (1.0 + np.exp(-log_odds)), known, seconds)


def _insertion_batches(scan: Scan, resolution: float) -> list[tuple[NDArray[np.float64], float]]:
    """Points and maximum range of each call: hits and the longest free beams, then shorter ones."""
    rays = scan.points - scan.origin
    lengths = np.linalg.norm(rays, axis=1)
    beams = lengths > 0
    free = beams & ~scan.hit
    if not free.any():
        return [(scan.points[beams], -1.0)]
    max_range = float(lengths[free].max())
    steps = np.floor((max_range - lengths) / resolution).astype(np.int64)
    extended_points = scan.points.copy()
    extended_points[free] += rays[free] / lengths[free, None] * (max_range + FREE_BEAM_EXTENSION)
    first = (beams & scan.hit) | (free & (steps == 0))
    batches = [(extended_points[first], max_range)]
    for step in np.unique(steps[free & (steps > 0)]):
        group = free & (steps == step)
        batches.append((extended_points[group], float(lengths[group].min())))
    return batches
