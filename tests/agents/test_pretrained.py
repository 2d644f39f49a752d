"""The pretrained policies: by name, in their environments, and with their records."""

import json
import subprocess
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from coopmap_agents.config import EnvConfig, PPOSettings, TrainingConfig
from coopmap_agents.pretrained import (
    LearnedPolicy,
    pretrained_names,
    pretrained_path,
    pretrained_record,
    read_metadata,
)
from coopmap_agents.pretrained.export import export
from coopmap_agents.pretrained.metadata import FORMAT
from coopmap_agents.training import run_training
from coopmap_env.cli import parse_command
from coopmap_env.evaluation import evaluate, make_policy
from coopmap_env.studies.benchmark.learning_curves import draw_learning_curves

ROOT = Path(__file__).parents[2]
NAMES = ("field-candidates", "planar-candidates", "planar-candidates-rating", "planar-pose")
each_policy = pytest.mark.parametrize("name", NAMES)


def env_config_of(name, **arguments):
    env_config = pretrained_record(name)["config"]["env"]
    if env_config["name"] == "field":
        pytest.importorskip("pybullet")
    return EnvConfig(
        env_config["name"], {**env_config["arguments"], **arguments}, env_config["settings"]
    )


def test_names_of_the_pretrained_policies():
    assert pretrained_names() == list(NAMES)


@each_policy
def test_the_policy_of_every_training_seed_loads_and_acts(name):
    env = env_config_of(name, max_scans=3).make("test")
    coverage = set()
    for seed in pretrained_record(name)["seeds"]:
        policy = make_policy(f"learned:model={name}+seed={seed}")
        table = evaluate(env, policy, [0]).table
        assert table["n_rejected_actions"][0] < 3
        coverage.add(float(table["coverage"][0]))
    env.close()
    assert len(coverage) > 1  # they are policies of their own


@each_policy
def test_make_policies_trains_it_as_its_record_says(name):
    show = f"show: ; @echo $({name})"
    options = subprocess.check_output(["make", "-s", "--eval", show, "show"], cwd=ROOT, text=True)
    command = parse_command(["train", "--out", "t", *options.split()])
    recorded, settings = (
        pretrained_record(name)["config"],
        json.loads(json.dumps(asdict(command.ppo))),
    )
    assert settings | recorded["ppo"] == settings  # there may be newer ones
    for option in ("engine", "init_from", "imitate", "validation_episodes"):
        assert getattr(command, option) == recorded[option]
    assert command.env_name == recorded["env"]["name"]
    assert command.env_kwargs().items() >= recorded["env"]["arguments"].items()


@each_policy
def test_its_record_has_commands_and_curves_and_names_the_best_seed(name):
    record = pretrained_record(name)
    assert len(record["seeds"]) >= 3
    best = {}
    for seed, training in record["trainings"].items():
        assert f"--seed {seed}" in training["command"]
        rewards = [row["validation"]["reward"] for row in training["rows"]]
        assert max(rewards) == rewards[training["best_row"]]
        best[int(seed)] = max(rewards)
        metadata = read_metadata(pretrained_path(name, int(seed)))
        assert metadata.format == FORMAT
        assert metadata.training["config"]["seed"] == int(seed)
        assert metadata.training["steps"] == training["rows"][training["best_row"]]["steps"]
        assert pretrained_path(name, int(seed)).stat().st_size < 1_000_000
    assert record["best_seed"] == max(best, key=best.get)
    assert pretrained_path(name) == pretrained_path(name, record["best_seed"])


@pytest.mark.parametrize("name", ["planar-candidates", "planar-pose", "field-candidates"])
def test_without_a_name_the_first_that_fits_acts(name):
    env = env_config_of(name, max_scans=2).make("test")
    by_default, by_name = (
        evaluate(env, policy, [0]).table["coverage"][0]
        for policy in (make_policy("learned"), LearnedPolicy(name))
    )
    env.close()
    assert by_default == by_name


def test_observations_that_fit_no_pretrained_policy_are_refused_with_the_choices():
    env = EnvConfig("planar").make("test")
    observations, _ = env.reset(seed=0)
    for own in observations.values():
        own["thermometer"] = np.zeros(1, np.float32)
    with pytest.raises(ValueError, match=r"no pretrained policy fits .*thermometer.*planar-pose"):
        LearnedPolicy().act(env.belief(), observations)


def test_unknown_names_and_seeds_are_refused_with_the_choices():
    with pytest.raises(
        ValueError, match=r"no pretrained policy 'best'; there are .*planar-candidates"
    ):
        pretrained_record("best")
    with pytest.raises(ValueError, match=r"trained with the seeds \[0, 1, 2\], got 7"):
        make_policy("learned:model=planar-candidates+seed=7")


@pytest.fixture(scope="module")
def trainings(tmp_path_factory):
    """Folders of two trainings that differ by their seeds, and of one that differs by more."""
    env_config = EnvConfig(
        "planar", {"action_mode": "candidates", "n_candidates": 6, "max_scans": 4}
    )
    settings = PPOSettings(
        total_steps=32, n_envs=1, rollout_steps=16, batch_size=16, hidden=(8,), image_features=8
    )
    config = TrainingConfig(env=env_config, ppo=settings, seed=0, validation_episodes=1)
    folder = tmp_path_factory.mktemp("trainings")
    for name, one in {
        "0": config,
        "1": replace(config, seed=1),
        "other": replace(config, seed=2, ppo=replace(settings, gamma=0.5)),
    }.items():
        run_training(one, folder / name, command=f"coopmap train --seed {one.seed}")
    return folder


def test_trainings_of_several_seeds_become_a_pretrained_policy(trainings, tmp_path):
    export(tmp_path / "small", [trainings / "0", trainings / "1"])
    files = {path.name for path in (tmp_path / "small").iterdir()}
    assert files == {
        "seed_0.onnx", "seed_0.safetensors", "seed_1.onnx", "seed_1.safetensors", "training.json",
    }  # fmt: skip
    for seed in (0, 1):
        first, second = (
            read_metadata(tmp_path / "small" / f"seed_{seed}{suffix}")
            for suffix in (".safetensors", ".onnx")
        )
        assert first == second
    record = json.loads((tmp_path / "small" / "training.json").read_text())
    assert record["seeds"] == [0, 1]
    assert record["trainings"]["1"]["command"] == "coopmap train --seed 1"
    assert record["config"]["seed"] is None


def test_trainings_that_differ_in_more_than_their_seeds_are_not_exported(trainings, tmp_path):
    with pytest.raises(ValueError, match="differ in more than their seeds"):
        export(tmp_path / "small", [trainings / "0", trainings / "other"])
    with pytest.raises(ValueError, match=r"seeds of trainings must differ, got \[0, 0\]"):
        export(tmp_path / "small", [trainings / "0", trainings / "0"])
    assert not list(tmp_path.iterdir())


def test_the_learning_curves_are_drawn(tmp_path):
    draw_learning_curves(tmp_path / "curves.png")
    assert (tmp_path / "curves.png").read_bytes().startswith(b"\x89PNG")
