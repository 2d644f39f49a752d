"""OctoMap's files: its own library reads the same voxels, and nothing is lost."""

import sys

import numpy as np
import pytest
from plain.random_scans import random_scan

from coopmap_env.mapping import BeamModel, LogOddsRange, OccupancyMap, VoxelGrid
from coopmap_env.mapping.files import MapFileError, load_map, save_map
from coopmap_env.mapping.files.octomap import octomap_shift

pyoctomap = pytest.importorskip("pyoctomap")
GRID = VoxelGrid((9, 7, 8), 0.25, (0.55, -1.0, -2.1))


@pytest.fixture(scope="module")
def known():
    """A map with every kind of cell: both clamps, sampled at one half, never sampled."""
    rng = np.random.default_rng(0)
    map_ = OccupancyMap(GRID, BeamModel(0.01, 0.97, "partial"), LogOddsRange(0.9995))
    for _ in range(8):
        map_.integrate(random_scan(rng, GRID, 10))
    map_.mark_free([3, 4])
    map_.mark_occupied([5])
    map_.log_odds_fixed[7], map_.sampled_mask[7] = 0, 1
    map_.log_odds_fixed[9], map_.sampled_mask[9] = 1, 1
    assert 0 < map_.observed_fraction < 1
    return map_


def octomap_log_odds(tree, map_):
    """Log-odds of OctoMap's node at each of our cells, NaN where it has none."""
    centers = map_.grid.center(np.indices(map_.grid.shape).reshape(3, -1).T)
    nodes = [tree.search(center) for center in centers - octomap_shift(map_.grid)]
    return np.array([node.getLogOdds() if node else np.nan for node in nodes])


def test_octomap_reads_the_same_voxels_from_an_ot_file(tmp_path, known):
    save_map(known, tmp_path / "map.ot")
    found = octomap_log_odds(pyoctomap.OcTree(0.1).read(str(tmp_path / "map.ot")), known)
    # log-odds are multiples of 2**-10; floats of 24 bits hold them exactly
    sampled = known.sampled.ravel()
    np.testing.assert_array_equal(found[sampled], known.log_odds.ravel()[sampled])
    assert np.isnan(found[~sampled]).all()
    probability = 1 / (1 + np.exp(-found[sampled]))
    np.testing.assert_allclose(probability, known.probability.ravel()[sampled], rtol=1e-12)


def test_an_ot_file_loses_nothing_of_the_occupancy(tmp_path, known):
    save_map(known, tmp_path / "map.ot")
    back = load_map(tmp_path / "map.ot")
    np.testing.assert_array_equal(back.log_odds_fixed, known.log_odds_fixed)
    np.testing.assert_array_equal(back.sampled_mask, known.sampled_mask)
    assert (back.grid, back.model, back.log_odds_range) == (
        known.grid,
        known.model,
        known.log_odds_range,
    )
    assert back.sampled_mask[7] == 1
    assert back.log_odds_fixed[7] == 0


def test_a_bt_file_keeps_which_cells_are_known_and_on_which_side_of_one_half(tmp_path, known):
    save_map(known, tmp_path / "map.bt")
    back = load_map(tmp_path / "map.bt")
    sampled = known.sampled
    np.testing.assert_array_equal(back.sampled, sampled)
    np.testing.assert_array_equal(
        back.log_odds_fixed[sampled.ravel()] > 0, known.log_odds_fixed[sampled.ravel()] >= 0
    )
    assert set(abs(back.log_odds_fixed[sampled.ravel()])) == {known.log_odds_range.clamp}
    tree = pyoctomap.OcTree(0.1)
    assert tree.readBinary(str(tmp_path / "map.bt"))
    found = octomap_log_odds(tree, known)
    np.testing.assert_array_equal(np.isnan(found), ~sampled.ravel())
    np.testing.assert_array_equal(found >= 0, (known.log_odds_fixed >= 0) & sampled.ravel())


def test_files_are_read_without_octomaps_library(tmp_path, known, monkeypatch):
    save_map(known, tmp_path / "map.ot")
    monkeypatch.setitem(sys.modules, "pyoctomap", None)
    back = load_map(tmp_path / "map.ot")
    np.testing.assert_array_equal(back.log_odds_fixed, known.log_odds_fixed)
    with pytest.raises(ImportError, match=r"coopmap\[octomap\]"):
        save_map(known, tmp_path / "other.ot")


