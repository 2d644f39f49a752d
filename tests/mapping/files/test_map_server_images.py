"""Images of map_server's files: each form of a picture gives the cells that nav2 gives."""

import struct

import numpy as np
import pytest
from PIL import Image
from plain.map_server_files import F, U, X, cells, free_cells, map_file, saved_by_map_saver, tiled
from plain.png import COLOUR, GRAY, png

from coopmap_env.mapping.files import MapFileError, load_map

MODES = ("trinary", "scale", "raw")


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


# Sizes


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
