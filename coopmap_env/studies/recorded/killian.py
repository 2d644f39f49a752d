"""Real laser scans: MIT Killian Court fused into one map and scored on scans that it never saw.

The log (MIT Killian Court and the corridors around it; 3,873 scans of 180
beams along 2 km of corridors, loops of 200 m) comes with the extra ``data``. Its poses are good as
they are: they equal the vertices of its pose graph, loop closures included, and Gauss-Newton on
that graph moves them by 3 mm (median) and takes its error from 1034 to 1032, while the held-out
loss gets no better. So no graph is optimised here.

Every tenth scan is held out of the map. For a held-out beam that returned after z metres (within
the usable range), each cell that it left a cell's length or more before z was seen free, the cell
that holds z was seen occupied; those between are left out, as an error of centimetres may exchange
them. A map is scored by the binary log-loss of these observations, over the cells that both maps
sampled. The constants of both maps are those of `tune_sensor_models`, which sees the other nine tenths only and
minimises the loss over all observations, of which one in twenty is of an occupied cell.

An observation is not the state of a cell: beams pass beside the walls in their cells, and people
walk. So no map reaches zero. At cells four times the noise it is not the width of the Gaussian that
tells the two maps apart (0.02 m or 0.1 m serve alike), but how a beam speaks of cells that it
crosses in part. With surfaces "anywhere", where beams that pass beside a wall are added up against
those that end at it, the beam model does worse than the constant one (0.103 to 0.093).
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.extras import import_optional
from coopmap_env.evaluation.metrics.calibration import binary_log_loss
from coopmap_env.geometry import traverse
from coopmap_env.mapping import BeamModel, LogOddsRange, OccupancyMap, VoxelGrid
from coopmap_env.sensing import RangeNoise, Scan
from coopmap_env.studies.recorded.hit_miss import HitMissMap, HitMissModel
from coopmap_env.studies.recorded.laser_log import LaserLog, read_laser_log

RESOLUTION = 0.2
"""Metres: a corridor is ten cells wide and the court 2.6 million cells."""
USABLE_RANGE = 30.0
"""Metres: longer readings and no returns are skipped, not taken for free space. Many a beam between
neighbours that see a wall at 2 m has no return; freeing the first 15 m along such beams made the
validation scans less likely under both maps. Of walls beyond 30 m the maps learn nothing (0.1 % of
the loss, ours better, the constant one worse): a heading's error is worth a cell there."""
NOISE = RangeNoise(intrinsic=0.05, lateral=1.0, exponent=0)
"""Of the laser (ranges are multiples of 5 cm or finer) and of the poses (median residual of a loop
closure: 1 cm, 95 % of them below 5 cm) together, which are alike in all directions."""
BEAM_MODEL = BeamModel(free=0.2, occupied=0.63, surface="partial")
BEAM_LOG_ODDS_RANGE = LogOddsRange(0.99)
HIT_MISS_MODEL = HitMissModel(hit=0.63, miss=0.35, hit_offset=0)
HIT_MISS_LOG_ODDS_RANGE = LogOddsRange(0.985)
"""Models and clamps: the best of `tune_sensor_models` (500 and 196 choices, seven minutes), 0.0923 and 0.0948 on
the validation scans."""
HELD_OUT_EVERY = 10
"""One scan in so many is held out of the map."""
VALIDATION_EVERY = 9
"""One of so many of the others is held out again while tuning."""

ComparedMap = OccupancyMap | HitMissMap


@dataclass(frozen=True, eq=False)
class CellObservations:
    """What scans say of the cells that their beams cross, one entry per beam and cell."""

    cells: NDArray[np.int64]
    """Shape (n,): flat cell numbers."""
    occupied: NDArray[np.bool_]
    """Shape (n,): whether the beam ended there."""


@dataclass(frozen=True, eq=False)
class KillianResult:
    """The map of the fused scans and how well it foretells the others."""

    probability: NDArray[np.float64]
    """P(occupied), shape of the grid."""
    sampled: NDArray[np.bool_]
    """Where a scan ever told something, shape of the grid."""
    resolution: float
    """Metres."""
    extent: tuple[float, float, float, float]
    """Of the grid: least and greatest x, least and greatest y, metres."""
    scores: dict[str, Any]
    """JSON values: counts of scans and observations, and per map (``gaussian_beam``, ``hit_miss``)
    the mean held-out log-loss in nats over ``all`` observations, those of ``free`` and those of
    occupied cells (``hit``), and the mean of these two (``balanced``)."""
    elapsed_s: float
    """What the whole run took."""


def run(stride: int = 1, progress: bool = False) -> KillianResult:
    """Fuse nine tenths of the scans and score the map on the held-out tenth.

    Parameters
    ----------
    stride : int
        Take every so many-th scan only; 6 is quick and leaves no gap in a corridor. The constants
        are those for all scans: the scores of a stride do not compare the maps fairly.
    progress : bool
        Show a bar (extra ``cli``).

    Raises
    ------
    ImportError
        With the pip command, if ``rtb-data`` is not installed.
    ValueError
        If `stride` is below 1 or leaves fewer than ten scans; `LaserLogError` if the data are bad.
    """
    if stride < 1:
        raise ValueError(f"stride must be at least 1, got {stride}")
    start = time.perf_counter()
    log = read_killian()
    grid = grid_for_log(log)
    fused, held_out = hold_out(range(0, len(log.ranges), stride), HELD_OUT_EVERY)
    if len(held_out) == 0:
        raise ValueError(f"stride {stride} leaves fewer than {HELD_OUT_EVERY} scans")
    beam_map = OccupancyMap(grid, BEAM_MODEL, BEAM_LOG_ODDS_RANGE)
    hit_miss_map = HitMissMap(grid, HIT_MISS_MODEL, HIT_MISS_LOG_ODDS_RANGE)
    for i in _progress_bar(fused, progress):
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
    elapsed_s = time.perf_counter() - start
    return KillianResult(probability, sampled, RESOLUTION, extent, scores, elapsed_s)


