import numpy as np
import pytest
import yaml
from PIL import Image

from coopmap_env.mapping.files import write_map_server
from coopmap_env.simulation.scenes import SceneError
from coopmap_env.simulation.scenes.planar import read_map_server

FIELDS = {
    "image": "map.pgm",
    "resolution": 0.05,
    "origin": [-1.0, 2.0, 0.0],
    "negate": 0,
    "occupied_thresh": 0.65,
    "free_thresh": 0.196,
}


def write_map(folder, rows, image="map.pgm", without=(), **fields):
    """Write a map of 8 x 9 free pixels whose upper left corner shows `rows`."""
    gray = np.full((9, 8), 0 if fields.get("negate") else 254, dtype=np.uint8)
    if fields.get("mode") == "raw":
        gray[:] = 0
    rows = np.array(rows, dtype=np.uint8)
    gray[: rows.shape[0], : rows.shape[1]] = rows
    Image.fromarray(gray).save(folder / image)
    content = {k: v for k, v in (FIELDS | {"image": image} | fields).items() if k not in without}
    (folder / "map.yaml").write_text(yaml.safe_dump(content))
    return folder / "map.yaml"


def occupied_cells(path, **options):
    occupied = read_map_server(path, **options).truth.occupied
    return set(map(tuple, np.argwhere(occupied).tolist()))


def test_the_top_row_of_the_image_has_the_largest_y(tmp_path):
    path = write_map(tmp_path, [[0, 254, 0]])
    assert occupied_cells(path) == {(0, 8), (2, 8)}


def test_the_scene_takes_shape_resolution_origin_and_name_from_the_file(tmp_path):
    scene = read_map_server(write_map(tmp_path, [[0]]))
    assert (scene.shape, scene.resolution, scene.origin) == ((8, 9), 0.05, (-1.0, 2.0))
    assert scene.name == "map"


def test_a_recorded_world_is_the_same_whatever_the_generator_and_draws_nothing(tmp_path):
    scene = read_map_server(write_map(tmp_path, [[0]]))
    rng = np.random.default_rng(1)
    assert scene.world(rng) is scene.world(np.random.default_rng(2))
    assert rng.random() == np.random.default_rng(1).random()


def test_unknown_counts_as_occupied(tmp_path):
    # p = 1, 50/255 = 0.1961 (just not free), 49/255 = 0.192, 0.
    path = write_map(tmp_path, [[0, 205, 206, 255]])
    assert occupied_cells(path) == {(0, 8), (1, 8)}


@pytest.mark.parametrize("negate", [1, True])
def test_negate_makes_white_occupied(tmp_path, negate):
    path = write_map(tmp_path, [[255, 0, 49, 50]], negate=negate)
    assert occupied_cells(path) == {(0, 8), (3, 8)}


def test_raw_values_are_percentages_and_unknown_above_100(tmp_path):
    path = write_map(tmp_path, [[100, 0, 19, 20, 101, 255]], mode="raw")
    assert occupied_cells(path) == {(0, 8), (3, 8), (4, 8), (5, 8)}


@pytest.mark.parametrize("mode", ["trinary", "scale"])
def test_shades_between_the_thresholds_are_not_free(tmp_path, mode):
    path = write_map(tmp_path, [[0, 127, 254]], mode=mode)
    assert occupied_cells(path) == {(0, 8), (1, 8)}


def test_pixels_that_are_not_opaque_are_unknown(tmp_path):
    path = write_map(tmp_path, [[0]])
    pixels = np.full((9, 8, 4), 255, dtype=np.uint8)
    pixels[0, 1, 3] = 254
    Image.fromarray(pixels).save(tmp_path / "map.png")
    path.write_text(path.read_text().replace("map.pgm", "map.png"))
    assert occupied_cells(path) == {(1, 8)}


def test_plain_and_binary_pgm_png_and_16_bits_read_the_same(tmp_path):
    expected = {(0, 8), (2, 8)}
    path = write_map(tmp_path, [[0, 254, 0]])
    gray = np.asarray(Image.open(tmp_path / "map.pgm")).astype(int)
    plain = "\n".join(" ".join(map(str, row)) for row in gray)
    (tmp_path / "plain.pgm").write_text(f"P2\n# by hand\n8 9\n255\n{plain}\n")
    wide = (gray * 257).astype(np.uint16)
    (tmp_path / "wide.pgm").write_bytes(b"P5 8 9 65535\n" + wide.astype(">u2").tobytes())
    Image.fromarray(wide).save(tmp_path / "wide.png")
    Image.fromarray(gray.astype(np.uint8)).save(tmp_path / "gray.png")
    Image.fromarray(gray.astype(np.uint8)).convert("P").save(tmp_path / "palette.png")
    Image.fromarray(gray.astype(np.uint8)).convert("1").save(tmp_path / "bits.png")
    assert occupied_cells(path) == expected
    for image in ("plain.pgm", "wide.pgm", "wide.png", "gray.png", "palette.png", "bits.png"):
        path.write_text(yaml.safe_dump(FIELDS | {"image": image}))
        assert occupied_cells(path) == expected, image


def test_pooling_keeps_each_wall_and_grows_the_cells(tmp_path):
    gray = np.full((18, 24), 254, dtype=np.uint8)
    gray[17, 0] = gray[0, 23] = gray[8, 9] = 0
    Image.fromarray(gray).save(tmp_path / "map.pgm")
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(FIELDS))
    scene = read_map_server(tmp_path / "map.yaml", pool=2)
    assert scene.shape == (12, 9)
    assert scene.resolution == pytest.approx(0.1)
    assert scene.origin == (-1.0, 2.0)
    # Row 8 is y = 9: block 4.
    assert occupied_cells(tmp_path / "map.yaml", pool=2) == {(0, 0), (11, 8), (4, 4)}


