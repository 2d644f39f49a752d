"""The search for the sensor constants of the map of Killian Court."""

from __future__ import annotations

from collections.abc import Iterable

from coopmap_env.core.progress import progress_bar
from coopmap_env.mapping import BeamModel, LogOddsRange, OccupancyMap
from coopmap_env.sensing import RangeNoise, Scan
from coopmap_env.studies.common.hit_miss import HitMissMap, HitMissModel
from coopmap_env.studies.recorded.killian import (
    BEAM_MODEL,
    HELD_OUT_EVERY,
    VALIDATION_EVERY,
    grid_for_log,
    held_out_loss,
    hold_out,
    observe_cells,
    scan_from_log,
)
from coopmap_env.studies.recorded.laser_log import LaserLog


def tune_killian_models(
    log: LaserLog, stride: int = 1, progress: bool = False
) -> dict[str, dict[tuple[float, ...], float]]:
    """Losses of both maps' constants on validation scans; held-out scans are not used.

    The constants of `killian` are the best of each; the search takes seven minutes. Cells that a
    map did not sample count as 1/2, so that sampling fewer cells is no advantage.

    Parameters
    ----------
    log : LaserLog
    stride : int
        Use every `stride`-th scan.
    progress : bool
        Show progress bars.

    Returns
    -------
    dict
        ``gaussian_beam`` by (noise in metres, free, occupied, clamp) and ``hit_miss`` by (miss,
        hit, clamp): mean log-loss over all observations, the best first.
    """
    grid = grid_for_log(log)
    training, _ = hold_out(range(0, len(log.ranges), stride), HELD_OUT_EVERY)
    fused, validation = hold_out(training, VALIDATION_EVERY)
    observations = observe_cells(log, validation, grid)

    def loss(map_: OccupancyMap | HitMissMap, scans: Iterable[Scan]) -> float:
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
    for sigma, free, occupied, clamp in progress_bar(choices, "model", show=progress):
        if not any(sigma == done[0] for done in beam_losses):
            noise = RangeNoise(intrinsic=sigma, lateral=1.0, exponent=0)
            scans = [scan_from_log(log, i, noise) for i in fused]
        model = BeamModel(free, occupied, BEAM_MODEL.surface)
        beam_map = OccupancyMap(grid, model, LogOddsRange(clamp))
        beam_losses[sigma, free, occupied, clamp] = loss(beam_map, scans)
    hit_miss_losses: dict[tuple[float, ...], float] = {}
    for miss in progress_bar((0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45), "miss", show=progress):
        for hit in (0.55, 0.57, 0.6, 0.63, 0.65, 0.7, 0.75):
            for clamp in (0.98, 0.985, 0.99, 0.993):
                hit_miss_map = HitMissMap(grid, HitMissModel(hit, miss, 0), LogOddsRange(clamp))
                hit_miss_losses[miss, hit, clamp] = loss(hit_miss_map, scans)
    return {
        name: dict(sorted(losses.items(), key=lambda item: item[1]))
        for name, losses in (("gaussian_beam", beam_losses), ("hit_miss", hit_miss_losses))
    }
