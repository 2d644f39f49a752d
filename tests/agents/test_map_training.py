"""Trainings of map networks in folders: what they learn, how they resume, and errors."""

import json
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.ndimage import binary_erosion

from coopmap_agents import map_prediction
from coopmap_agents.map_config import (
    USUAL_TRAININGS,
    MapNetworkOptions,
    MapNetworkSettings,
    MapTrainingConfig,
)
from coopmap_agents.map_prediction import (
    PredictiveSurfacePolicy,
    load_map_network,
    run_map_training,
    worlds,
)
from coopmap_agents.map_prediction import training as map_training
from coopmap_agents.map_prediction.examples import MapExamples, cell_weights
from coopmap_agents.map_prediction.record import new_record
from coopmap_agents.map_prediction.training import learning_rate, weighted_loss
from coopmap_agents.map_prediction.worlds import make_world
from coopmap_env.cli import main
from coopmap_env.core.files import FileError
from coopmap_env.core.settings import settings_from_dict
from coopmap_env.core.version import __version__
from coopmap_env.envs.field import FieldEnv, FieldSettings
from coopmap_env.evaluation import rollout

CONFIG = MapTrainingConfig(
    families=("crowded",),
    scenes=("obstacles",),
    total_steps=10,
    segment_steps=4,
    batch_size=4,
    warmup_steps=2,
    network=MapNetworkSettings(widths=(4, 6, 8)),
)


def stripes(n, seed):
    """Worlds of walls across, one cell in five, of which the left half is known."""
    rng = np.random.default_rng(seed)
    occupied = np.zeros((n, 20, 24), dtype=bool)
    for world, first in enumerate(rng.integers(5, size=n)):
        occupied[world, first::5] = True
    images = np.where(occupied, 254, 0).astype(np.uint8)
    images[:, :, 12:] = 255
    weights = [cell_weights(*example) for example in zip(images, occupied, strict=True)]
    return MapExamples(images, occupied, np.stack(weights))


@pytest.fixture
def striped_worlds(monkeypatch):
    """Examples that take no episodes to make; counts how often they are asked for."""
    asked = []

    def examples(name, config, split):
        asked.append((name, split))
        return stripes(24, seed=len(name) + (split == "train"))

    monkeypatch.setattr(map_training, "world_examples", examples)
    return asked


def weights_of(folder):
    return load_map_network(folder / "map.safetensors").state_dict()


def test_a_network_learns_that_walls_go_on(striped_worlds, tmp_path):
    config = replace(CONFIG, total_steps=200, segment_steps=200, learning_rate=1e-2)
    record = run_map_training(config, tmp_path)
    scores = record["rows"][-1]["validation"]["crowded"]
    share = 0.2  # without the map, the best prediction is the share of walls
    blind = -share * np.log(share) - (1 - share) * np.log(1 - share)
    assert scores["log_loss"] < 0.85 * blind
    assert scores["brier"] < 0.85 * share * (1 - share)


def test_an_interrupted_training_ends_as_an_uninterrupted_one(striped_worlds, tmp_path):
    whole = run_map_training(CONFIG, tmp_path / "whole")

    class InterruptionError(Exception):
        pass

    def interrupt(line):
        if "of 10 steps" in line:
            raise InterruptionError

    for _ in range(3):
        with pytest.raises(InterruptionError):
            run_map_training(CONFIG, tmp_path / "parts", interrupt)
    assert len(striped_worlds) == 8  # the examples are kept
    lines = []
    parts = run_map_training(CONFIG, tmp_path / "parts", lines.append)
    assert lines == [f"{tmp_path / 'parts'} is finished: 10 steps"]
    for one, other in zip(whole["rows"], parts["rows"], strict=True):
        assert {**one, "seconds": 0} == {**other, "seconds": 0}
    assert [row["steps"] for row in parts["rows"]] == [4, 8, 10]
    for name, values in weights_of(tmp_path / "whole").items():
        assert (weights_of(tmp_path / "parts")[name] == values).all()
    kept = sorted(path.name for path in (tmp_path / "parts").iterdir())
    assert kept == [
        "checkpoint-3.pt", "examples-crowded-train.npz", "examples-crowded-validation.npz",
        "examples-obstacles-train.npz", "examples-obstacles-validation.npz", "map.onnx",
        "map.safetensors", "training.json",
    ]  # fmt: skip


