"""Is the map a probability? Brier score, log-loss and reliability against the truth.

The scans of whole episodes are fused by the Gaussian beam model and by a constant hit/miss model,
and both maps are scored on the cells that either knows. The constants of both models were tuned by
`tune_sensor_models` on training worlds; reports use test worlds.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.envs.planar import PlanarEnv
from coopmap_env.evaluation.metrics.calibration import (
    brier_score,
    expected_calibration_error,
    log_loss,
    reliability_curve,
)
from coopmap_env.evaluation.policy import Policy
from coopmap_env.evaluation.rollout import policy_rng
from coopmap_env.mapping import BeamModel, OccupancyMap
from coopmap_env.sensing import Scan
from coopmap_env.simulation import PlanarSimulator
from coopmap_env.studies.recorded.hit_miss import HitMissMap, HitMissModel

NOISE_STREAM = 0x5CA9
"""Spawn key of the scans' noise: drawn apart from the episode's own."""


@dataclass(frozen=True)
class RecordedWorld:
    """Scans that a policy took in one world, and the truth."""

    scans: tuple[Scan, ...]
    occupied: NDArray[np.bool_]


def record_scans(env: PlanarEnv, policy: Policy, seeds: Sequence[int]) -> Iterator[RecordedWorld]:
    """Play an episode in each world and scan anew from all poses that were visited."""
    for seed in seeds:
        observations, _ = env.reset(seed=seed)
        policy.reset(policy_rng(seed))
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(NOISE_STREAM,)))
        simulator = PlanarSimulator(env.truth, env.settings.camera, env.settings.noise)
        scans = []
        while env.agents:
            observations, *_ = env.step(policy.act(env.belief(), observations))
            scans += [simulator.scan_from(pose, rng) for pose in env.belief().poses]
        yield RecordedWorld(tuple(scans), env.truth.occupied)


class ScoredCells(NamedTuple):
    """What quality scores take, flat."""

    probability: NDArray[np.float64]
    occupied: NDArray[np.bool_]
    sampled: NDArray[np.bool_]


def fuse_scans(world: RecordedWorld, map_: OccupancyMap | HitMissMap) -> ScoredCells:
    """Fuse a world's scans; return its cells."""
    for scan in world.scans:
        map_.integrate(scan)
    return ScoredCells(map_.probability.ravel(), world.occupied.ravel(), map_.sampled.ravel())


def pool_cells(
    worlds: Sequence[RecordedWorld], env: PlanarEnv, model: BeamModel | HitMissModel
) -> ScoredCells:
    """All cells of all worlds under one model."""
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
    """The constants of least log-loss on these (training) worlds, from a grid of choices.

    Returns
    -------
    beam : BeamModel
    constant : HitMissModel
    losses : dict
        Log-loss by choice, for looking.
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
