"""The search for the constants of the planar sensor models, on training worlds, with its record.

    python -m coopmap_env.studies.section3.sensor_tuning planar_sensors.json

`PlanarSettings.beam`, its clamp, and the defaults of `HitMissModel` come from this search. The
objective is the mean log-loss of the sampled cells. Neighbouring choices differ by less than 2 % of
it; the record beside this module says what was tried.

In one place `PlanarSettings` depart from the best choice: their clamp is 0.9999, not 0.99999. The
deeper clamp has a log-loss of 0.00506 instead of 0.00509 nats, a hundredth less, but a cell that is
wrong takes more observations to be corrected.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

from coopmap_env.core.files import write_atomically
from coopmap_env.core.settings import Bounds, Settings
from coopmap_env.envs.planar import PlanarEnv
from coopmap_env.evaluation import make_policy
from coopmap_env.evaluation.metrics import log_loss
from coopmap_env.mapping import BeamModel, LogOddsRange, VoxelGrid
from coopmap_env.studies.common.coordinate_search import search_coordinates
from coopmap_env.studies.common.hit_miss import HitMissModel
from coopmap_env.studies.common.map_scores import MapModel
from coopmap_env.studies.section3.calibration import RecordedWorld, pool_cells, record_scans

SEEDS = range(730_000, 730_024)
"""Worlds of the training split, 32 scans each."""
POLICY = "rating_function:search=100"
CLAMPS = (0.99, 0.999, 0.9999, 0.99999)
BEAM_CHOICES = {
    "behind": (0.5, 0.7, 0.85, 0.9, 0.93, 0.95, 0.98),
    "max_probability": CLAMPS,
    "free": (0.0001, 0.0003, 0.001, 0.003, 0.01),
    "occupied": (0.98, 0.995, 0.998, 0.9995),
}
HIT_MISS_CHOICES = {
    "hit": (0.51, 0.55, 0.6, 0.7, 0.8, 0.9, 0.97),
    "miss": (0.0003, 0.001, 0.002, 0.005, 0.01, 0.02, 0.1, 0.4),
    "max_probability": CLAMPS,
}


@dataclass(frozen=True)
class BeamConstants(Settings):
    """The start is v0."""

    behind: float = 0.5
    max_probability: Annotated[float, Bounds(above=0.5, below=1)] = 0.999
    free: float = 0.001
    occupied: float = 0.998

    def model(self) -> MapModel:
        """The map that has these constants."""
        beam = BeamModel(self.free, self.occupied, behind=self.behind)
        return MapModel(beam, LogOddsRange(self.max_probability))


@dataclass(frozen=True)
class HitMissConstants(Settings):
    """The start is v0."""

    hit: float = 0.9
    miss: float = 0.005
    max_probability: Annotated[float, Bounds(above=0.5, below=1)] = 0.999

    def model(self) -> MapModel:
        """The map that has these constants."""
        return MapModel(HitMissModel(self.hit, self.miss), LogOddsRange(self.max_probability))


def tune_sensor_models(worlds: Sequence[RecordedWorld], grid: VoxelGrid) -> dict[str, Any]:
    """Constants of both models of the lowest log-loss, and all that were tried, as JSON values."""

    def loss(constants: BeamConstants | HitMissConstants) -> float:
        return log_loss(*pool_cells(worlds, grid, constants.model()))

    return {
        "gaussian_beam": asdict(search_coordinates(BeamConstants(), BEAM_CHOICES, loss)),
        "hit_miss": asdict(search_coordinates(HitMissConstants(), HIT_MISS_CHOICES, loss)),
    }


def main(path: Path, seeds: Sequence[int] = SEEDS, max_scans: int = 16) -> None:
    """Record the scans, search, and write the record as JSON."""
    env = PlanarEnv(split="train", max_scans=max_scans)
    worlds = list(record_scans(env, make_policy(POLICY), seeds))
    record = {
        "split": "train",
        "seeds": [min(seeds), max(seeds)],
        "policy": POLICY,
        "scans": sum(len(world.scans) for world in worlds),
        **tune_sensor_models(worlds, env.belief().map.grid),
    }
    write_atomically(path, json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
