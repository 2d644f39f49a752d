"""Networks by ONNX Runtime: the numbers and the actions of torch, from the same weights."""

import pickle

import numpy as np
import pytest
import torch
from gymnasium import spaces
from tiny_policies import CANDIDATES, POSES, SETTINGS, observation_space, tiny_network

from coopmap_agents.config import EnvConfig
from coopmap_agents.networks import actor_parameters, make_network
from coopmap_agents.pretrained import (
    LearnedPolicy,
    convert_policy,
    load_policy,
    pretrained_names,
    pretrained_path,
    pretrained_record,
    read_metadata,
    save_policy,
)
from coopmap_agents.pretrained.onnx.network import OnnxNetwork
from coopmap_env.evaluation import evaluate, make_policy

pytest.importorskip("onnxruntime")
FILES = [(name, seed) for name in pretrained_names() for seed in (0, 1, 2)]
each_file = pytest.mark.parametrize(("name", "seed"), FILES)
N_ROBOTS = 3
BOTH = pytest.mark.parametrize("actions", [CANDIDATES, POSES], ids=["candidates", "poses"])


def random_rows(observations, n_teammates, n_candidates, rng):
    """Observations of some robots, of types and shapes such as ["float32", 4] by name."""
    lengths = {
        "teammates": n_teammates, "located": 1 + n_teammates,
        "candidates": n_candidates, "action_mask": n_candidates,
    }  # fmt: skip
    rows = {}
    for key, (dtype, *shape) in observations.items():
        size = (N_ROBOTS, lengths.get(key, shape[0]), *shape[1:])
        if key in ("action_mask", "located"):
            values = rng.random(size) < 0.7
        else:
            values = rng.integers(256, size=size) if dtype == "uint8" else rng.uniform(-1, 1, size)
        rows[key] = values.astype(dtype)
    if n_teammates == 0:
        rows.pop("teammates", None)
    if "action_mask" in rows:
        rows["action_mask"][0] = 0  # of a robot that can go nowhere
        rows["action_mask"][1:, -1] = 1
    return rows


def by_torch(network, rows):
    """Logits with the mask applied, or means."""
    tensors, _ = network.obs_to_tensor(rows)
    with torch.no_grad():
        if "action_mask" not in rows:
            return network.get_distribution(tensors).distribution.mean.numpy()
        logits, _ = network.network(*network._inputs({k: v.float() for k, v in tensors.items()}))
        return np.where(rows["action_mask"] != 0, logits.numpy(), np.float32(-1e8))


def assert_equal_to_torch(network, onnx_network, rows):
    outputs = onnx_network.outputs(rows)
    found = outputs["logits" if "logits" in outputs else "action_mean"]
    # logits reach 45, where float32 numbers are 4e-6 apart
    np.testing.assert_allclose(found, by_torch(network, rows), rtol=2.5e-7, atol=1e-5)
    if "action_log_std" in outputs:
        np.testing.assert_array_equal(outputs["action_log_std"], network.log_std.detach().numpy())
    actions, _ = network.predict(rows, deterministic=True)
    np.testing.assert_allclose(onnx_network.decide(rows), actions, rtol=0, atol=1e-5)


@each_file
def test_the_pretrained_policies_are_those_of_torch(name, seed):
    path = pretrained_path(name, seed, "onnx")
    assert path.stat().st_size < 1_000_000
    network, onnx_network = load_policy(pretrained_path(name, seed)), OnnxNetwork.from_path(path)
    metadata, rng = read_metadata(path), np.random.default_rng(seed)
    assert metadata == read_metadata(pretrained_path(name, seed))
    for n_teammates in (0, 1, 4):
        for n_candidates in (1, 32, 300) if metadata.n_candidates else (1,):
            rows = random_rows(metadata.observations, n_teammates, n_candidates, rng)
            assert_equal_to_torch(network, onnx_network, rows)


@each_file
def test_both_files_of_a_pretrained_policy_have_the_same_weights_and_fingerprint(name, seed):
    paths = [pretrained_path(name, seed, file_format) for file_format in ("safetensors", "onnx")]
    weights, others = (actor_parameters(load_policy(path)) for path in paths)
    assert list(weights) == list(others)
    assert all(torch.equal(weights[key], others[key]) for key in weights)
    by_torch, by_onnx = map(LearnedPolicy, paths)
    for one in ("fingerprint", "n_parameters", "model_bytes"):
        assert getattr(by_torch, one) == getattr(by_onnx, one)