def test_numbers_in_the_notation_of_c_are_numbers(tmp_path):
    path = write_map(tmp_path, [[0]])
    path.write_text(path.read_text().replace("0.05", "5e-2"))
    assert read_map_server(path).resolution == 0.05


@pytest.mark.parametrize("field", FIELDS)
def test_a_missing_field_is_named_with_the_file(tmp_path, field):
    path = write_map(tmp_path, [[0]], without=[field])
    with pytest.raises(SceneError, match=rf"map\.yaml: {field} is missing"):
        read_map_server(path)


@pytest.mark.parametrize(
    ("field", "value", "expected"),
    [
        ("image", 3, "the path of an image"),
        ("image", "", "the path of an image"),
        ("resolution", "fine", "a finite number of metres above 0"),
        ("resolution", True, "a finite number of metres above 0"),
        ("resolution", float("nan"), "a finite number of metres above 0"),
        ("resolution", float("inf"), "a finite number of metres above 0"),
        ("resolution", -0.05, "a finite number of metres above 0"),
        ("resolution", [0.05], "a finite number of metres above 0"),
        ("origin", [0.0, 0.0], "three finite numbers"),
        ("origin", 0.0, "three finite numbers"),
        ("origin", [0.0, float("nan"), 0.0], "three finite numbers"),
        ("origin", [0.0, None, 0.0], "three finite numbers"),
        ("origin", [0.0, 0.0, 0.1], "without yaw"),
        ("negate", 2, "0 or 1"),
        ("negate", "no way", "0 or 1"),
        ("occupied_thresh", 1.1, r"a number in \[0, 1\]"),
        ("free_thresh", -0.1, r"a number in \[0, 1\]"),
        ("free_thresh", float("nan"), r"a number in \[0, 1\]"),
        ("mode", "binary", "one of trinary, scale, raw"),
    ],
)
def test_a_wrong_field_is_named_with_its_value_and_what_was_expected(
    tmp_path, field, value, expected
):
    path = write_map(tmp_path, [[0]])
    path.write_text(yaml.safe_dump(FIELDS | {field: value}))
    with pytest.raises(SceneError, match=rf"map\.yaml: {field} must be {expected}") as error:
        read_map_server(path)
    assert str(error.value).endswith(f"not {value!r}")


def test_thresholds_in_the_wrong_order_are_named(tmp_path):
    path = write_map(tmp_path, [[0]], free_thresh=0.7)
    with pytest.raises(SceneError, match=r"free_thresh .* occupied_thresh \(0.65\), not 0.7"):
        read_map_server(path)


def test_raw_with_negate_is_an_error_because_its_readers_disagree(tmp_path):
    with pytest.raises(SceneError, match="negate must be 0 in mode raw"):
        read_map_server(write_map(tmp_path, [[0]], mode="raw", negate=1))


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(SceneError, match=r"nowhere\.yaml: there is no such file"):
        read_map_server(tmp_path / "nowhere.yaml")


@pytest.mark.parametrize(
    "content", [b"image: [", b"\xff\xfe\x00", b"- a list", b"", b"day: 2001-99-99", b"[" * 9999]
)
def test_a_file_that_is_no_yaml_mapping_is_named(tmp_path, content):
    (tmp_path / "bad.yaml").write_bytes(content)
    with pytest.raises(SceneError, match=r"bad\.yaml(, line 1)?: "):
        read_map_server(tmp_path / "bad.yaml")


@pytest.mark.parametrize(
    "content", [None, b"", b"no image", b"P5 8 9 255\n123", b"P2 8 9 255\n1 2 x", b"P5 8"]
)
def test_an_image_that_is_missing_or_unreadable_is_named(tmp_path, content):
    path = write_map(tmp_path, [[0]])
    (tmp_path / "map.pgm").unlink()
    if content is not None:
        (tmp_path / "map.pgm").write_bytes(content)
    with pytest.raises(SceneError, match=r"map\.yaml: image must name .*map\.pgm"):
        read_map_server(path)


def test_an_image_without_free_cell_is_named(tmp_path):
    path = write_map(tmp_path, np.zeros((9, 8)))
    with pytest.raises(SceneError, match=r"map\.yaml: image .*map\.pgm.* no free cell"):
        read_map_server(path)


def test_an_image_that_pooling_makes_too_small_is_named(tmp_path):
    with pytest.raises(SceneError, match=r"8 x 8 cells, not \(4, 5\)"):
        read_map_server(write_map(tmp_path, [[0]]), pool=2)


@pytest.mark.parametrize("pool", [0, -1, 1.5, True])
def test_a_wrong_pool_is_named(tmp_path, pool):
    with pytest.raises(ValueError, match=f"pool must be an integer >= 1, got {pool!r}"):
        read_map_server(write_map(tmp_path, [[0]]), pool=pool)


def test_what_was_saved_reads_back(tmp_path):
    probability = np.random.default_rng(0).random((12, 9))
    probability[0, 0], probability[3, 4] = np.nan, 0.5
    write_map_server(tmp_path / "saved.yaml", probability, 0.1, (-3.0, 4.5))
    scene = read_map_server(tmp_path / "saved.yaml")
    np.testing.assert_array_equal(~scene.truth.occupied, probability < 0.196)
    assert (scene.resolution, scene.origin, scene.name) == (0.1, (-3.0, 4.5), "saved")
