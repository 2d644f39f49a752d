"""The same scans fused by OctoMap and by `OccupancyMap`: agreement, log-loss and time.

OctoMap (Hornung et al. 2013, extra ``octomap``) updates each voxel once per scan by one of two
constants, hit 0.7 and miss 0.4, and clamps at 0.12 and 0.97; these are its defaults. It does not
model the uncertainty of the range. The times are process times of one `insertPointCloud` and of one
`OccupancyMap.integrate` call, medians over the scans.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.extras import import_optional
from coopmap_env.evaluation.metrics import log_loss
from coopmap_env.mapping import BeamModel, LogOddsRange, OccupancyMap, VoxelGrid
from coopmap_env.mapping.files.octomap import octomap_shift, sample_octree
from coopmap_env.sensing import Scan

FREE_BEAM_EXTENSION = 2.0
"""Metres by which beams without return are lengthened. OctoMap enters a point as a surface unless
it lies beyond the maximum range; then the beam is free up to that range."""


@dataclass(frozen=True)
class MapScores:
    """Scores of one of the two maps."""

    cells: int
    """Voxels that it sampled."""
    log_loss: float
    """Nats, over these voxels."""
    log_loss_common: float
    """Nats, over the voxels that both maps sampled."""
    accuracy: float
    """Fraction of the common voxels whose state it predicts right (occupied if P >= 1/2)."""
    milliseconds: float
    """Median time to fuse a scan."""


@dataclass(frozen=True)
class OctomapComparison:
    """Both maps of the same scans, compared with the truth and with each other."""

    n_scans: int
    common_cells: int
    """Voxels that both maps sampled."""
    agreement: float
    """Fraction of these that both maps predict occupied (P >= 1/2), or both free."""
    ours: MapScores
    octomap: MapScores

    def as_dict(self) -> dict[str, Any]:
        """JSON values."""
        return asdict(self)


def compare_with_octomap(
    scans: Sequence[Scan],
    occupied: ArrayLike,
    grid: VoxelGrid,
    model: BeamModel | None = None,
    log_odds_range: LogOddsRange | None = None,
) -> OctomapComparison:
    """Fuse scans one after the other into both maps, and score both.

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
    map_, coopmap_seconds = fuse_coopmap(scans, grid, model, log_odds_range)
    tree, octomap_seconds = fuse_octomap(scans, grid)
    log_odds, known = sample_octree(tree, grid)
    octomap_probability = 1.0 / (1.0 + np.exp(-log_odds))
    common = map_.sampled & known

    def map_scores(p: NDArray[np.float64], cells: NDArray[np.bool_], seconds: float) -> MapScores:
        is_right = ((p >= 0.5) == truth)[common]
        return MapScores(
            int(cells.sum()), log_loss(p, truth, cells), log_loss(p, truth, common),
            float(is_right.mean()) if len(is_right) else float("nan"), 1e3 * seconds,
        )  # fmt: skip

    agrees = ((map_.probability >= 0.5) == (octomap_probability >= 0.5))[common]
    return OctomapComparison(
        n_scans=len(scans),
        common_cells=int(common.sum()),
        agreement=float(agrees.mean()) if len(agrees) else float("nan"),
        ours=map_scores(map_.probability, map_.sampled, coopmap_seconds),
        octomap=map_scores(octomap_probability, known, octomap_seconds),
    )


def fuse_coopmap(
    scans: Sequence[Scan],
    grid: VoxelGrid,
    model: BeamModel | None = None,
    log_odds_range: LogOddsRange | None = None,
) -> tuple[OccupancyMap, float]:
    """The `OccupancyMap` of the scans, and the median time of one scan, seconds."""
    map_ = OccupancyMap(grid, model, log_odds_range)
    map_.integrate(scans[0])  # compiles
    map_.clear()
    seconds = []
    for scan in scans:
        start = time.process_time()
        map_.integrate(scan)
        seconds.append(time.process_time() - start)
    return map_, float(np.median(seconds))


def fuse_octomap(scans: Sequence[Scan], grid: VoxelGrid) -> tuple[Any, float]:
    """OctoMap's tree of the scans, in the coordinates of `to_octree`, and the median time, seconds.

    The maximum range is an argument of a whole call. Therefore beams without return that end
    before the longest one (at the body of a robot, for instance) take one call for each length, in
    steps of a voxel.
    """
    tree = import_optional("pyoctomap", "octomap").OcTree(grid.resolution)
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
