"""OctoMap and our map side by side."""

import math

import numpy as np
import pytest

from coopmap_env.mapping import BeamModel, VoxelGrid
from coopmap_env.mapping.files.octomap import sample_octree
from coopmap_env.sensing import Scan
from coopmap_env.studies.field.octomap_comparison import (
    FusedMap,
    OctomapConstants,
    compare_with_octomap,
    fuse_octomap,
)

pytest.importorskip("pyoctomap")
# the origin is no multiple of the resolution: OctoMap's voxels are shifted for it
GRID = VoxelGrid((12, 6, 5), 0.5, (0.2, -1.4, 0.1))
MODEL = BeamModel(0.02, 0.9, "partial")


def beams(*ends, hit, sigma=0.02):
    """Beams from the middle of cell (0, 2, 2) to points of cells."""
    points = (np.array(ends, dtype=float) + 0.5) * GRID.resolution + GRID.origin
    covariances = np.tile(np.eye(3) * sigma**2, (len(points), 1, 1))
    return Scan(GRID.center([0, 2, 2]), points, covariances, np.array(hit))


def truth():
    occupied = np.zeros(GRID.shape, dtype=bool)
    occupied[8] = True
    return occupied


def test_both_maps_agree_and_are_right_for_precise_beams():
    result = compare_with_octomap(
        [beams((8, 2, 2), (8, 3, 2), hit=[True, True])] * 3, truth(), GRID, MODEL
    )
    assert result.n_scans == 3
    assert result.agreement == result.ours.accuracy == result.tuned.accuracy == 1
    assert result.default.accuracy == 1
    assert result.ours.missed == result.tuned.missed == 0
    assert result.common_cells > 9
    assert result.ours.milliseconds > 0
    assert result.tuned.milliseconds > 0


def test_octomaps_probabilities_are_its_constants_by_hand():
    tree, _ = fuse_octomap([beams((8, 2, 2), hit=[True])] * 2, GRID)
    log_odds, known = sample_octree(tree, GRID)
    assert np.argwhere(known).tolist() == [[i, 2, 2] for i in range(9)]
    # hit 0.7 twice, miss 0.4 twice: floats of 24 bits
    assert log_odds[8, 2, 2] == pytest.approx(2 * math.log(0.7 / 0.3), rel=1e-6)
    assert log_odds[:8, 2, 2] == pytest.approx(np.full(8, 2 * math.log(0.4 / 0.6)), rel=1e-6)
    loss = compare_with_octomap([beams((8, 2, 2), hit=[True])] * 2, truth(), GRID, MODEL).default
    p_hit, p_miss = 1 / (1 + (3 / 7) ** 2), 1 / (1 + 1.5**2)
    expected = -(math.log(p_hit) + 8 * math.log(1 - p_miss)) / 9
    assert loss.log_loss == pytest.approx(expected, rel=1e-6)


def test_other_constants_are_octomaps_own_by_hand():
    constants = OctomapConstants(0.9, 0.2, 0.1, 0.95)
    tree, _ = fuse_octomap([beams((8, 2, 2), hit=[True])], GRID, constants)
    log_odds, _ = sample_octree(tree, GRID)
    assert log_odds[8, 2, 2] == pytest.approx(math.log(0.9 / 0.1), rel=1e-6)
    assert log_odds[:8, 2, 2] == pytest.approx(np.full(8, math.log(0.2 / 0.8)), rel=1e-6)
    tree, _ = fuse_octomap([beams((8, 2, 2), hit=[True])] * 9, GRID, constants)
    log_odds, _ = sample_octree(tree, GRID)
    assert log_odds[8, 2, 2] == pytest.approx(math.log(0.95 / 0.05), rel=1e-6)
    assert log_odds[0, 2, 2] == pytest.approx(math.log(0.1 / 0.9), rel=1e-6)


def test_missed_and_not_cleared_voxels_by_hand():
    occupied = np.array([True, True, True, True, False, False])
    p = np.array([0.01, 0.04, 0.05, 0.9, 0.04, 0.06])
    scores = FusedMap(p, np.ones(6, bool), 0.002).scores(occupied, np.ones(6, bool))
    assert (scores.missed, scores.not_cleared, scores.accuracy) == (0.5, 0.5, 0.5)
    assert scores.milliseconds == 2
    assert scores.log_loss_free == pytest.approx(-(math.log(0.96) + math.log(0.94)) / 2)


def test_beams_without_return_are_free_up_to_their_own_ends():
    # two of different length and none that ends: no voxel is occupied
    tree, _ = fuse_octomap([beams((9, 2, 2), (4, 3, 2), hit=[False, False])], GRID)
    log_odds, known = sample_octree(tree, GRID)
    assert (log_odds[known] < 0).all()
    assert known[:9, 2, 2].all()
    assert not known[10:].any()
    assert known[3, 3, 2]
    assert not known[6:, 3, 2].any()


def test_a_beam_of_zero_length_observes_nothing():
    result = compare_with_octomap([beams((0, 2, 2), hit=[False])], truth(), GRID)
    assert result.common_cells == result.ours.cells == result.tuned.cells == 0
    assert math.isnan(result.agreement)


def test_the_result_is_plain_values():
    result = compare_with_octomap([beams((8, 2, 2), hit=[True])], truth(), GRID).as_dict()
    assert set(result) == {"n_scans", "common_cells", "agreement", "ours", "tuned", "default"}
    assert set(result["ours"]) == {
        "cells", "log_loss", "log_loss_free", "log_loss_occupied", "missed", "not_cleared",
        "accuracy", "milliseconds",
    }  # fmt: skip


def test_no_scans_and_a_truth_of_another_shape_are_rejected():
    scan = beams((8, 2, 2), hit=[True])
    with pytest.raises(ValueError, match="0 scans"):
        compare_with_octomap([], truth(), GRID)
    with pytest.raises(ValueError, match=r"\(3, 3, 3\)"):
        compare_with_octomap([scan], np.zeros((3, 3, 3), bool), GRID)
    with pytest.raises(ValueError, match="3-D grid"):
        compare_with_octomap([scan], np.zeros((4, 5), bool), VoxelGrid((4, 5)))
