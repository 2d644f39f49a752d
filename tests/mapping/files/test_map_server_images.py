"""Images of map_server's files: each form of a picture gives the cells that nav2 gives."""

import os
import struct
import warnings

import numpy as np
import pytest
import yaml
from PIL import Image
from plain.png import COLOUR, GRAY, png

from coopmap_env.mapping.files import MapFileError, load_map, write_map_server
from coopmap_env.simulation.scenes.planar import read_map_server

FIELDS = {
    "image": "map.png",
    "resolution": 0.5,
    "origin": [-1.0, 2.0, 0.0],
    "negate": 0,
    "occupied_thresh": 0.65,
    "free_thresh": 0.196,
}
MODES = ("trinary", "scale", "raw")
F, U, X = -1, 0, 1
"""Free, unknown, occupied."""


def map_file(folder, content, image="map.png", **fields):
    """A map_server file of an image: its bytes, or pixels from the largest y down."""
    if isinstance(content, bytes):
        (folder / image).write_bytes(content)
    else:
        Image.fromarray(np.array(content)).save(folder / image)
    (folder / "map.yaml").write_text(yaml.safe_dump(FIELDS | {"image": image} | fields))
    return folder / "map.yaml"


def cells(path):
    """Cells of the map as in the image: `F`, `U`, `X`, or the probability where it is between."""
    map_ = load_map(path)
    p = np.where(map_.sampled, map_.probability, np.nan)
    certain = abs(map_.log_odds_fixed.reshape(p.shape)) == map_.log_odds_range.clamp
    values = np.where(certain, np.sign(map_.log_odds_fixed.reshape(p.shape)), p)
    return np.where(np.isnan(p), U, values).T[::-1].round(3).tolist()


def tiled(pixels):
    """The same pixels 8 x 8 times: no world is smaller than 8 x 8 cells."""
    pixels = np.array(pixels)
    return np.tile(pixels, (8, 8) + (1,) * (pixels.ndim - 2))


def free_cells(path):
    """Which cells are free in the world of the same file."""
    return (~read_map_server(path).truth.occupied.T[::-1]).tolist()


def same_map(a, b):
    return (
        a.log_odds_fixed.tobytes() == b.log_odds_fixed.tobytes()
        and a.sampled_mask.tobytes() == b.sampled_mask.tobytes()
    )


def wide_png(gray):
    rows = [row.astype(">u2").tobytes() for row in gray.astype(np.uint16) * 257]
    return png(gray.shape[1], gray.shape[0], 16, GRAY, rows)


def wide_pgm(gray):
    pixels = (gray.astype(np.uint16) * 257).astype(">u2").tobytes()
    return b"P5\n%d %d\n65535\n" % gray.shape[::-1] + pixels


def plain_pgm(gray):
    text = "\n".join(" ".join(map(str, row)) for row in gray.tolist())
    return f"P2 # by hand\n{gray.shape[1]} {gray.shape[0]}\n255\n{text} # the end".encode()


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("encode", [wide_png, wide_pgm, plain_pgm])
def test_16_bits_and_text_give_the_cells_of_8_bits(tmp_path, mode, encode):
    gray = np.arange(256, dtype=np.uint8).reshape(16, 16)
    path = map_file(tmp_path, gray, mode=mode)
    map_, free = load_map(path), free_cells(path)
    assert 0 < np.sum(free) < 256
    map_file(tmp_path, encode(gray), mode=mode)
    assert same_map(load_map(path), map_)
    assert free_cells(path) == free


def test_a_wall_of_16_bits_is_a_wall(tmp_path):
    # 10 * 257: clipped to 255, it would be free
    assert cells(map_file(tmp_path, np.array([[2570, 65535]], np.uint16))) == [[X, F]]


COLOURS = {
    (0, 255, 0): X,  # mean 85, p 0.667
    (255, 0, 0): X,
    (0, 0, 255): X,
    (255, 255, 0): U,  # mean 170, p 0.333
    (255, 255, 100): U,  # mean 203.3, p 0.203
    (190, 190, 255): F,  # mean 211.7, p 0.170
    (0, 0, 0): X,
    (254, 254, 254): F,
}


