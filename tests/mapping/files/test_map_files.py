"""Maps through files: NPZ, PLY and map_server, and the front that chooses."""

import numpy as np
import pytest
import yaml
from PIL import Image
from plain.random_scans import random_scan

from coopmap_env.mapping import BeamModel, LogOddsRange, OccupancyMap, VoxelGrid
from coopmap_env.mapping.files import (
    MapFileError,
    SurfaceEstimates,
    load_map,
    load_surfaces,
    save_map,
    save_map_server,
    save_surfaces,
)

GRIDS = [
    pytest.param(VoxelGrid((14, 11), 0.5, (-2.0, 1.0)), id="2-D"),
    pytest.param(VoxelGrid((9, 7, 8), 0.25, (0.55, -1.0, 2.0)), id="3-D"),
]


def random_map(grid, n_scans=8, seed=0):
    rng = np.random.default_rng(seed)
    map_ = OccupancyMap(grid, BeamModel(0.01, 0.97, "anywhere"), LogOddsRange(0.995))
    for _ in range(n_scans):
        map_.integrate(random_scan(rng, grid, 12))
    map_.log_odds_fixed[7], map_.sampled_mask[7] = 0, 1
    return map_


def state(map_):
    arrays = (map_.log_odds_fixed, map_.sampled_mask, *map_.information_form())
    return [(array.dtype, array.tobytes()) for array in arrays]


@pytest.mark.parametrize("n_scans", [0, 8])
@pytest.mark.parametrize("grid", GRIDS)
def test_an_npz_file_keeps_every_bit(tmp_path, grid, n_scans):
    map_ = random_map(grid, n_scans)
    save_map(map_, tmp_path / "map.npz")
    back = load_map(tmp_path / "map.npz")
    assert state(back) == state(map_)
    assert (back.grid, back.model, back.log_odds_range) == (
        map_.grid,
        map_.model,
        map_.log_odds_range,
    )
    # and goes on as the map itself
    scan = random_scan(np.random.default_rng(1), grid)
    assert back.integrate(scan) == map_.integrate(scan)
    assert state(back) == state(map_)


@pytest.mark.parametrize("ascii_", [False, True])
@pytest.mark.parametrize("grid", GRIDS)
def test_a_ply_file_keeps_every_bit_of_the_surfaces(tmp_path, grid, ascii_):
    map_ = random_map(grid)
    save_surfaces(map_, tmp_path / "map.ply", ascii_)
    back, here = load_surfaces(tmp_path / "map.ply"), SurfaceEstimates.from_map(map_)
    assert len(here.cells) > 5
    np.testing.assert_array_equal(back.cells, here.cells)
    np.testing.assert_array_equal(back.means, here.means)
    np.testing.assert_array_equal(back.probability, here.probability)
    symmetric = 0.5 * (here.covariances + here.covariances.transpose(0, 2, 1))
    np.testing.assert_array_equal(back.covariances, symmetric)


@pytest.mark.parametrize("ascii_", [False, True])
def test_trimesh_reads_points_and_covariances_of_a_ply_file(tmp_path, ascii_):
    trimesh = pytest.importorskip("trimesh")
    map_ = random_map(VoxelGrid((9, 7, 8), 0.25, (0.55, -1.0, 2.0)))
    save_surfaces(map_, tmp_path / "map.ply", ascii_)
    cloud = trimesh.load(tmp_path / "map.ply")
    surfaces = SurfaceEstimates.from_map(map_)
    np.testing.assert_allclose(cloud.vertices, surfaces.means)
    data = cloud.metadata["_ply_raw"]["vertex"]["data"]
    column = data["covariance_xz"] if not ascii_ else np.asarray(data["covariance_xz"])
    np.testing.assert_allclose(np.ravel(column), surfaces.covariances[:, 0, 2], atol=1e-12)


def test_a_map_without_surfaces_is_a_ply_file_without_vertices(tmp_path):
    save_map(OccupancyMap(VoxelGrid((4, 5))), tmp_path / "map.ply")
    assert load_surfaces(tmp_path / "map.ply").means.shape == (0, 2)


