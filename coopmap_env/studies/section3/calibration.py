"""Calibration of the map: Brier score, log-loss and reliability against the truth.

The scans of whole episodes are fused by the Gaussian beam model and by a constant hit/miss model.
Both maps are scored on the cells that they sampled. The constants of both models were tuned by
`tune_sensor_models` on training worlds; reports use test worlds.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.envs.planar import PlanarEnv
from coopmap_env.evaluation import Policy, rollout
from coopmap_env.evaluation.metrics import (
    brier_score,
    expected_calibration_error,
    log_loss,
    reliability_curve,
)
from coopmap_env.mapping import BeamModel, OccupancyMap
from coopmap_env.sensing import Scan
from coopmap_env.simulation import PlanarSimulator
from coopmap_env.studies.common.hit_miss import HitMissMap, HitMissModel

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


class ScoredCells(NamedTuple):
    """Cells of one or more maps as calibration scores take them, flat (n,)."""

    probability: NDArray[np.float64]
    occupied: NDArray[np.bool_]
    sampled: NDArray[np.bool_]


def fuse_scans(world: RecordedWorld, map_: OccupancyMap | HitMissMap) -> ScoredCells:
    """Fuse the scans of a world into an empty map; return its cells."""
    for scan in world.scans:
        map_.integrate(scan)
    return ScoredCells(map_.probability.ravel(), world.occupied.ravel(), map_.sampled.ravel())


def pool_cells(
    worlds: Sequence[RecordedWorld], env: PlanarEnv, model: BeamModel | HitMissModel
) -> ScoredCells:
    """All cells of all worlds, each fused with the same model."""
    grid, clamp = env.belief().map.grid, env.settings.log_odds_range
    parts = [
        fuse_scans(
            world,
            OccupancyMap(grid, model, clamp)
            if isinstance(model, BeamModel)
            else HitMissMap(grid, model, clamp),
        )
        for world in worlds
    ]
    return ScoredCells(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def calibration_scores(cells: ScoredCells) -> dict[str, Any]:
    """Brier score, log-loss, calibration error and the reliability curve, as JSON values."""
    curve = reliability_curve(*cells)
    return {
        "brier_score": brier_score(*cells),
        "log_loss": log_loss(*cells),
        "calibration_error": expected_calibration_error(*cells),
        "cells": int(cells.sampled.sum()),
        "reliability": {
            "predicted": [None if np.isnan(v) else float(v) for v in curve.mean_predicted],
            "observed": [None if np.isnan(v) else float(v) for v in curve.occupied_fraction],
            "counts": curve.counts.tolist(),
        },
    }


def tune_sensor_models(
    worlds: Sequence[RecordedWorld], env: PlanarEnv
) -> tuple[BeamModel, HitMissModel, dict[str, float]]:
    """Find the constants of both models that minimise the log-loss on training worlds.

    The defaults of `BeamModel` and `HitMissModel` come from this search. It takes some minutes.

    Returns
    -------
    beam : BeamModel
    hit_miss : HitMissModel
    losses : dict
        Log-loss of every choice, by its description.
    """
    losses: dict[str, float] = {}
    free_values = (0.0005, 0.001, 0.002, 0.005, 0.01, 0.02)
    occupied_values = (0.9, 0.95, 0.98, 0.99, 0.995, 0.998)
    beam_models = {
        f"beam free={free} occupied={occupied}": replace(
            env.settings.beam, free=free, occupied=occupied
        )
        for free in free_values
        for occupied in occupied_values
    }
    hit_miss_models = {
        f"constant miss={miss} hit={hit}": HitMissModel(hit, miss)
        for miss in (0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.4)
        for hit in (0.51, 0.55, 0.6, 0.7, 0.8, 0.9, 0.97)
    }
    models: dict[str, BeamModel | HitMissModel] = {**beam_models, **hit_miss_models}
    for name, model in models.items():
        losses[name] = log_loss(*pool_cells(worlds, env, model))
    best_beam_name = min(beam_models, key=losses.__getitem__)
    best_hit_miss_name = min(hit_miss_models, key=losses.__getitem__)
    return beam_models[best_beam_name], hit_miss_models[best_hit_miss_name], losses