@pytest.mark.parametrize("suffix", [".ot", ".bt"])
def test_an_empty_map_comes_back_empty(tmp_path, suffix):
    save_map(OccupancyMap(GRID), tmp_path / f"map{suffix}")
    back = load_map(tmp_path / f"map{suffix}")
    assert back.grid == GRID
    assert not back.sampled.any()


def test_a_tree_of_another_program_fills_the_box_of_its_voxels_pruned_ones_too(tmp_path):
    tree = pyoctomap.OcTree(0.5)
    for key in np.ndindex(2, 2, 2):  # eight equal voxels, which pruning makes one
        for _ in range(20):
            tree.updateNode((np.array(key) * 0.5 + 0.25).tolist(), True)
    tree.updateNode([1.25, -0.25, 0.25], False)
    tree.updateInnerOccupancy()
    assert tree.getNumLeafNodes() == 2
    tree.write(str(tmp_path / "foreign.ot"))
    map_ = load_map(tmp_path / "foreign.ot")
    assert map_.grid == VoxelGrid((3, 3, 2), 0.5, (0.0, -0.5, 0.0))
    assert map_.sampled.sum() == 9
    # OctoMap's clamp 0.971 and its miss 0.4; a level is 1/1024 nat
    assert map_.probability[:2, 1:, :] == pytest.approx(np.full((2, 2, 2), 0.971), abs=1e-3)
    assert map_.probability[2, 0, 0] == pytest.approx(0.4, abs=1e-3)