def planar():
    """Free, occupied, at one half, undecided and never sampled cells."""
    map_ = OccupancyMap(VoxelGrid((3, 2), 0.5, (-1.0, 2.0)))
    map_.log_odds_fixed[:] = [
        -map_.log_odds_range.clamp,
        map_.log_odds_range.clamp,
        0,
        300,
        0,
        -300,
    ]
    map_.sampled_mask[:] = [1, 1, 1, 1, 0, 1]
    return map_


def test_map_server_trinary_keeps_free_occupied_and_unknown(tmp_path):
    map_ = planar()
    save_map(map_, tmp_path / "map.yaml")
    back = load_map(tmp_path / "map.yaml")
    assert back.grid == map_.grid
    # P of log-odds +-300 is 0.43 and 0.57: between the thresholds of map_saver
    assert back.sampled_mask.tolist() == [1, 1, 0, 0, 0, 0]
    assert back.log_odds_fixed[:2].tolist() == [
        -back.log_odds_range.clamp,
        back.log_odds_range.clamp,
    ]


def test_map_server_scale_keeps_probabilities_to_8_bits(tmp_path):
    map_ = planar()
    save_map_server(map_, tmp_path / "map.yml", "scale")
    back = load_map(tmp_path / "map.yml")
    np.testing.assert_array_equal(back.sampled, map_.sampled)
    np.testing.assert_allclose(back.probability, map_.probability, atol=0.51 / 255)


def image_file(folder, pixels, **fields):
    """A map_server file of an image whose rows run from the largest y down."""
    Image.fromarray(np.array(pixels)).save(folder / "image.png")
    content = {
        "image": "image.png",
        "resolution": 0.5,
        "origin": [0.0, 0.0, 0.0],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
    }
    (folder / "map.yaml").write_text(yaml.safe_dump(content | fields))
    return folder / "map.yaml"


def test_map_server_raw_keeps_percentages_and_not_what_lies_above_100(tmp_path):
    rows = np.array([[0, 50, 100, 101, 255]], dtype=np.uint8)
    map_ = load_map(image_file(tmp_path, rows, mode="raw"))
    assert map_.sampled.ravel().tolist() == [True, True, True, False, False]
    np.testing.assert_allclose(map_.probability.ravel(), [0.001, 0.5, 0.999, 0.5, 0.5], atol=1e-4)


@pytest.mark.parametrize("mode", ["trinary", "scale"])
def test_map_server_reads_8_and_16_bits_alike(tmp_path, mode):
    rows = np.array([[0, 70, 205], [230, 254, 255]], dtype=np.uint8)
    narrow = load_map(image_file(tmp_path, rows, mode=mode))
    wide = load_map(image_file(tmp_path, rows.astype(np.uint16) * 257, mode=mode))
    assert state(wide) == state(narrow)


def test_unknown_suffixes_are_rejected_with_the_list(tmp_path):
    map_ = OccupancyMap(VoxelGrid((4, 5)))
    with pytest.raises(
        ValueError, match=r"\.npz, \.ot, \.bt, \.ply, \.yaml, \.yml, not '.*map\.x'"
    ):
        save_map(map_, tmp_path / "map.x")
    with pytest.raises(ValueError, match=r"\.npz, \.ot, \.bt, \.yaml, \.yml, not"):
        load_map(tmp_path / "map")
    with pytest.raises(ValueError, match="load_surfaces"):
        load_map(tmp_path / "map.ply")
    with pytest.raises(ValueError, match="planar"):
        save_map(OccupancyMap(VoxelGrid((4, 5, 6))), tmp_path / "map.yaml")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["map.npz", "map.ply", "map.yaml"])
