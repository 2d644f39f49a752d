import numpy as np
import pytest
from plain.ray_cells import crossed_cells

from coopmap_env.mapping import VoxelGrid
from coopmap_env.sensing import Scan
from coopmap_env.studies.common.hit_miss import HitMissMap, HitMissModel


def scan(origin, points, hit):
    points = np.asarray(points, dtype=float)
    n = len(points)
    return Scan(np.array(origin, dtype=float), points, np.zeros((n, 2, 2)), np.array(hit))


def test_one_beam_by_hand():
    map_ = HitMissMap(VoxelGrid((6, 1)), HitMissModel(hit=0.8, miss=0.25, hit_offset=0.5))
    map_.integrate(scan([0.5, 0.5], [[3.0, 0.5]], [True]))
    assert map_.probability[:, 0] == pytest.approx([0.25, 0.25, 0.25, 0.8, 0.5, 0.5], abs=1e-3)
    assert map_.sampled[:, 0].tolist() == [True] * 4 + [False] * 2


def test_a_beam_without_return_only_frees_cells():
    map_ = HitMissMap(VoxelGrid((6, 1)), HitMissModel(hit=0.8, miss=0.25))
    map_.integrate(scan([0.5, 0.5], [[2.9, 0.5]], [False]))
    assert map_.probability[:4, 0] == pytest.approx([0.25, 0.25, 0.25, 0.5], abs=1e-3)


def test_in_one_scan_hits_come_first_and_each_cell_is_updated_once():
    map_ = HitMissMap(VoxelGrid((6, 1)), HitMissModel(hit=0.8, miss=0.25, hit_offset=0.0))
    beams = [[2.5, 0.5], [5.5, 0.5], [2.6, 0.5]]
    map_.integrate(scan([0.5, 0.5], beams, [True, False, True]))
    assert map_.probability[2, 0] == pytest.approx(0.8, abs=1e-3)


def test_the_kernel_equals_plain_loops_on_random_scans():
    rng = np.random.default_rng(0)
    model = HitMissModel(hit=0.7, miss=0.3, hit_offset=0.5)
    map_ = HitMissMap(VoxelGrid((12, 9)), model)
    plain = np.zeros((12, 9))
    for _ in range(10):
        origin = rng.uniform(1, 8, 2)
        points = rng.uniform(0.5, 8.5, (20, 2))
        hit = rng.random(20) < 0.6
        map_.integrate(scan(origin, points, hit))
        marks = {}
        for point, is_hit in zip(points, hit, strict=True):
            length = np.linalg.norm(point - origin) + 0.5 * is_hit
            crossed = [c for c, _, _ in crossed_cells(origin, point - origin, length, (12, 9))]
            for cell in crossed:
                marks[cell] = max(marks.get(cell, 1), 1)
            if is_hit:
                marks[crossed[-1]] = 2
        for cell, mark in marks.items():
            p = model.hit if mark == 2 else model.miss
            plain[cell] = np.clip(plain[cell] + np.log(p / (1 - p)), -6.907, 6.907)
    # a level is 1 / 1024 nat, and there are at most 10 updates
    odds = np.log(map_.probability / (1 - map_.probability))
    assert odds == pytest.approx(plain, abs=10 / 1024)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ((0.5, 0.3), r"needs miss < 0\.5 < hit, got miss 0\.3 and hit 0\.5"),
        ((0.8, 0.5), r"needs miss < 0\.5 < hit, got miss 0\.5 and hit 0\.8"),
        ((0.8, 0.0), r"HitMissModel\.miss must be .* got 0\.0"),
        ((1.0, 0.1), r"HitMissModel\.hit must be .* got 1\.0"),
    ],
)
def test_constants_out_of_range_are_named(values, message):
    with pytest.raises(ValueError, match=message):
        HitMissModel(*values)