@pytest.mark.parametrize("image", ["map.png", "map.ppm", "map.bmp"])
def test_a_colour_has_the_mean_of_its_channels(tmp_path, image):
    pixels = tiled([list(COLOURS)]).astype(np.uint8)
    path = map_file(tmp_path, pixels, image)
    assert cells(path) == tiled([list(COLOURS.values())]).tolist()
    assert free_cells(path) == (tiled([list(COLOURS.values())]) == F).tolist()


def test_a_palette_has_the_colours_that_it_names(tmp_path):
    image = Image.fromarray(tiled([list(COLOURS)]).astype(np.uint8))
    image.quantize(len(COLOURS)).save(tmp_path / "palette.png")
    image.quantize(len(COLOURS)).save(tmp_path / "palette.gif")
    for name in ("palette.png", "palette.gif"):
        path = map_file(tmp_path, (tmp_path / name).read_bytes(), name)
        assert cells(path) == tiled([list(COLOURS.values())]).tolist(), name


def test_one_bit_is_black_or_white(tmp_path):
    assert cells(map_file(tmp_path, [[False, True]])) == [[X, F]]
    assert cells(map_file(tmp_path, b"P4\n2 1\n\x80", "map.pbm")) == [[X, F]]
    assert cells(map_file(tmp_path, b"P1\n2 1\n1 0", "map.pbm")) == [[X, F]]


@pytest.mark.parametrize("mode", MODES)
def test_what_is_not_opaque_is_unknown_in_every_form_of_transparency(tmp_path, mode):
    white = 0 if mode == "raw" else 255
    rgba = np.full((8, 8, 4), white, np.uint8)
    rgba[..., 3] = 255
    rgba[0, :3, 3] = [0, 1, 254]
    expected = np.full((8, 8), F)
    expected[0, :3] = U
    for name in ("RGBA", "LA"):
        Image.fromarray(rgba).convert(name).save(tmp_path / "pixels.png")
        path = map_file(tmp_path, (tmp_path / "pixels.png").read_bytes(), mode=mode)
        assert cells(path) == expected.tolist(), name
        assert free_cells(path) == (expected == F).tolist(), name


# a white pixel that is transparent, a black one and a nearly white one
TRANSPARENT = {
    "1 bit": png(2, 1, 1, GRAY, [b"\x80"], struct.pack(">H", 1)),
    "2 bits": png(2, 1, 2, GRAY, [b"\xc0"], struct.pack(">H", 3)),
    "4 bits": png(2, 1, 4, GRAY, [b"\xf0"], struct.pack(">H", 15)),
    "8 bits": png(2, 1, 8, GRAY, [b"\xff\x00"], struct.pack(">H", 255)),
    "16 bits": png(2, 1, 16, GRAY, [b"\xff\xfe\x00\x00"], struct.pack(">H", 0xFFFE)),
    "colour": png(2, 1, 8, COLOUR, [b"\xff" * 3 + b"\0" * 3], struct.pack(">HHH", *[255] * 3)),
    "16-bit colour": png(
        2, 1, 16, COLOUR, [b"\xff" * 6 + b"\0" * 6], struct.pack(">HHH", *[65535] * 3)
    ),
}


@pytest.mark.parametrize("form", TRANSPARENT)
def test_a_gray_value_or_colour_that_a_png_calls_transparent_is_unknown(tmp_path, form):
    assert cells(map_file(tmp_path, TRANSPARENT[form])) == [[U, X]]