def read_killian() -> LaserLog:
    """The log from the installed ``rtb-data``."""
    file = resources.files(import_optional("rtbdata", "data")) / "data" / "killian.g2o.zip"
    with resources.as_file(file) as path:
        return read_laser_log(Path(path))


def scan_from_log(
    log: LaserLog, i: int, noise: RangeNoise = NOISE, usable_range: float = USABLE_RANGE
) -> Scan:
    """Scan i as the map takes it: only the beams that returned within the usable range.

    To the noise across a beam comes the beam's own width: it was reflected anywhere in the `angle_increment`
    between its neighbours, a standard deviation of step * range / sqrt(12).

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
    """A grid that holds all that the laser can have used from where it stood."""
    margin = USABLE_RANGE + resolution
    lower = np.floor(log.poses[:, :2].min(axis=0) - margin)
    upper = log.poses[:, :2].max(axis=0) + margin
    nx, ny = np.ceil((upper - lower) / resolution).astype(int).tolist()
    return VoxelGrid((nx, ny), resolution, tuple(lower.tolist()))


def hold_out(scans: Sequence[int], every: int) -> tuple[list[int], list[int]]:
    """Most scans, and one in so many of them (the last of each such group) apart."""
    kept = [i for k, i in enumerate(scans) if k % every != every - 1]
    return kept, list(scans[every - 1 :: every])


def observe_cells(log: LaserLog, scans: Sequence[int], grid: VoxelGrid) -> CellObservations:
    """What the beams of these scans say of the cells, as the module's text defines it."""
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
    """Mean log-loss of observations in nats: over all, free and hit ones, and balanced.

    Balanced is the mean of free and hit. NaN where there is no such observation.
    """
    loss = binary_log_loss(probability.ravel()[observations.cells], observations.occupied)
    free, hit = (
        _mean_or_nan(loss[~observations.occupied]),
        _mean_or_nan(loss[observations.occupied]),
    )
    return {"all": _mean_or_nan(loss), "free": free, "hit": hit, "balanced": (free + hit) / 2}


def tune_sensor_models(
    log: LaserLog, stride: int = 1, progress: bool = False
) -> dict[str, dict[tuple[float, ...], float]]:
    """Losses of both maps' constants on validation scans; no held-out scan is touched.

    The defaults of this module are the best of each. What a map did not sample counts as one half
    here, so that seeing less is no advantage.

    Returns
    -------
    dict
        ``gaussian_beam`` by (noise in metres, free, occupied, clamp) and ``hit_miss`` by (miss,
        hit, clamp), each in order, best first: mean log-loss over all observations.
    """
    grid = grid_for_log(log)
    training, _ = hold_out(range(0, len(log.ranges), stride), HELD_OUT_EVERY)
    fused, validation = hold_out(training, VALIDATION_EVERY)
    observations = observe_cells(log, validation, grid)

    def loss(map_: ComparedMap, scans: Iterable[Scan]) -> float:
        for scan in scans:
            map_.integrate(scan)
        return held_out_loss(map_.probability, observations)["all"]

    choices = [
        (sigma, free, occupied, clamp)
        for sigma in (0.02, 0.03, 0.05, 0.07, 0.1)
        for free in (0.15, 0.2, 0.25, 0.3, 0.35)
        for occupied in (0.57, 0.6, 0.63, 0.66, 0.7)
        for clamp in (0.98, 0.985, 0.99, 0.993)
    ]
    beam_losses: dict[tuple[float, ...], float] = {}
    scans: list[Scan] = []
    for sigma, free, occupied, clamp in _progress_bar(choices, progress):
        if not any(sigma == done[0] for done in beam_losses):
            noise = RangeNoise(intrinsic=sigma, lateral=1.0, exponent=0)
            scans = [scan_from_log(log, i, noise) for i in fused]
        model = BeamModel(free, occupied, BEAM_MODEL.surface)
        beam_map = OccupancyMap(grid, model, LogOddsRange(clamp))
        beam_losses[sigma, free, occupied, clamp] = loss(beam_map, scans)
    hit_miss_losses: dict[tuple[float, ...], float] = {}
    for miss in _progress_bar((0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45), progress):
        for hit in (0.55, 0.57, 0.6, 0.63, 0.65, 0.7, 0.75):
            for clamp in (0.98, 0.985, 0.99, 0.993):
                hit_miss_map = HitMissMap(grid, HitMissModel(hit, miss, 0), LogOddsRange(clamp))
                hit_miss_losses[miss, hit, clamp] = loss(hit_miss_map, scans)
    return {
        name: dict(sorted(losses.items(), key=lambda item: item[1]))
        for name, losses in (("gaussian_beam", beam_losses), ("hit_miss", hit_miss_losses))
    }


def _mean_or_nan(values: NDArray[np.float64]) -> float:
    return float(values.mean()) if len(values) else math.nan


def _progress_bar(items: Sequence[Any], progress: bool) -> Iterable[Any]:
    if not progress:
        return items
    bar: Iterable[Any] = import_optional("tqdm", "cli").tqdm(items, unit="scan", smoothing=0.1)
    return bar
