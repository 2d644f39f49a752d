import numpy as np
import pytest
import yaml

from coopmap_env.mapping.files import write_map_server

MAP = np.array([[0.0, 1.0], [np.nan, 0.5], [0.195, 0.66]])


def test_the_image_is_a_binary_pgm_with_the_largest_y_on_top(tmp_path):
    write_map_server(tmp_path / "map.yaml", MAP, 0.1, (0.0, 0.0))
    content = (tmp_path / "map.pgm").read_bytes()
    assert content == b"P5\n3 2\n255\n" + bytes([0, 205, 0, 254, 205, 254])


def test_the_yaml_file_has_the_fields_that_map_server_asks_for(tmp_path):
    write_map_server(tmp_path / "map.yaml", MAP, np.float32(0.5), (np.float64(1.5), -2))
    assert yaml.safe_load((tmp_path / "map.yaml").read_text()) == {
        "image": "map.pgm",
        "mode": "trinary",
        "resolution": 0.5,
        "origin": [1.5, -2.0, 0.0],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
    }


def test_nothing_but_the_two_files_is_left_and_an_old_map_is_replaced(tmp_path):
    write_map_server(tmp_path / "map.yml", np.zeros((3, 2)), 0.1, (0.0, 0.0))
    write_map_server(tmp_path / "map.yml", MAP, 0.2, (0.0, 0.0))
    assert sorted(file.name for file in tmp_path.iterdir()) == ["map.pgm", "map.yml"]
    assert yaml.safe_load((tmp_path / "map.yml").read_text())["resolution"] == 0.2


def test_a_failed_write_leaves_the_old_file_and_no_remains(tmp_path, monkeypatch):
    write_map_server(tmp_path / "map.yaml", MAP, 0.1, (0.0, 0.0))
    old = (tmp_path / "map.pgm").read_bytes()

    def fail(source, target):
        raise OSError("disk full")

    monkeypatch.setattr("os.replace", fail)
    with pytest.raises(OSError, match="disk full"):
        write_map_server(tmp_path / "map.yaml", MAP[:2], 0.1, (0.0, 0.0))
    assert (tmp_path / "map.pgm").read_bytes() == old
    assert sorted(file.name for file in tmp_path.iterdir()) == ["map.pgm", "map.yaml"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"path_yaml": "map.pgm"}, "must end in .yaml or .yml, not 'map.pgm'"),
        ({"occupancy_probability": np.zeros(3)}, r"\(nx, ny\), not \(3,\)"),
        ({"occupancy_probability": np.array([[0.5, 1.5]])}, "be NaN, not 1.5"),
        ({"occupancy_probability": np.array([[-np.inf, 0.5]])}, "be NaN, not -inf"),
        ({"resolution": 0.0}, "above 0 m, not 0.0"),
        ({"origin": (0.0, np.inf)}, "two finite numbers"),
        ({"origin": (0.0, 0.0, 0.0)}, "two finite numbers"),
    ],
)
def test_a_wrong_argument_is_named_and_nothing_is_written(tmp_path, monkeypatch, change, message):
    monkeypatch.chdir(tmp_path)
    arguments = {
        "path_yaml": "map.yaml",
        "occupancy_probability": MAP,
        "resolution": 0.1,
        "origin": (0.0, 0.0),
    }
    with pytest.raises(ValueError, match=message):
        write_map_server(**(arguments | change))
    assert list(tmp_path.iterdir()) == []