def test_missing_truncated_and_foreign_files_are_rejected_by_name(tmp_path, name):
    load = load_surfaces if name.endswith("ply") else load_map
    path = tmp_path / name
    with pytest.raises(MapFileError, match=name):
        load(path)
    save_map(random_map(VoxelGrid((14, 11), 0.5, (-2.0, 1.0))), path)
    content = path.read_bytes()
    for wrong in (b"", b"\xff\x00junk", content[: len(content) // 2], content[:40]):
        path.write_bytes(wrong)
        with pytest.raises(MapFileError, match=name):
            load(path)


def test_a_ply_file_that_lacks_a_vertex_or_a_property_is_rejected(tmp_path):
    path = tmp_path / "map.ply"
    for ascii_ in (False, True):
        save_surfaces(random_map(VoxelGrid((14, 11))), path, ascii_)
        content = path.read_bytes()
        path.write_bytes(content[:-3] if not ascii_ else content.rsplit(b"\n", 2)[0])
        with pytest.raises(MapFileError, match="truncated"):
            load_surfaces(path)
        path.write_bytes(content.replace(b"covariance_xy", b"covariance_no"))
        with pytest.raises(MapFileError, match=r"lacks .*covariance_xy"):
            load_surfaces(path)


def with_arrays(path, **arrays):
    with np.load(path) as archive:
        entries = dict(archive)
    np.savez(path, **{**entries, **arrays})


SAMPLED = {"sampled": np.ones(20, np.uint8)}


def surfaces(cells, scale=1.0):
    k = len(cells)
    return {
        "cells": np.array(cells),
        "precisions": np.tile(scale * np.eye(2), (k, 1, 1)),
        "vectors": np.zeros((k, 2)),
    }


@pytest.mark.parametrize(
    ("message", "arrays"),
    [
        ("not 'coopmap map 1'", {"format": np.array("other")}),
        ("settings are broken", {"settings": np.array("{}")}),
        ("shapes", {"levels": np.zeros(3, np.int32)}),
        (r"log_odds_fixed must lie within \+-", {"levels": np.full(20, 99999, np.int32)}),
        (r"log_odds_fixed must lie within \+-", {"levels": np.full(20, -(2**31), np.int32)}),
        ("sampled must be 0 or 1", {"sampled": np.full(20, 2, np.uint8)}),
        ("must be 0 where sampled is 0", {"levels": np.ones(20, np.int32)}),
        ("must be integers", {"levels": np.zeros(20)}),
        (r"hit cells must lie in \[0, 20\)", surfaces([20])),
        ("distinct and sampled", surfaces([2])),
        ("distinct and sampled", surfaces([2, 2]) | SAMPLED),
        ("finite and invertible", surfaces([2], np.nan) | SAMPLED),
        ("finite and invertible", surfaces([2], -1.0) | SAMPLED),
        ("Singular matrix", surfaces([2], 0.0) | SAMPLED),
        ("must be numbers", surfaces([2], 1j) | SAMPLED),
        ("expected a text", {"settings": np.zeros(3)}),
        ("expected a text", {"format": np.array("long" * 99999)}),
        ("Object arrays|is broken", {"levels": np.full(20, None)}),
    ],
)  # fmt: skip
def test_an_npz_file_whose_arrays_make_no_map_is_rejected(tmp_path, message, arrays):
    path = tmp_path / "map.npz"
    save_map(OccupancyMap(VoxelGrid((4, 5))), path)
    with_arrays(path, **arrays)
    with pytest.raises(MapFileError, match=message):
        load_map(path)


def test_a_failed_write_leaves_the_old_file_and_no_remains(tmp_path, monkeypatch):
    map_ = random_map(VoxelGrid((14, 11)))
    for name in ("map.npz", "map.ply", "map.yaml"):
        save_map(map_, tmp_path / name)
    old = {file.name: file.read_bytes() for file in tmp_path.iterdir()}

    def fail(source, target):
        raise OSError("disk full")

    monkeypatch.setattr("os.replace", fail)
    for name in ("map.npz", "map.ply", "map.yaml"):
        with pytest.raises(OSError, match="disk full"):
            save_map(OccupancyMap(VoxelGrid((3, 3))), tmp_path / name)
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == old
