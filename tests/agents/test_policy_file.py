import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from plain.small_worlds import masked_world, small_world
from safetensors.torch import load_file, save_file
from vec_envs import shared

import coopmap_env
from coopmap_agents.config import PPOSettings
from coopmap_agents.pretrained import LearnedPolicy, load_policy, read_metadata, save_policy
from coopmap_agents.pretrained.metadata import FORMAT, METADATA_KEY
from coopmap_agents.sb3 import make_model
from coopmap_env.evaluation import evaluate

SMALL = PPOSettings(n_envs=2, rollout_steps=16, batch_size=32, hidden=(16, 8), image_features=8)
BOTH = pytest.mark.parametrize("make_env", [small_world, masked_world])


def model_and_file(make_env, folder, settings=SMALL):
    model = make_model(make_env, settings, seed=0)
    save_policy(model.policy, settings, folder / "policy.safetensors", {"seed": 7})
    return model, folder / "policy.safetensors"


@BOTH
def test_a_loaded_policy_acts_as_the_saved_one(make_env, tmp_path):
    model, path = model_and_file(make_env, tmp_path)
    env = shared(make_env, 4)
    env.seed(0)
    observations = env.reset()
    expected, _ = model.predict(observations, deterministic=True)
    actions, _ = load_policy(path).predict(observations, deterministic=True)
    np.testing.assert_array_equal(actions, expected)
    by_path, by_model = (
        evaluate(make_env(), LearnedPolicy(given), [0, 1]).table["reward"]
        for given in (path, model)
    )
    np.testing.assert_array_equal(by_path, by_model)


@BOTH
def test_the_critic_and_its_state_are_not_saved(make_env, tmp_path):
    central = PPOSettings(n_envs=1, rollout_steps=8, batch_size=8, critic="central")
    model, path = model_and_file(make_env, tmp_path, central)
    assert "state" in model.observation_space.spaces
    assert "state" not in read_metadata(path).observations
    assert not [name for name in load_file(path) if "value" in name or "state" in name]
    assert evaluate(make_env(), LearnedPolicy(path), [0]).table["coverage"][0] > 0


def test_the_metadata_describe_the_file(tmp_path):
    _, path = model_and_file(masked_world, tmp_path)
    metadata = read_metadata(path)
    assert metadata.observations["map"] == ["uint8", 4, 8, 8]
    assert metadata.observations["candidates"] == ["float32", 300, 9]
    assert (metadata.n_candidates, metadata.action_size) == (300, None)
    assert metadata.ppo["image_features"] == 8
    assert metadata.training == {"seed": 7}
    assert (metadata.version, metadata.format) == (coopmap_env.__version__, FORMAT)
    assert [entry.name for entry in tmp_path.iterdir()] == ["policy.safetensors"]


def test_a_file_of_another_format_names_both_versions(tmp_path):
    _, path = model_and_file(small_world, tmp_path)
    metadata = {"version": "9.9.9", "format": FORMAT + 1, "new": 0}
    save_file(load_file(path), path, {METADATA_KEY: json.dumps(metadata)})
    with pytest.raises(
        ValueError, match=rf"written by coopmap 9\.9\.9 in format {FORMAT + 1}, .* train .* again"
    ):
        LearnedPolicy(path)


@pytest.mark.parametrize(
    "content", [b"", b"PK zip of another library", b"\x08" + bytes(7) + b'{"a": 1}']
)
def test_other_files_are_refused(content, tmp_path):
    path = tmp_path / "policy.safetensors"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"policy\.safetensors was not written by"):
        LearnedPolicy(path)


def test_other_safetensors_are_refused(tmp_path):
    save_file({"a": torch.zeros(2)}, tmp_path / "other.safetensors")
    with pytest.raises(ValueError, match="was not written by"):
        load_policy(tmp_path / "other.safetensors")


def test_weights_of_another_network_are_refused_with_the_first_that_differs(tmp_path):
    _, path = model_and_file(masked_world, tmp_path)
    weights = load_file(path) | {"network.rating_weight": torch.zeros(3)}
    save_file(weights, path, {METADATA_KEY: json.dumps(read_metadata(path).__dict__)})
    with pytest.raises(ValueError, match=r"network\.rating_weight has the shape \(3,\), not \(\)"):
        load_policy(path)


def test_another_suffix_is_refused_and_nothing_written(tmp_path):
    model = make_model(small_world, SMALL, seed=0)
    with pytest.raises(ValueError, match=r"must be \.safetensors or \.onnx, got .*policy\.zip"):
        save_policy(model.policy, SMALL, tmp_path / "policy.zip")
    assert not list(tmp_path.iterdir())


def test_a_network_of_other_settings_is_refused_and_nothing_written(tmp_path):
    model = make_model(masked_world, SMALL, seed=0)
    with pytest.raises(ValueError, match="made with other settings"):
        save_policy(model.policy, PPOSettings(), tmp_path / "policy.safetensors")
    assert not list(tmp_path.iterdir())


def test_a_policy_of_another_device_is_loaded_to_the_cpu(tmp_path):
    elsewhere = replace(SMALL, device="cuda")
    model = make_model(small_world, SMALL, seed=0)
    save_policy(model.policy, elsewhere, tmp_path / "policy.safetensors")
    assert load_policy(tmp_path / "policy.safetensors").device.type == "cpu"


def test_a_seed_is_for_pretrained_policies(tmp_path):
    _, path = model_and_file(small_world, tmp_path)
    with pytest.raises(
        ValueError, match=r"seed=1 selects a training of a pretrained policy; .* file"
    ):
        LearnedPolicy(path, seed=1)


def test_an_unknown_name_is_refused():
    with pytest.raises(ValueError, match=r"'nobody' is neither a file nor one of the pretrained"):
        LearnedPolicy("nobody")
