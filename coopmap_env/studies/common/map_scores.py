"""Scores of the cells of maps that were fused from the same scans by different sensor models."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.evaluation import BOOTSTRAP_SEED
from coopmap_env.evaluation.metrics import (
    brier_score,
    expected_calibration_error,
    log_loss,
    reliability_curve,
)
from coopmap_env.evaluation.statistics import bootstrap_clusters
from coopmap_env.mapping import (
    FREE_PROBABILITY,
    BeamModel,
    LogOddsRange,
    OccupancyMap,
    VoxelGrid,
)
from coopmap_env.studies.common.hit_miss import HitMissMap, HitMissModel


class ScoredCells(NamedTuple):
    """Cells of one or more maps as calibration scores take them, flat (n,)."""

    probability: NDArray[np.float64]
    occupied: NDArray[np.bool_]
    sampled: NDArray[np.bool_]


@dataclass(frozen=True)
class MapModel:
    """A sensor model and the clamp of its map."""

    sensor: BeamModel | HitMissModel
    log_odds_range: LogOddsRange

    def map(self, grid: VoxelGrid) -> OccupancyMap | HitMissMap:
        """An empty map."""
        if isinstance(self.sensor, BeamModel):
            return OccupancyMap(grid, self.sensor, self.log_odds_range)
        return HitMissMap(grid, self.sensor, self.log_odds_range)


def pool(parts: Iterable[ScoredCells]) -> ScoredCells:
    """All cells of several maps."""
    return ScoredCells(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def calibration_scores(cells: ScoredCells) -> dict[str, Any]:
    """Brier score, log-loss, calibration error and the reliability curve, as JSON values.

    ``missed`` is the fraction of occupied cells with P < 0.05, into which a robot would move;
    ``not_cleared`` that of free cells with P >= 0.05, into which it would not. ``found`` is the
    fraction of occupied cells with P > 1/2, ``false_occupied`` that of free ones, and
    ``false_share`` that of free ones among all with P > 1/2.
    """
    curve = reliability_curve(*cells)
    p, occupied, sampled = cells
    likely = p > 0.5
    return {
        "brier_score": brier_score(*cells),
        "log_loss": log_loss(*cells),
        "log_loss_free": log_loss(p, occupied, sampled & ~occupied),
        "log_loss_occupied": log_loss(p, occupied, sampled & occupied),
        "missed": fraction(p[sampled & occupied] < FREE_PROBABILITY),
        "not_cleared": fraction(p[sampled & ~occupied] >= FREE_PROBABILITY),
        "found": fraction(likely[sampled & occupied]),
        "false_occupied": fraction(likely[sampled & ~occupied]),
        "false_share": fraction(~occupied[sampled & likely]),
        "calibration_error": expected_calibration_error(*cells),
        "cells": int(cells.sampled.sum()),
        "reliability": {
            "predicted": [None if np.isnan(v) else float(v) for v in curve.mean_predicted],
            "observed": [None if np.isnan(v) else float(v) for v in curve.occupied_fraction],
            "counts": curve.counts.tolist(),
        },
    }


def reliability_intervals(worlds: Sequence[ScoredCells]) -> dict[str, list[float | None]]:
    """95 % intervals of the occupied fraction of each bin of the reliability curve, as JSON values.

    Whole worlds are resampled, as neighbouring cells depend on each other.

    Parameters
    ----------
    worlds : sequence of ScoredCells
        Two or more.

    Returns
    -------
    dict
        "low" and "high" of each bin; None where no world has cells.
    """
    curves = [reliability_curve(*cells) for cells in worlds]
    counts = np.array([curve.counts for curve in curves])
    occupied = counts * np.nan_to_num([curve.occupied_fraction for curve in curves])
    rng = np.random.default_rng(BOOTSTRAP_SEED)
    ends: dict[str, list[float | None]] = {"low": [], "high": []}
    for n_cells, n_occupied in zip(counts.T, occupied.T, strict=True):
        rows = np.stack([n_occupied, n_cells], axis=1)[:, None]
        interval = bootstrap_clusters(list(rows), _occupied_share, rng) if n_cells.any() else None
        ends["low"].append(None if interval is None else interval.low)
        ends["high"].append(None if interval is None else interval.high)
    return ends


def _occupied_share(rows: NDArray[np.float64]) -> float:
    """Occupied cells over cells, of rows (n, 2) of both; NaN without cells."""
    n_occupied, n_cells = rows.sum(axis=0)
    return float(n_occupied / n_cells) if n_cells else float("nan")


def compare_cells(pooled: Mapping[str, ScoredCells]) -> dict[str, dict[str, Any]]:
    """`calibration_scores` of each model; ``log_loss_common`` is over what all of them sampled."""
    common = np.logical_and.reduce([cells.sampled for cells in pooled.values()])
    return {
        name: {
            **calibration_scores(cells),
            "log_loss_common": log_loss(cells.probability, cells.occupied, common),
        }
        for name, cells in pooled.items()
    }


def fraction(which: NDArray[np.bool_]) -> float:
    """The fraction of cells that are marked; NaN without cells."""
    return float(which.mean()) if which.size else float("nan")