@pytest.mark.parametrize("when", ["before", "after"])
@pytest.mark.parametrize(
    "name", ["write_arrays", "save_checkpoint", "save_map_network", "_write_record"]
)
def test_a_training_that_is_ended_while_it_writes_goes_on(
    name, when, striped_worlds, tmp_path, monkeypatch
):
    config = replace(CONFIG, scenes=(), total_steps=4, segment_steps=2)
    whole = run_map_training(config, tmp_path / "whole")
    write, calls = getattr(map_training, name), []

    def end(*arguments):
        calls.append(name)
        if len(calls) % 3 != 1:  # the second and the third time, and so on
            return write(*arguments)
        if when == "after":
            write(*arguments)
        raise KeyboardInterrupt

    monkeypatch.setattr(map_training, name, end)
    for _ in range(8):
        try:
            parts = run_map_training(config, tmp_path / "parts")
            break
        except KeyboardInterrupt:
            continue
    assert len(calls) > 1
    for one, other in zip(whole["rows"], parts["rows"], strict=True):
        assert {**one, "seconds": 0} == {**other, "seconds": 0}
    for key, values in weights_of(tmp_path / "whole").items():
        assert (weights_of(tmp_path / "parts")[key] == values).all()
    assert len(list((tmp_path / "parts").glob("checkpoint-*.pt"))) == 1


def test_examples_belong_to_their_training(striped_worlds, tmp_path):
    def interrupt(line):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_map_training(CONFIG, tmp_path, interrupt)
    with pytest.raises(ValueError, match="another training, with seed = 0, not 1"):
        run_map_training(replace(CONFIG, seed=1), tmp_path)
    (tmp_path / "training.json").unlink()
    run_map_training(replace(CONFIG, seed=1, total_steps=1), tmp_path)
    assert striped_worlds.count(("crowded", "train")) == 2


def test_what_cannot_be_learned_from_is_named(striped_worlds, tmp_path):
    with pytest.raises(ValueError, match=r"diverged before 4 steps: choose a .*below 1e\+30"):
        run_map_training(replace(CONFIG, learning_rate=1e30), tmp_path / "a")
    with pytest.raises(ValueError, match=r"shift must be less .* 20 with maps of 20 x 24 cells"):
        run_map_training(replace(CONFIG, shift=20), tmp_path / "b")
    with pytest.raises(ValueError, match="unknown family 'nowhere'"):
        run_map_training(replace(CONFIG, families=("crowded", "nowhere")), tmp_path / "c")
    assert ("nowhere", "train") not in striped_worlds
    assert not (tmp_path / "c").exists()


@pytest.mark.parametrize(
    "change",
    [
        {"images": np.zeros((3, 20), np.uint8)},
        {"images": np.zeros((3, 20, 24), np.float32)},
        {"occupied": np.zeros((2, 20, 24), bool)},
        {"images": np.zeros((0, 20, 24), np.uint8), "occupied": np.zeros((0, 20, 24), bool)},
    ],
)
def test_broken_examples_are_named(change, striped_worlds, tmp_path):
    run_map_training(replace(CONFIG, total_steps=4), tmp_path)
    record = json.loads((tmp_path / "training.json").read_text())
    record["rows"], record["best"] = [], None
    (tmp_path / "training.json").write_text(json.dumps(record))
    path = tmp_path / "examples-crowded-train.npz"
    arrays = dict(np.load(path))
    np.savez(path, **{**arrays, **change})
    with pytest.raises(FileError, match=rf"^{path} is broken: remove it"):
        run_map_training(replace(CONFIG, total_steps=4), tmp_path)