def broken(content):
    yield "no .ot file", b""
    yield "no .ot file", b"junk" * 50
    yield "no .ot file", content[:60]
    yield "truncated", content[:-7]
    yield "truncated", content + b"\0"
    yield "truncated", content.replace(b"id OcTree", b"id ColorOcTree")
    yield "not of an occupancy tree", content.replace(b"id OcTree", b"id OcTreeBase")
    yield "not of an occupancy tree", content.replace(b"size ", b"size -")
    yield "cells, more than the limit", content.replace(b"size ", b"size 9999999")
    yield "resolution must be finite and > 0", content.replace(b"res 0.25", b"res nan")
    yield "resolution must be finite and > 0", content.replace(b"res 0.25", b"res 0")
    yield "settings are broken", content.replace(b"# coopmap {", b"# coopmap [")
    yield "settings are broken", content.replace(b'"resolution": 0.25', b'"resolution": -1')
    yield "different resolutions", content.replace(b"res 0.25", b"res 0.35")
    yield "limit of 67,108,864", content.replace(b"[9, 7, 8]", b"[9, 7, 80000000]")
    yield "hold 3-D maps", content.replace(b"[9, 7, 8]", b"[9, 7]").replace(b", -2.1]", b"]")
    yield "further from 0", content.replace(b"-2.1]", b"-2.1e300]")
    start = content.index(b"data\n") + len(b"data\n")
    yield "truncated or broken", content[:start] + b"\0" * (len(content) - start)
    yield "more than 16 levels", content[:start] + b"\0\0\0\0\1" * ((len(content) - start) // 5)
    yield "log-odds that are no number", content[:-5] + b"\0\0\xc0\x7f\0"
    yield "log-odds that are no number", content[:-5] + b"\1\0\x80\x7f\0"  # a signalling NaN


def test_broken_files_are_rejected_with_their_name(tmp_path, known):
    save_map(known, tmp_path / "map.ot")
    content = (tmp_path / "map.ot").read_bytes()
    for message, wrong in broken(content):
        assert wrong != content
        (tmp_path / "wrong.ot").write_bytes(wrong)
        with pytest.raises(MapFileError, match=message) as error:
            load_map(tmp_path / "wrong.ot")
        assert str(error.value).startswith(str(tmp_path / "wrong.ot"))


def test_a_truncated_bt_file_is_rejected(tmp_path, known):
    save_map(known, tmp_path / "map.bt")
    (tmp_path / "cut.bt").write_bytes((tmp_path / "map.bt").read_bytes()[:-9])
    with pytest.raises(MapFileError, match=r"cut\.bt: truncated or broken"):
        load_map(tmp_path / "cut.bt")


def test_maps_that_octomap_cannot_hold_are_rejected(tmp_path):
    with pytest.raises(ValueError, match=r"3-D maps, this one is \(4, 5\)"):
        save_map(OccupancyMap(VoxelGrid((4, 5))), tmp_path / "map.ot")
    far = OccupancyMap(VoxelGrid((4, 5, 6), 0.1, (4000.0, 0.0, 0.0)))
    with pytest.raises(ValueError, match="32768 voxels"):
        save_map(far, tmp_path / "map.ot")
    assert list(tmp_path.iterdir()) == []


def random_tree(tree, rng):
    """A tree of free, occupied and pruned voxels on both sides of 0."""
    for point in rng.normal(0, 1.5, (60, 3)):
        tree.updateNode(point.tolist(), bool(rng.random() < 0.6))
    for key in np.ndindex(4, 4, 4):
        for _ in range(20):
            tree.updateNode((np.array(key) * 0.5 + 8.25).tolist(), True)
    tree.updateInnerOccupancy()
    return tree


def expected_map(tree, grid):
    """Log-odds by OctoMap's own search at each cell, NaN where it has no node."""
    centers = grid.center(np.indices(grid.shape).reshape(3, -1).T)
    nodes = [tree.search(center.tolist()) for center in centers]
    return np.array([node.getLogOdds() if node else np.nan for node in nodes])


@pytest.mark.parametrize("tree_type", ["OcTree", "OcTreeStamped", "ColorOcTree"])
@pytest.mark.parametrize("suffix", [".ot", ".bt"])
def test_occupancy_trees_of_every_type_are_read_as_octomap_reads_them(tmp_path, tree_type, suffix):
    tree = random_tree(getattr(pyoctomap, tree_type)(0.5), np.random.default_rng(3))
    if tree_type == "ColorOcTree":
        tree.setNodeColor([8.25, 8.25, 8.25], 255, 0, 3)
    path = tmp_path / f"map{suffix}"
    assert (tree.writeBinary if suffix == ".bt" else tree.write)(str(path))
    map_ = load_map(path)
    expected = expected_map(tree, map_.grid)
    known = np.isfinite(expected)
    assert 0 < known.sum() < known.size
    np.testing.assert_array_equal(map_.sampled.ravel(), known)
    clamp = map_.log_odds_range.clamp
    by_sign, by_value = np.where(expected > 0, clamp, -clamp), np.rint(expected * 1024)
    levels = by_sign if suffix == ".bt" else by_value
    np.testing.assert_array_equal(map_.log_odds_fixed[known], levels[known])


def test_a_header_may_have_comments_and_line_ends_of_windows(tmp_path, known):
    save_map(known, tmp_path / "map.ot")
    head, data = (tmp_path / "map.ot").read_bytes().split(b"\ndata\n")
    head = head.replace(b"\n", b"\r\n# made by hand\r\n")
    (tmp_path / "windows.ot").write_bytes(head + b"\r\ndata\r\n" + data)
    np.testing.assert_array_equal(
        load_map(tmp_path / "windows.ot").log_odds_fixed, known.log_odds_fixed
    )


@pytest.mark.parametrize("suffix", [".ot", ".bt"])
def test_a_resolution_of_more_than_six_digits_comes_back(tmp_path, suffix):
    map_ = OccupancyMap(VoxelGrid((3, 4, 5), 0.12345678))
    map_.mark_occupied([7, 30])
    save_map(map_, tmp_path / f"map{suffix}")
    back = load_map(tmp_path / f"map{suffix}")
    assert back.grid == map_.grid
    np.testing.assert_array_equal(back.log_odds_fixed, map_.log_odds_fixed)


def test_a_tree_whose_box_is_too_large_for_a_dense_map_is_rejected_with_its_size(tmp_path):
    tree = pyoctomap.OcTree(0.1)
    for end in (-1000.0, 1000.0):
        tree.updateNode([end, end, end], True)
    tree.write(str(tmp_path / "wide.ot"))
    with pytest.raises(MapFileError, match=r"wide\.ot: the box of its voxels.* COOPMAP_MAX_CELLS"):
        load_map(tmp_path / "wide.ot")
