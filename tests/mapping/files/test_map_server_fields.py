"""Fields of map_server's files: thresholds as nav2 has them, odd but legal values, paths."""

import os
import warnings

import numpy as np
import pytest
import yaml
from plain.map_server_files import (
    FIELDS,
    F,
    U,
    X,
    cells,
    free_cells,
    map_file,
    saved_by_map_saver,
    tiled,
)

from coopmap_env.mapping.files import MapFileError, load_map, write_map_server
from coopmap_env.simulation.scenes.planar import read_map_server


@pytest.mark.parametrize("negate", [0, False, "0", 0.0, "0.0"])
def test_negate_may_be_written_as_any_reader_of_yaml_reads_it(tmp_path, negate):
    assert cells(map_file(tmp_path, np.array([[0, 255]], np.uint8), negate=negate)) == [[X, F]]


@pytest.mark.parametrize("yaw", [0, -0.0, "0.000000", 1.2e-16, "-4e-8"])
def test_a_yaw_that_rounding_left_is_none(tmp_path, yaw):
    path = map_file(tmp_path, np.array([[0, 255]], np.uint8), origin=[-1.0, 2.0, yaw])
    assert load_map(path).grid.origin == (-1.0, 2.0)


def test_a_file_of_windows_with_a_byte_order_mark_is_read(tmp_path):
    path = map_file(tmp_path, np.array([[0, 255]], np.uint8))
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes().replace(b"\n", b"\r\n"))
    assert cells(path) == [[X, F]]


@pytest.mark.parametrize("image", ['"a\\0b"', '"\\ud800.pgm"', "[map.png]", "7"])
def test_an_image_that_is_no_path_is_named(tmp_path, image):
    path = map_file(tmp_path, np.array([[0, 255]], np.uint8))
    path.write_text(path.read_text().replace("map.png", image))
    with pytest.raises(MapFileError, match="image must be the path of an image, not") as error:
        load_map(path)
    assert str(error.value).isprintable()


def test_an_endless_image_path_is_shortened(tmp_path):
    path = map_file(tmp_path, np.array([[0, 255]], np.uint8))
    path.write_text(path.read_text().replace("map.png", "a" * 10**6))
    with pytest.raises(MapFileError, match="image must name") as error:
        load_map(path)
    assert len(str(error.value)) < 2000


# Thresholds


@pytest.mark.parametrize("mode", ["trinary", "scale"])
def test_a_p_that_equals_a_threshold_is_free_or_occupied(tmp_path, mode):
    # 255 * 0.2 = 51 and 255 * 0.6 = 153
    rows = tiled([[203, 204, 102, 103]]).astype(np.uint8)
    path = map_file(tmp_path, rows, mode=mode, free_thresh=0.2, occupied_thresh=0.6)
    between = [U, U] if mode == "trinary" else [round(52 / 255, 3), round(152 / 255, 3)]
    assert cells(path)[0][:4] == pytest.approx([between[0], F, X, between[1]], abs=1e-3)
    assert free_cells(path) == tiled([[False, True, False, False]]).tolist()


def test_a_speed_limit_map_is_free_where_p_is_0_and_unknown_where_it_is_transparent(tmp_path):
    # p is 0, 0.2, 1, and unknown
    pixels = tiled([[[255, 255], [204, 255], [0, 255], [255, 0]]]).astype(np.uint8)
    path = map_file(tmp_path, pixels, mode="scale", occupied_thresh=1.0, free_thresh=0.0)
    assert cells(path)[0][:4] == pytest.approx([F, 0.2, X, U], abs=1e-3)
    assert free_cells(path) == tiled([[True, False, False, False]]).tolist()


@pytest.mark.parametrize("mode", ["trinary", "scale"])
def test_what_is_written_is_a_world(tmp_path, mode):
    p = np.full((20, 16), 0.0)
    p[3:9, 5], p[1, 1], p[2, 2] = 1.0, np.nan, 0.5
    write_map_server(tmp_path / "map.yaml", p, 0.1, (0.0, 0.0), mode)
    np.testing.assert_array_equal(~read_map_server(tmp_path / "map.yaml").truth.occupied, p == 0)


def test_negate_exchanges_black_and_white_at_the_thresholds_too(tmp_path):
    rows = tiled([[51, 52, 153, 152]]).astype(np.uint8)
    path = map_file(tmp_path, rows, negate=1, free_thresh=0.2, occupied_thresh=0.6)
    assert cells(path)[0][:4] == [F, U, X, U]
    assert free_cells(path) == tiled([[True, False, False, False]]).tolist()


def test_raw_values_of_16_bits_are_rounded_to_8(tmp_path):
    rows = np.array([[100 * 257 + 128, 100 * 257 + 129, 50 * 257 - 100, 0]], np.uint16)
    assert cells(map_file(tmp_path, rows, mode="raw")) == [[X, U, 0.5, F]]


def test_modes_are_read_in_any_case(tmp_path):
    path = map_file(tmp_path, np.array([[0, 127]], np.uint8), mode="Scale")
    assert cells(path) == [[X, pytest.approx(0.502, abs=1e-3)]]


# The surround that map_saver writes as unknown


@pytest.mark.parametrize("read", [load_map, read_map_server])
def test_one_warning_names_free_thresh_and_the_cells_that_it_frees(tmp_path, read):
    path = map_file(tmp_path, saved_by_map_saver(), free_thresh=0.25)
    with pytest.warns(UserWarning, match="free_thresh 0.25 makes 8100 cells free") as warned:
        read(path)
    assert len(warned) == 1
    assert str(warned[0].message).startswith(f"{path}: ")
    with pytest.warns(UserWarning, match="8100"):
        assert np.sum(free_cells(path)) == 8970


@pytest.mark.parametrize(
    "fields",
    [
        {"free_thresh": 0.196},
        {"free_thresh": 0.25, "negate": 1},
        {"free_thresh": 0.25, "mode": "raw"},
    ],
)
def test_no_warning_where_205_stays_unknown(tmp_path, fields):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_map(map_file(tmp_path, saved_by_map_saver(), **fields))


def test_no_warning_for_an_image_with_other_grays_or_without_205(tmp_path):
    other, without = saved_by_map_saver(), saved_by_map_saver()
    other[0, 0], without[without == 205] = 200, 0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_map(map_file(tmp_path, other, free_thresh=0.25))
        load_map(map_file(tmp_path, without, free_thresh=0.25))


# Paths


def test_an_image_lies_beside_its_map_or_where_its_absolute_path_says(tmp_path, monkeypatch):
    (tmp_path / "maps").mkdir()
    (tmp_path / "images").mkdir()
    path = map_file(tmp_path / "maps", np.array([[0, 255]], np.uint8))
    monkeypatch.chdir(tmp_path)
    assert cells("maps/map.yaml") == [[X, F]]
    os.rename(tmp_path / "maps" / "map.png", tmp_path / "images" / "map.png")
    for image in ("../images/map.png", str(tmp_path / "images" / "map.png")):
        path.write_text(yaml.safe_dump(FIELDS | {"image": image}))
        assert cells("maps/map.yaml") == [[X, F]]


@pytest.mark.parametrize("image", ["nowhere.png", ".", "pipe", "/dev/zero", "a" * 300, "map.yaml"])
def test_an_image_that_is_no_file_with_an_image_is_named(tmp_path, image):
    path = map_file(tmp_path, np.array([[0, 255]], np.uint8))
    os.mkfifo(tmp_path / "pipe")
    path.write_text(yaml.safe_dump(FIELDS | {"image": image}))
    with pytest.raises(MapFileError, match=rf"image must name .*{image[:50]}"):
        load_map(path)