@pytest.mark.parametrize(
    "content",
    [
        b"P5 4 1 100\n\x00\x50\x51\x64",
        b"P2\n# CREATOR: somebody\n4 1\n# 100 percent\n100\n0 80\n81 100\n",
        b"P5\n4 1\n1000\n" + struct.pack(">4H", 0, 800, 810, 1000),
        b"P2 4 1 1000 0 800 810 1000",
        b"P6 4 1 100\n" + bytes(np.repeat([0, 80, 81, 100], 3).tolist()),
        b"P3 4 1 100\n0 0 0 80 80 80 81 81 81 100 100 100",
        b"P5\r\n4 1\r\n100\r\n\x00\x50\x51\x64",
        b"P5 4 1 100\n\x00\x50\x51\x64 and what follows",
    ],
)
def test_the_largest_value_of_a_pgm_is_white(tmp_path, content):
    # p is 1, 0.2, 0.19 and 0
    assert cells(map_file(tmp_path, content, "map.pgm")) == [[X, U, F, F]]
    path = map_file(tmp_path, content, "map.pgm", free_thresh=0.0)
    assert cells(path) == [[X, U, U, F]]
    path = map_file(tmp_path, content, "map.pgm", free_thresh=0.2)
    assert cells(path) == [[X, F, F, F]]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"P5 2 1 100\n\x00", "buffer is smaller"),
        (b"P5 2 1 100\n\x00\x65", "value 101, more than the largest, 100"),
        (b"P2 2 1 100\n0 101", "value 101, more than the largest, 100"),
        (b"P2 2 1 100\n0", "2 pixels, got fewer"),
        (b"P2 2 1 100\n0 -1", "numbers as text"),
        (b"P2 2 1 100\n0 1e2", "numbers as text"),
        (b"P5 2 0 255\n", "2 x 0 pixels"),
        (b"P5 2 1 0\n\0\0", "at most 0"),
        (b"P5 2 1 65536\n\0\0\0\0", "at most 65536"),
        (b"P5 -2 1 255\n\0\0", "broken image"),
        (b"Pf\n2 1\n-1.0\n" + bytes(8), "not floats"),
        (b"%!PS-Adobe-3.0 EPSF-3.0\n", "expected an image of format PGM, PNG"),
        (b"", "expected an image of format PGM, PNG"),
        (b"\x89PNG\r\n\x1a\n", "broken image"),
        (TRANSPARENT["8 bits"][:-30], "broken image"),
        (b"BM", "broken image"),
        (b"GIF89a", "broken image"),
        (b"\xff\xd8\xff", "broken image"),
    ],
)
def test_a_broken_image_is_named_with_its_map(tmp_path, content, message):
    path = map_file(tmp_path, content, "map.pgm")
    with pytest.raises(MapFileError, match=message) as error:
        load_map(path)
    assert str(error.value).startswith(f"{path}: image must name a readable PGM or PNG file, not")
    assert "map.pgm" in str(error.value)


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


def saved_by_map_saver():
    rows = np.full((100, 90), 205, np.uint8)
    rows[30:60, 30:60] = 254
    rows[30, 30:60] = 0
    return rows


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


# Sizes and paths


@pytest.mark.parametrize(
    "content",
    [
        png(13000, 13000, 8, GRAY, [bytes(20)]),
        b"P5 13000 13000 255\n",
        b"P2 13000 13000 255\n1 ",
        b"P4 13000 13000\n1",
        b"BM" + struct.pack("<IIIIiiHH24x", 54, 0, 54, 40, 13000, 13000, 1, 8),
        b"GIF89a" + struct.pack("<HHxxxcxxxxHHxxxx", 13000, 13000, b",", 13000, 13000),
    ],
)
def test_an_image_with_too_many_pixels_is_refused_by_its_header(tmp_path, content):
    path = map_file(tmp_path, content)
    with pytest.raises(MapFileError, match=r"169,000,000 cells.* COOPMAP_MAX_CELLS raises it"):
        load_map(path)


def test_the_limit_of_pixels_is_set_by_a_variable(tmp_path, monkeypatch):
    path = map_file(tmp_path, saved_by_map_saver())
    monkeypatch.setenv("COOPMAP_MAX_CELLS", "8999")
    with pytest.raises(MapFileError, match="9,000 cells, more than the limit of 8,999"):
        load_map(path)
    monkeypatch.setenv("COOPMAP_MAX_CELLS", "9000")
    assert load_map(path).grid.shape == (90, 100)


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