def test_the_training_of_a_policy_and_of_another_version_are_not_called_broken(tmp_path):
    record = {"version": __version__, "config": {"engine": "ppo", "ppo": {}}, "rows": []}
    (tmp_path / "training.json").write_text(json.dumps(record))
    with pytest.raises(ValueError, match="holds the training of a policy: use another folder"):
        run_map_training(CONFIG, tmp_path)
    (tmp_path / "training.json").write_text(json.dumps({"version": "0.0.1", "config": {"a": 1}}))
    with pytest.raises(ValueError, match=r"a training by coopmap '0\.0\.1', this is"):
        run_map_training(CONFIG, tmp_path)


def test_another_training_and_broken_records_are_refused_by_name(striped_worlds, tmp_path):
    run_map_training(CONFIG, tmp_path)
    with pytest.raises(ValueError, match=r"another training, with seed = 0, not 1: use another"):
        run_map_training(replace(CONFIG, seed=1), tmp_path)
    record = json.loads((tmp_path / "training.json").read_text())
    row = record["rows"][0]
    scores = {"log_loss": "a", "brier": 0.0, "calibration_error": 0.0}
    for change in (
        {"rows": [3]}, {"rows": {}}, {"rows": ""}, {"rows": [{"steps": 1}]}, {"best": 7},
        {"best": 1.0}, {"best": None}, {"config": {"seed": -1}}, {"version": None},
        {"rows": [{**row, "validation": {}}]},
        {"rows": [{**row, "validation": {"crowded": scores, "obstacles": scores}}], "best": 0},
    ):  # fmt: skip
        (tmp_path / "training.json").write_text(json.dumps({**record, **change}))
        with pytest.raises(FileError, match=r"training\.json is broken .*remove its folder"):
            run_map_training(CONFIG, tmp_path)


def test_the_learning_rate_rises_and_falls():
    config = MapTrainingConfig(learning_rate=1.0, warmup_steps=4, total_steps=100)
    rates = [learning_rate(config, step) for step in (0, 3, 50, 99)]
    assert rates == pytest.approx([0.25, 0.97, 0.5, 0.01])


def test_the_loss_by_hand():
    logits, occupied = torch.tensor([[0.0, 2.0, 9.0]]), torch.tensor([[1.0, 0.0, 0.0]])
    loss = weighted_loss(logits, occupied, torch.tensor([[1.0, 3.0, 0.0]]))
    assert loss.item() == pytest.approx((np.log(2) + 3 * np.log1p(np.exp(2))) / 4, rel=1e-6)


def test_worlds_are_of_families_and_scenes_of_the_environment():
    env = make_world("obstacles", CONFIG, "validation")
    assert env.split == "validation"
    with pytest.raises(ValueError, match="is of planar worlds, and 'occluded' of field"):
        make_world("occluded", CONFIG, "train")
    with pytest.raises(ValueError, match="unknown family 'nowhere'"):
        make_world("nowhere", CONFIG, "train")
    with pytest.raises(ValueError, match="is of field worlds, and 'crowded' of planar"):
        make_world("crowded", MapTrainingConfig(env_name="field"), "train")
    with pytest.raises(ValueError, match="needs families or scenes"):
        MapTrainingConfig(families=(), scenes=())
    with pytest.raises(ValueError, match=r"network\.dimension must be 3 for field maps, got 2"):
        MapTrainingConfig(env_name="field", network=MapNetworkSettings())


def test_a_network_learns_from_maps_in_space(monkeypatch, tmp_path):
    def examples(name, config, split):
        flat = stripes(6, seed=len(name) + (split == "train"))
        return MapExamples(*(np.repeat(part[..., None], 6, axis=-1) for part in flat))

    monkeypatch.setattr(map_training, "world_examples", examples)
    network = MapNetworkSettings(dimension=3, widths=(3, 4, 5), stride=2)
    config = MapTrainingConfig(
        env_name="field", families=(), scenes=("worksite",), total_steps=4, segment_steps=2,
        network=network,
    )  # fmt: skip
    record = run_map_training(config, tmp_path)
    assert [row["steps"] for row in record["rows"]] == [2, 4]
    assert load_map_network(tmp_path / "map.safetensors").settings == network


