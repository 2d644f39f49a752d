"""Maps through files: NPZ, PLY and map_server, and the front that chooses."""

import numpy as np
import pytest
import yaml
from PIL import Image
from plain.scanned_maps import scanned_map, state

from coopmap_env.mapping import OccupancyMap, VoxelGrid
from coopmap_env.mapping.files import (
    MapFileError,
    load_map,
    load_surfaces,
    save_map,
    save_map_server,
)


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
    save_map(scanned_map(VoxelGrid((14, 11), 0.5, (-2.0, 1.0))), path)
    content = path.read_bytes()
    for wrong in (b"", b"\xff\x00junk", content[: len(content) // 2], content[:40]):
        path.write_bytes(wrong)
        with pytest.raises(MapFileError, match=name):
            load(path)


def test_a_failed_write_leaves_the_old_file_and_no_remains(tmp_path, monkeypatch):
    map_ = scanned_map(VoxelGrid((14, 11)))
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


@pytest.mark.parametrize("name", ["map.npz", "map.ot", "map.yaml"])
def test_a_map_that_memory_does_not_hold_is_refused_by_name(tmp_path, monkeypatch, name):
    if name == "map.ot":
        pytest.importorskip("pyoctomap")
    save_map(OccupancyMap(VoxelGrid((4, 5, 6) if name == "map.ot" else (4, 5))), tmp_path / name)

    def fail(*arguments):
        raise MemoryError

    monkeypatch.setattr("coopmap_env.mapping.files.base.OccupancyMap", fail)
    monkeypatch.setattr("coopmap_env.mapping.files.map_server.OccupancyMap", fail)
    with pytest.raises(MapFileError) as error:
        load_map(tmp_path / name)
    assert str(error.value).startswith(f"{tmp_path / name}: there is not enough memory")
