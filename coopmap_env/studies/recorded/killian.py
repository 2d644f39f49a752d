"""Real laser scans: MIT Killian Court, fused into one map and scored on held-out scans.

The log covers MIT Killian Court and the corridors around it: 3,873 scans of 180 beams along 2 km of
corridors, with loops of 200 m. It comes with the extra ``data``. Its poses need no optimisation:
they equal the vertices of the log's pose graph, loop closures included. Gauss-Newton on that graph
moves them by 3 mm (median) and reduces its error from 1034 to 1032, and the held-out loss does not
improve.

Every tenth scan is held out of the map. A held-out beam that returned after z metres (within the
usable range) observes cells: each cell that it left at least one cell length before z is free, and
the cell that contains z is occupied. The cells between are ignored, because an error of centimetres
may exchange them. A map is scored by the binary log-loss of these observations, over the cells that
both maps sampled. The constants of both maps come from `killian_tuning`, which uses the other
nine tenths only. It minimises the loss over all observations, of which one in twenty is of an
occupied cell.

An observation is not the state of a cell: beams pass beside the walls in their cells, and people
walk. So no map reaches zero. Cells are four times as large as the noise here. Therefore the width
of the Gaussian hardly matters (0.02 m and 0.1 m score alike). What matters is how a beam updates
cells that it crosses in part. With surfaces "anywhere", beams that pass beside a wall are added to
those that end at it, and the beam model scores worse than the constant one (0.103 to 0.093).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.extras import import_optional
from coopmap_env.core.progress import progress_bar
from coopmap_env.evaluation.metrics import binary_log_loss
from coopmap_env.geometry import traverse
from coopmap_env.mapping import BeamModel, LogOddsRange, OccupancyMap, VoxelGrid
from coopmap_env.sensing import RangeNoise, Scan
from coopmap_env.studies.common.hit_miss import HitMissMap, HitMissModel
from coopmap_env.studies.recorded.laser_log import LaserLog, read_laser_log

RESOLUTION = 0.2
"""Metres: a corridor is ten cells wide, and the court has 2.6 million cells."""
USABLE_RANGE = 30.0
"""Metres: longer readings and beams without return are skipped instead of counted as free space.
Many beams between neighbours that measure a wall at 2 m have no return; freeing the first 15 m
along them made the validation scans less likely under both maps. Walls beyond 30 m hardly change
the loss (0.1 %: better for the beam model, worse for the constants), as an error of the heading
moves them by a cell."""
NOISE = RangeNoise(intrinsic=0.05, lateral=1.0, exponent=0)
"""Noise of the laser (ranges are multiples of 5 cm or finer) and of the poses (median residual of a
loop closure 1 cm, 95 % below 5 cm) together, equal in all directions."""
BEAM_MODEL = BeamModel(free=0.2, occupied=0.63, surface="partial")
BEAM_LOG_ODDS_RANGE = LogOddsRange(0.99)
HIT_MISS_MODEL = HitMissModel(hit=0.63, miss=0.35, hit_offset=0)
HIT_MISS_LOG_ODDS_RANGE = LogOddsRange(0.985)
"""Models and clamps: the best of `killian_tuning` (500 and 196 choices, seven minutes), with
losses of 0.0923 and 0.0948 on the validation scans."""
HELD_OUT_EVERY = 10
"""Every tenth scan is held out of the map."""
VALIDATION_EVERY = 9
"""Every ninth of the others is held out for validation while tuning."""


@dataclass(frozen=True, eq=False)
class CellObservations:
    """Observations of cells by the beams of scans, one entry per beam and cell."""

    cells: NDArray[np.int64]
    """Shape (n,): flat cell indices."""
    occupied: NDArray[np.bool_]
    """Shape (n,): whether the beam ended there."""


@dataclass(frozen=True, eq=False)
class KillianResult:
    """The map of the fused scans, and how well it predicts the held-out scans."""

    probability: NDArray[np.float64]
    """P(occupied), shape of the grid."""
    sampled: NDArray[np.bool_]
    """Cells that at least one scan observed, shape of the grid."""
    resolution: float
    """Metres."""
    extent: tuple[float, float, float, float]
    """Of the grid: minimum and maximum x, minimum and maximum y, metres."""
    scores: dict[str, Any]
    """JSON values: counts of scans and observations, and per map (``gaussian_beam``, ``hit_miss``)
    the mean held-out log-loss in nats over ``all`` observations, those of ``free`` and those of
    occupied cells (``hit``), and the mean of these two (``balanced``)."""


def run_killian(stride: int = 1, progress: bool = False) -> KillianResult:
    """Fuse nine tenths of the scans and score the map on the held-out tenth.

    Parameters
    ----------
    stride : int
        Use every `stride`-th scan; 6 is quick and leaves no gap in a corridor. The constants are
        tuned for stride 1: scores of another stride do not compare the maps fairly.
    progress : bool
        Show a progress bar.

    Raises
    ------
    ImportError
        With the pip command, if ``rtb-data`` is not installed.
    ValueError
        If `stride` is below 1 or leaves fewer than ten scans; `LaserLogError` if the data are bad.
    """
    if stride < 1:
        raise ValueError(f"stride must be at least 1, got {stride}")
    log = read_killian()
    grid = grid_for_log(log)
    fused, held_out = hold_out(range(0, len(log.ranges), stride), HELD_OUT_EVERY)
    if len(held_out) == 0:
        raise ValueError(f"stride {stride} leaves fewer than {HELD_OUT_EVERY} scans")
    beam_map = OccupancyMap(grid, BEAM_MODEL, BEAM_LOG_ODDS_RANGE)
    hit_miss_map = HitMissMap(grid, HIT_MISS_MODEL, HIT_MISS_LOG_ODDS_RANGE)
    for i in progress_bar(fused, "scan", show=progress):
        scan = scan_from_log(log, i)
        beam_map.integrate(scan)
        hit_miss_map.integrate(scan)
    probability, sampled = beam_map.probability, beam_map.sampled
    observations = observe_cells(log, held_out, grid)
    scored_mask = (sampled & hit_miss_map.sampled).ravel()[observations.cells]
    common = CellObservations(observations.cells[scored_mask], observations.occupied[scored_mask])
    scores: dict[str, Any] = {
        "scans_fused": len(fused),
        "scans_held_out": len(held_out),
        "observations": len(common.cells),
        "unsampled_fraction": 1.0 - float(scored_mask.mean()),
        "occupied_fraction": float(common.occupied.mean()),
        "gaussian_beam": held_out_loss(probability, common),
        "hit_miss": held_out_loss(hit_miss_map.probability, common),
    }
    (x, y), (nx, ny) = grid.origin, grid.shape
    extent = (x, x + nx * RESOLUTION, y, y + ny * RESOLUTION)
    return KillianResult(probability, sampled, RESOLUTION, extent, scores)


def read_killian() -> LaserLog:
    """The log from the installed ``rtb-data``."""
    file = resources.files(import_optional("rtbdata", "data")) / "data" / "killian.g2o.zip"
    with resources.as_file(file) as path:
        return read_laser_log(Path(path))


def scan_from_log(
    log: LaserLog, i: int, noise: RangeNoise = NOISE, usable_range: float = USABLE_RANGE
) -> Scan:
    """Scan `i` in the world frame, with only the beams that returned within the usable range.

    The variance across a beam includes the beam's own width: it was reflected anywhere within one
    `angle_increment`, which is a standard deviation of angle_increment * range / sqrt(12).

    Parameters
    ----------
    log : LaserLog
    i : int
        Number of the scan.
    noise : RangeNoise
    usable_range : float
        Metres.

    Raises
    ------
    ValueError
        If `usable_range` is beyond what the laser can measure.
    """
    if not 0 < usable_range <= log.max_range:
        raise ValueError(f"usable_range must lie in (0, {log.max_range}], got {usable_range}")
    x, y, heading = log.poses[i]
    # a range of zero has no direction, and the map would skip it
    returned = (log.ranges[i] > 0) & (log.ranges[i] < usable_range)
    ranges, angles = log.ranges[i][returned], heading + log.bearings[returned]
    along = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    variances = noise.standard_deviations(ranges, 2) ** 2
    variances[:, 1] += (log.angle_increment * ranges) ** 2 / 12
    covariances = sum(
        variances[:, axis, None, None] * u[:, :, None] * u[:, None, :]
        for axis, u in enumerate((along, across))
    )
    origin = np.array([x, y])
    points = origin + ranges[:, None] * along
    return Scan(origin, points, np.asarray(covariances), np.ones(len(points), dtype=np.bool_))


def grid_for_log(log: LaserLog, resolution: float = RESOLUTION) -> VoxelGrid:
    """The grid that contains every point within the usable range of the laser's poses."""
    margin = USABLE_RANGE + resolution
    lower = np.floor(log.poses[:, :2].min(axis=0) - margin)
    upper = log.poses[:, :2].max(axis=0) + margin
    nx, ny = (math.ceil(cells) for cells in ((upper - lower) / resolution).tolist())
    return VoxelGrid((nx, ny), resolution, tuple(lower.tolist()))