def test_options_that_are_left_out_are_those_of_the_environment():
    config = MapTrainingConfig(env_name="field", total_steps=7, episodes=None)
    usual = USUAL_TRAININGS["field"]
    assert (config.total_steps, config.episodes) == (7, usual.episodes)
    assert (config.families, config.network) == (usual.families, usual.network)
    wider = MapTrainingConfig(env_name="field", network=MapNetworkOptions(widths=(8, 8, 8)))
    assert wider.network == MapNetworkSettings(widths=(8, 8, 8), stride=4, dimension=3)
    assert MapTrainingConfig(scenes=()).scenes == ()
    # what is recorded is what was meant, and is read again
    recorded = new_record(config, "")["config"]
    assert recorded["network"] == {"widths": [12, 20, 32], "stride": 4, "dimension": 3}
    assert settings_from_dict(recorded, MapTrainingConfig) == config
    with pytest.raises(ValueError, match="env_name must be one of 'planar', 'field', got 'sea'"):
        MapTrainingConfig(env_name="sea")


def test_the_command_line_has_the_options_of_the_environment(monkeypatch, tmp_path):
    asked = []

    def train(config, out, log, command):
        asked.append(config)
        row = {"steps": 1, "loss": 0.5, "seconds": 1.0, "validation": {"a": {"log_loss": 0.5}}}
        return {"config": {"total_steps": 1}, "rows": [row], "best": 0}

    monkeypatch.setattr(map_prediction, "run_map_training", train)
    main(["train-map", "--env-name", "field", "--out", str(tmp_path)])
    main(["train-map", "--scenes", "--network.stride", "4", "--seed", "1", "--out", str(tmp_path)])
    assert asked[0] == MapTrainingConfig(env_name="field")
    size = MapNetworkSettings(stride=4)
    assert asked[1] == MapTrainingConfig(scenes=(), network=size, seed=1)


SMALL_SCENE = """
grid: {shape: [64, 64, 20], resolution: 0.2, origin: [-6.4, -6.4, -0.35]}
objects:
  - {box: [1.6, 1.2, 1.4], position: [0, 0, 0.7], target: true}
  - {box: [0.8, 2.0, 1.0], position: [1.5, 2, 0.5]}
"""


def test_a_network_learns_from_surface_in_a_small_field_world(monkeypatch, tmp_path):
    pytest.importorskip("pybullet")
    pytest.importorskip("yaml")
    (tmp_path / "boxes.yaml").write_text(SMALL_SCENE)
    settings = FieldSettings(crop_cells=(8, 4), max_grid_poses=243)

    def small_world(name, config, split):
        scene = tmp_path / f"{name}.yaml"
        return FieldEnv(scene=str(scene), max_scans=3, settings=settings, split=split)

    monkeypatch.setattr(worlds, "make_world", small_world)
    monkeypatch.setattr(map_training, "make_world", small_world)
    config = MapTrainingConfig(
        env_name="field", families=(), scenes=("boxes",), episodes=2, validation_episodes=1,
        maps_per_episode=2, total_steps=30, segment_steps=15, batch_size=2, warmup_steps=2,
        network=MapNetworkSettings(widths=(4, 6, 8), stride=4, dimension=3),
    )  # fmt: skip
    record = run_map_training(config, tmp_path / "out")
    occupied = np.load(tmp_path / "out" / "examples-boxes-train.npz")["occupied"]
    assert occupied.shape == (4, 64, 64, 20)
    assert occupied.any()
    assert not binary_erosion(occupied, np.ones((1, 3, 3, 3), bool)).any()  # surface alone
    losses = [row["validation"]["boxes"]["log_loss"] for row in record["rows"]]
    assert losses[1] < losses[0]
    policy = PredictiveSurfacePolicy(tmp_path / "out" / "map.onnx", search=5)
    with closing(small_world("boxes", config, "test")) as env:
        assert len(list(rollout(env, policy, 0))) == 3
