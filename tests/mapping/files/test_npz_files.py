"""NPZ files of maps: every bit comes back, and nothing larger than what they hold is believed."""

import io
import json
import struct
import zipfile

import numpy as np
import pytest
from plain.memory import memory_below
from plain.random_scans import random_scan
from plain.scanned_maps import FIELD_GRID, PLANAR_GRID, scanned_map, state

from coopmap_env.mapping import BeamModel, OccupancyMap, VoxelGrid
from coopmap_env.mapping.files import MapFileError, load_map, save_map
from coopmap_env.sensing import Scan

GRIDS = [pytest.param(PLANAR_GRID, id="2-D"), pytest.param(FIELD_GRID, id="3-D")]


@pytest.mark.parametrize("surface_fusion", ["eq_4", "mean"])
@pytest.mark.parametrize("n_scans", [0, 8])
@pytest.mark.parametrize("grid", GRIDS)
def test_an_npz_file_keeps_every_bit(tmp_path, grid, n_scans, surface_fusion):
    map_ = scanned_map(grid, n_scans, surface_fusion=surface_fusion)
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


def test_a_file_of_version_v0_is_read_as_a_map_of_eq_4(tmp_path):
    """Its settings have neither `behind` nor `surface_fusion`."""
    map_ = scanned_map(PLANAR_GRID)
    save_map(map_, tmp_path / "map.npz")
    settings = json.loads(str(np.load(tmp_path / "map.npz")["settings"]))
    for name in ("behind", "posterior_cutoff", "surface_fusion"):
        del settings["beam"][name]
    with_arrays(tmp_path / "map.npz", settings=np.array(json.dumps(settings)))
    assert state(load_map(tmp_path / "map.npz")) == state(map_)


@pytest.mark.parametrize(
    "arrays",
    [
        {"counts": np.full((1, 1, 1), 0.5)},
        {"counts": np.full((1, 1, 1), np.nan)},
        {"noise": np.zeros((1, 2, 2))},
        {"noise": np.full((1, 2, 2), np.inf)},
        {"sums": np.zeros((1, 3))},
        {"format": np.array("coopmap map 1")},
    ],
)
def test_means_of_no_points_or_without_uncertainty_are_rejected(tmp_path, arrays):
    path = tmp_path / "map.npz"
    map_ = OccupancyMap(VoxelGrid((12, 1)), BeamModel(surface_fusion="mean"))
    point, hit = np.array([[5.0, 0.5]]), np.array([True])
    map_.integrate(Scan(np.array([0.5, 0.5]), point, np.full((1, 2, 2), 0.0), hit))
    save_map(map_, path)
    assert len(load_map(path).hit_cells) == 1
    with_arrays(path, **arrays)
    with pytest.raises(MapFileError, match=r"invertible|shapes|has no member"):
        load_map(path)


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
        ("not 'coopmap map 1' or 'coopmap map 2'", {"format": np.array("other")}),
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
        ("[Ss]ingular|invertible", surfaces([2], 0.0) | SAMPLED),
        ("must be numbers", surfaces([2], 1j) | SAMPLED),
        ("expected a text", {"settings": np.zeros(3)}),
        ("expected a text", {"format": np.array("long" * 99999)}),
        ("is broken", {"levels": np.full(20, None)}),
    ],
)  # fmt: skip
def test_an_npz_file_whose_arrays_make_no_map_is_rejected(tmp_path, message, arrays):
    path = tmp_path / "map.npz"
    save_map(OccupancyMap(VoxelGrid((4, 5))), path)
    with_arrays(path, **arrays)
    with pytest.raises(MapFileError, match=message):
        load_map(path)


def rewritten(content, change):
    """An archive whose members are changed: `change` makes (name, content, ZipInfo) of each."""
    buffer = io.BytesIO()
    with (
        zipfile.ZipFile(io.BytesIO(content)) as old,
        zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as new,
    ):
        for name in old.namelist():
            new.writestr(name, change(name, old.read(name)))
    return buffer.getvalue()


def npy(header, data=b""):
    """An NPY file of a header's text."""
    text = header.encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + data


@pytest.mark.parametrize(
    "header",
    [
        "{'descr': '<i4', 'fortran_order': False, 'shape': (1000000000000,)}",
        "{'descr': '<i4', 'fortran_order': False, 'shape': (99999999999999999999, 0)}",
        "{'descr': '<i4', 'fortran_order': False, 'shape': (-1, -20)}",
        "{'descr': '<i4', 'fortran_order': False, 'shape': (20",  # tokenize.TokenError
        "{'descr': '<U999999999', 'fortran_order': False, 'shape': ()}",
        "{'descr': '|O', 'fortran_order': False, 'shape': (20,)}",
        "{'descr': 'what', 'fortran_order': False, 'shape': (20,)}",
        "{'descr': '<i4', 'shape': (20,)}",
        "(" * 9000,
        "",
    ],
)
def test_a_header_that_does_not_fit_its_data_is_refused_before_memory_is_taken(tmp_path, header):
    path = tmp_path / "map.npz"
    save_map(OccupancyMap(VoxelGrid((4, 5))), path)
    wrong = npy(header, bytes(80))
    path.write_bytes(
        rewritten(path.read_bytes(), lambda name, old: wrong if name == "levels.npy" else old)
    )
    with (
        memory_below(10e6),
        pytest.raises(MapFileError, match=r"levels\.npy is broken") as error,
    ):
        load_map(path)
    assert str(error.value).startswith(f"{path}: ")


def test_a_bomb_is_refused_by_the_sizes_in_its_table_of_contents(tmp_path, monkeypatch):
    path = tmp_path / "map.npz"
    save_map(OccupancyMap(VoxelGrid((1000, 1000))), path)  # 5 MB of zeros
    assert path.stat().st_size < 1e4
    monkeypatch.setenv("COOPMAP_MAX_BYTES", "5000000")
    with pytest.raises(MapFileError, match=r"map\.npz: .*5,00.,... bytes.* COOPMAP_MAX_BYTES"):
        load_map(path)
    monkeypatch.setenv("COOPMAP_MAX_BYTES", "6000000")
    assert load_map(path).grid.shape == (1000, 1000)


def test_settings_of_too_many_cells_are_refused(tmp_path):
    path = tmp_path / "map.npz"
    save_map(OccupancyMap(VoxelGrid((4, 5, 3))), path)
    with np.load(path) as archive:
        settings = str(archive["settings"]).replace("[4, 5, 3]", "[5000, 5000, 5000]")
    with_arrays(path, settings=np.array(settings))
    with pytest.raises(MapFileError, match="125,000,000,000 cells, more than the limit"):
        load_map(path)


@pytest.mark.parametrize("missing", ["format", "settings", "levels", "vectors"])
def test_a_missing_array_is_named(tmp_path, missing):
    path = tmp_path / "map.npz"
    save_map(OccupancyMap(VoxelGrid((4, 5))), path)
    with np.load(path) as archive:
        entries = {name: archive[name] for name in archive.files if name != missing}
    np.savez(path, **entries)
    with pytest.raises(MapFileError, match=rf"map\.npz: has no member {missing}\.npy"):
        load_map(path)