def hold_out(scans: Sequence[int], every: int) -> tuple[list[int], list[int]]:
    """Split scans into kept ones and held-out ones, the last of each group of `every`."""
    kept = [i for k, i in enumerate(scans) if k % every != every - 1]
    return kept, list(scans[every - 1 :: every])


def observe_cells(log: LaserLog, scans: Sequence[int], grid: VoxelGrid) -> CellObservations:
    """Cells that the beams of these scans observe, as the module docstring defines it."""
    cells: list[NDArray[np.int64]] = []
    free: list[int] = []
    for i in scans:
        scan = scan_from_log(log, i)
        start = grid.to_cell_units(scan.origin)
        for ray in grid.to_cell_units(scan.points) - start:
            z = math.hypot(ray[0], ray[1])
            crossed = traverse(start, ray, z, grid.shape)
            flat = grid.flat_index(crossed.cells)
            n_free = int(np.searchsorted(crossed.entries[1:], z - 1.0, side="right"))
            cells += [flat[:n_free], flat[-1:]]
            free.append(n_free)
    occupied = np.zeros(sum(free) + len(free), dtype=np.bool_)
    occupied[np.cumsum(np.array(free, dtype=np.int64) + 1) - 1] = True
    return CellObservations(np.concatenate(cells) if cells else np.empty(0, np.int64), occupied)


def held_out_loss(
    probability: NDArray[np.float64], observations: CellObservations
) -> dict[str, float]:
    """Mean log-loss of observations, nats: over all, free and hit ones, and balanced.

    Balanced is the mean of free and hit. A value is NaN if there is no such observation.
    """
    loss = binary_log_loss(probability.ravel()[observations.cells], observations.occupied)
    free, hit = (
        _mean_or_nan(loss[~observations.occupied]),
        _mean_or_nan(loss[observations.occupied]),
    )
    return {"all": _mean_or_nan(loss), "free": free, "hit": hit, "balanced": (free + hit) / 2}


def _mean_or_nan(values: NDArray[np.float64]) -> float:
    return float(values.mean()) if len(values) else math.nan
