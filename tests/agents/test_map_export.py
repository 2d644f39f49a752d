"""The export of trained map networks, and of their ONNX files, as those that ship."""

import json
from dataclasses import replace

import pytest
import torch

from coopmap_agents.map_config import MapNetworkSettings, MapTrainingConfig
from coopmap_agents.map_prediction import MapNetwork, export, library, save_map_network
from coopmap_agents.map_prediction.library import network_file, shipped_seeds
from coopmap_agents.map_prediction.record import new_record
from coopmap_env.core.files import FileError

CONFIG = MapTrainingConfig(
    families=(), scenes=("rooms",), total_steps=2, network=MapNetworkSettings(widths=(4, 6, 8))
)
SCORES = {"log_loss": 0.5, "brier": 0.1, "calibration_error": 0.01}


@pytest.fixture
def shipped(monkeypatch, tmp_path):
    """A folder in place of that of the networks that ship, with one of field maps."""

    def place(package):
        return tmp_path / "package"

    monkeypatch.setattr(library, "files", place)  # what is installed is what is exported to
    path = network_file(3, 0)
    path.parent.mkdir(parents=True)
    network_file(2, 0).parent.mkdir()
    save_map_network(network(MapNetworkSettings(widths=(3, 4, 5), dimension=3)), path)
    network_file(2, 7).write_bytes(b"an older one")
    return tmp_path / "package"


def network(settings, seed=0):
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        return MapNetwork(settings)


def training(folder, config=CONFIG, steps=2):
    """A folder as `run_map_training` leaves it."""
    folder.mkdir()
    save_map_network(network(config.network, config.seed), folder / "map.safetensors")
    row = {"steps": steps, "loss": 0.5, "seconds": 1.0, "validation": {"rooms": SCORES}}
    record = {**new_record(config, "coopmap train-map"), "rows": [row], "best": 0}
    (folder / "training.json").write_text(json.dumps(record))
    return folder


def test_trainings_replace_the_networks_of_their_environment(shipped, tmp_path):
    folders = [training(tmp_path / f"{k}", replace(CONFIG, seed=k)) for k in (2, 0)]
    export.export(shipped / "models", folders)
    names = sorted(str(path.relative_to(shipped / "models")) for path in shipped.rglob("seed_*"))
    assert names == [
        "field/seed_0.onnx", "field/seed_0.safetensors",
        *(f"planar/seed_{k}.{suffix}" for k in (0, 2) for suffix in ("json", "onnx", "safetensors"))
    ]  # fmt: skip
    assert shipped_seeds(2) == [0, 2]
    assert network_file(2, 2).read_bytes() == (folders[0] / "map.safetensors").read_bytes()
    assert json.loads(network_file(2, 0, "json").read_text())["config"]["seed"] == 0
    save_map_network(network(CONFIG.network, 2), tmp_path / "map.onnx")
    assert network_file(2, 2, "onnx").read_bytes() == (tmp_path / "map.onnx").read_bytes()


def test_networks_of_other_seeds_stay_if_their_settings_are_the_same(shipped, tmp_path):
    export.export(
        shipped / "models", [training(tmp_path / f"{k}", replace(CONFIG, seed=k)) for k in (0, 1)]
    )
    export.export(shipped / "models", [training(tmp_path / "2", replace(CONFIG, seed=2))])
    assert shipped_seeds(2) == [0, 1, 2]
    network_file(2, 1, "json").write_text('{"config": 3}')
    export.export(shipped / "models", [training(tmp_path / "again", replace(CONFIG, seed=2))])
    assert shipped_seeds(2) == [0, 2]
    export.export(
        shipped / "models", [training(tmp_path / "other", replace(CONFIG, seed=3, episodes=7))]
    )
    assert shipped_seeds(2) == [3]


def test_what_cannot_be_exported_is_named_and_nothing_is_replaced(shipped, tmp_path):
    first = training(tmp_path / "first")
    for name, config, steps, message in (
        ("short", CONFIG, 1, "short is unfinished: it has not reached 2 steps"),
        ("same", CONFIG, 2, r"the seeds of trainings must differ, got \[0, 0\]"),
        ("other", replace(CONFIG, seed=1, episodes=7), 2, "differ in more than their seeds"),
    ):
        other = training(tmp_path / name, config, steps)
        with pytest.raises(ValueError, match=message):
            export.export(shipped / "models", [first, other])
    (tmp_path / "empty").mkdir()
    with pytest.raises(FileError, match=r"empty/training\.json: there is no such file"):
        export.export(shipped / "models", [tmp_path / "empty"])
    (first / "map.safetensors").write_bytes(b"broken")
    with pytest.raises(FileError, match=r"map\.safetensors was not written by"):
        export.export(shipped / "models", [first])
    assert network_file(2, 7).read_bytes() == b"an older one"
