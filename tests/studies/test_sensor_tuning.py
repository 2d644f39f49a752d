"""The searches for sensor constants, and OctoMap's rule that one of them replays."""

import json
from dataclasses import dataclass

import numpy as np
import pytest

from coopmap_env.core.settings import Settings
from coopmap_env.mapping import VoxelGrid
from coopmap_env.sensing import Scan
from coopmap_env.studies.common.coordinate_search import search_coordinates
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


def test_replayed_octomap_is_octomap():
    pytest.importorskip("pyoctomap")
    pytest.importorskip("pybullet")
    from coopmap_env.studies.field import calibration, octomap_comparison

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