@pytest.mark.parametrize("name", ["planar-candidates", "planar-pose", "field-candidates"])
def test_an_episode_has_the_same_actions(name):
    config = pretrained_record(name)["config"]["env"]
    if config["name"] == "field":
        pytest.importorskip("pybullet")
    env = EnvConfig(config["name"], {**config["arguments"], "max_scans": 4}).make("test")
    found, expected = (
        evaluate(env, make_policy(f"learned:model={model}"), [0]).table
        for model in (pretrained_path(name, file_format="onnx"), name)
    )
    env.close()
    for column in ("coverage", "reward", "motion_distance"):
        np.testing.assert_allclose(found[column], expected[column], rtol=1e-4)


OTHER_SPACES = {
    "two images and a matrix": {
        "map": spaces.Box(0, 255, (3, 5, 9), np.uint8),
        "depth": spaces.Box(0, 255, (2, 12, 7), np.uint8),
        "pose": spaces.Box(-1, 1, (4,), np.float64),
        "arms": spaces.Box(-1, 1, (2, 3), np.float32),
    },
    "located teammates": {
        "pose": spaces.Box(-1, 1, (4,), np.float32),
        "teammates": spaces.Box(-1, 1, (2, 4), np.float32),
        "located": spaces.Box(0, 1, (3,), np.int8),
    },
    "no teammates": {"map": spaces.Box(0, 255, (4, 8, 8), np.uint8)},
}


@BOTH
@pytest.mark.parametrize("parts", OTHER_SPACES.values(), ids=OTHER_SPACES)
def test_other_observations_have_the_same_numbers(parts, actions, tmp_path):
    parts = dict(parts)
    if actions is CANDIDATES:
        given = observation_space(with_candidates=True)
        parts |= {key: given[key] for key in ("candidates", "action_mask")}
    torch.manual_seed(0)
    network = make_network(spaces.Dict(parts), actions, SETTINGS)
    for values in network.parameters():
        values.data.normal_(std=0.3)  # biases are 0 before
    save_policy(network, SETTINGS, tmp_path / "policy.onnx")
    onnx_network = OnnxNetwork.from_path(tmp_path / "policy.onnx")
    observations = read_metadata(tmp_path / "policy.onnx").observations
    for n_teammates, n_candidates in ((0, 6), (1, 1), (4, 20)):
        n_teammates *= "teammates" in parts
        rows = random_rows(observations, n_teammates, n_candidates, np.random.default_rng(0))
        assert_equal_to_torch(network, onnx_network, rows)


@BOTH
def test_a_policy_is_converted_there_and_back(actions, tmp_path):
    path, there, back = (tmp_path / name for name in ("a.safetensors", "b.onnx", "c.safetensors"))
    save_policy(tiny_network(actions), SETTINGS, path, {"steps": 64})
    convert_policy(path, there)
    convert_policy(there, back)
    assert back.read_bytes() == path.read_bytes()
    save_policy(tiny_network(actions), SETTINGS, tmp_path / "direct.onnx", {"steps": 64})
    assert (tmp_path / "direct.onnx").read_bytes() == there.read_bytes()


def test_a_network_can_be_sent_to_another_process(tmp_path):
    save_policy(tiny_network(), SETTINGS, tmp_path / "policy.onnx")
    network = OnnxNetwork.from_path(tmp_path / "policy.onnx")
    observations = read_metadata(tmp_path / "policy.onnx").observations
    rows = random_rows(observations, 1, 6, np.random.default_rng(0))
    sent = pickle.loads(pickle.dumps(network))
    np.testing.assert_array_equal(sent.outputs(rows)["logits"], network.outputs(rows)["logits"])


@BOTH
def test_weights_that_are_too_large_to_compute_with_are_one_error(actions, tmp_path):
    network = tiny_network(actions)
    for values in network.parameters():
        values.data.fill_(-3e38)
    save_policy(network, SETTINGS, tmp_path / "policy.onnx")
    onnx_network = OnnxNetwork.from_path(tmp_path / "policy.onnx")
    observations = read_metadata(tmp_path / "policy.onnx").observations
    rows = random_rows(observations, 1, 6, np.random.default_rng(0))
    with pytest.raises(ValueError, match="network gives no actions for these observations"):
        onnx_network.decide(rows)
