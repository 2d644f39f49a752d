"""The searches for sensor constants, and OctoMap's rule that one of them replays."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import pytest

from coopmap_env.core.settings import Settings
from coopmap_env.envs.field import FieldSettings
from coopmap_env.envs.planar import PlanarSettings
from coopmap_env.mapping import VoxelGrid
from coopmap_env.sensing import Scan
from coopmap_env.studies.common.coordinate_search import search_coordinates
from coopmap_env.studies.common.hit_miss import HIT_MISS_LOG_ODDS_RANGE, HitMissModel
from coopmap_env.studies.field import octomap_comparison
from coopmap_env.studies.section3 import sensor_tuning


@dataclass(frozen=True)
class Point(Settings):
    x: float = 0.0
    y: float = 0.0


def test_the_search_finds_the_lowest_choice_and_records_each_choice_once():
    def loss(point):
        seen.append(point)
        return (point.x - 2) ** 2 + 0.3 * (point.y - point.x) ** 2

    seen = []
    result = search_coordinates(Point(), {"x": (0.0, 1.0, 2.0), "y": (0.0, 1.0, 2.0, 3.0)}, loss)
    # by hand: with y = 0 the losses of x = 0, 1, 2 are 4, 1.3 and 1.2; then y = 2 has none
    assert result.best == Point(2.0, 2.0)
    assert result.loss == 0
    assert len(set(seen)) == len(seen) == len(result.tried)
    assert {"x": 2.0, "y": 2.0, "loss": 0.0} in result.tried


def test_the_search_stops_after_its_rounds():
    result = search_coordinates(
        Point(), {"x": (0.0, 1.0, 2.0), "y": (0.0, 1.0, 2.0)}, lambda p: -p.x * p.y - p.x, 1
    )
    assert result.best == Point(2.0, 2.0)
    assert len(result.tried) == 5


def test_the_planar_search_improves_on_v0_and_keeps_a_record(tmp_path, monkeypatch):
    monkeypatch.setattr(sensor_tuning, "BEAM_CHOICES", {"behind": (0.5, 0.93)})
    monkeypatch.setattr(sensor_tuning, "HIT_MISS_CHOICES", {"hit": (0.9,)})
    sensor_tuning.main(tmp_path / "record.json", seeds=range(2), max_scans=3)
    record = json.loads((tmp_path / "record.json").read_text())
    assert (record["split"], record["seeds"], record["scans"]) == ("train", [0, 1], 12)
    beam = record["gaussian_beam"]
    assert beam["best"]["behind"] == 0.93
    assert beam["loss"] == min(choice["loss"] for choice in beam["tried"])
    assert len(beam["tried"]) == 2


def read(module_file, name):
    return json.loads(Path(module_file).with_name(name).read_text())


def test_the_planar_defaults_are_those_of_the_record_but_for_the_clamp():
    record = read(sensor_tuning.__file__, "planar_sensors.json")
    beam = record["gaussian_beam"]
    settings = PlanarSettings()
    names = ("behind", "free", "occupied")
    assert {name: beam["best"][name] for name in names} == {
        name: getattr(settings.beam, name) for name in names
    }
    clamp = settings.log_odds_range.max_probability
    assert (clamp, beam["best"]["max_probability"]) == (0.9999, 0.99999)
    (kept,) = (
        one["loss"] for one in beam["tried"] if one == {
            **beam["best"], "max_probability": clamp, "loss": one["loss"],
        }
    )  # fmt: skip
    assert beam["loss"] < kept < 1.01 * beam["loss"]


def test_the_hit_miss_defaults_are_those_of_the_record():
    best = read(sensor_tuning.__file__, "planar_sensors.json")["hit_miss"]["best"]
    model = HitMissModel()
    assert best == {
        "hit": model.hit,
        "miss": model.miss,
        "max_probability": HIT_MISS_LOG_ODDS_RANGE.max_probability,
    }


def test_the_field_defaults_are_those_of_the_record():
    record = read(octomap_comparison.__file__, "field_sensors.json")
    best, settings = record["gaussian_beam"]["best"], FieldSettings()
    clamp = best.pop("max_probability")
    assert best == {name: getattr(settings.beam, name) for name in best}
    assert set(best) == {"behind", "posterior_cutoff", "free", "occupied"}
    assert clamp == settings.log_odds_range.max_probability


def test_the_tuned_octomap_is_that_of_the_record():
    record = read(octomap_comparison.__file__, "field_sensors.json")
    best = record["octomap"]["best"]
    assert best == asdict(octomap_comparison.TUNED_OCTOMAP)
    tried = record["octomap"]["tried"]
    for name, value in best.items():  # no best value lies at an end of what was tried
        values = {one[name] for one in tried}
        assert min(values) < value < max(values), name


def test_replayed_octomap_is_octomap():
    pytest.importorskip("pyoctomap")
    pytest.importorskip("pybullet")
    from coopmap_env.studies.field import calibration

    grid = VoxelGrid((12, 10, 8), 0.5, (0.2, -1.4, 0.1))
    rng = np.random.default_rng(0)
    scans = []
    for _ in range(4):
        points = rng.uniform(0.1, 0.9, (60, 3)) * np.array(grid.shape) * 0.5 + grid.origin
        hit = rng.random(60) < 0.7
        scans.append(Scan(grid.center([2, 5, 4]), points, np.zeros((60, 3, 3)), hit))
    constants = octomap_comparison.OctomapConstants(0.9, 0.2, 0.05, 0.99)
    tree, seconds = octomap_comparison.fuse_octomap(scans, grid, constants)
    wanted = octomap_comparison.read_octomap(tree, seconds, grid)
    counts = [calibration.octomap_counts(scan, grid) for scan in scans]
    p, sampled = calibration.apply_octomap_rule(counts, grid, constants)
    assert (sampled == wanted.sampled).all()
    # OctoMap keeps floats of 24 bits
    assert p == pytest.approx(wanted.probability, abs=1e-5)
    assert max(updates.hits.max() for updates in counts) >= 1
