"""Broken policies' files, and those of others: refused by name, before memory is taken."""

import json
import resource

import numpy as np
import pytest
import torch
from plain.fuzz import cases, mutants, read_or_refuse
from safetensors.torch import load_file, save
from tiny_policies import CANDIDATES, POSES, metadata_of, rewrite, tiny_network, tiny_policy_file

from coopmap_agents.config import PPOSettings
from coopmap_agents.networks import parameter_shapes
from coopmap_agents.pretrained import (
    LearnedPolicy,
    load_policy,
    pretrained_path,
    read_metadata,
    save_policy,
)
from coopmap_agents.pretrained.metadata import METADATA_KEY
from coopmap_env.core.files import FileError
from coopmap_env.evaluation import make_policy

NOT_OURS = r"^.*policy\.safetensors was not written by .*"
BOTH = pytest.mark.parametrize("actions", [CANDIDATES, POSES], ids=["candidates", "poses"])


def changed(path, **changes):
    rewrite(path, {**metadata_of(path), **changes})
    return path


def changed_settings(path, **changes):
    return changed(path, ppo={**metadata_of(path)["ppo"], **changes})


def changed_observation(path, name, entry):
    return changed(path, observations={**metadata_of(path)["observations"], name: entry})


@BOTH
@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"hidden": [30000, 30000]}, r"the network has [\d,]+ bytes, more than the limit"),
        ({"hidden": [10**6, 10**6]}, r"the network has [\d,]+ bytes, more than the limit"),
        ({"hidden": [10**12]}, r"PPOSettings\.hidden must be .* <= 1\.04858e\+06"),
        ({"hidden": [8] * 10**4}, r"PPOSettings\.hidden must have 1 to 64 layers, got \("),
        ({"hidden": [2000, 2000]}, r"weights do not belong to the .* has the shape .*, not "),
        ({"image_features": 10**9}, r"PPOSettings\.image_features must be "),
        ({"image_features": 4096}, r"weights do not belong to the .* has the shape .*, not "),
    ],
)
def test_a_network_larger_than_the_file_is_refused_before_it_is_made(
    actions, changes, named, tmp_path
):
    path = changed_settings(tiny_policy_file(tmp_path, actions), **changes)
    with pytest.raises(FileError, match=rf"^{path}: .*{named}"):
        load_policy(path)


@pytest.mark.parametrize(
    ("name", "entry"),
    [
        ("map", ["uint8", 4, 100_000, 100_000]),
        ("map", ["uint8", 10**30, 8, 8]),
        ("teammates", ["float32", 10**10, 4]),
        ("candidates", ["float32", 6, 10**9]),
        ("another", ["float64", 3, 10**8]),
        ("another", ["float32", 20_000_000]),
    ],
)
def test_an_observation_over_the_limit_is_refused_with_its_size(name, entry, tmp_path):
    path = changed_observation(tiny_policy_file(tmp_path), name, entry)
    with pytest.raises(
        FileError, match=NOT_OURS + r"space of a robot's observations has .* cells, more"
    ):
        load_policy(path)


def test_a_refused_network_takes_no_memory_and_draws_no_random_number(tmp_path):
    path = changed_settings(tiny_policy_file(tmp_path), hidden=[5000, 5000])  # 0.8 GB
    state, before_kib = torch.get_rng_state(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(FileError, match="weights do not belong to the"):
        load_policy(path)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss < before_kib + 100_000
    assert torch.equal(torch.get_rng_state(), state)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"observations": []}, r"observations must be a JSON object, got \(\)"),
        ({"observations": {"map": "uint8"}}, r"observations\.map must be a type and a shape"),
        ({"observations": {"map": []}}, r"observations\.map must be a type and a shape"),
        ({"observations": {"map": ["object", 4]}}, r"observations\.map must be .*got \['object'"),
        ({"observations": {"map": ["uint8", -4, 8, 8]}}, r"observations\.map must have sizes abo"),
        ({"observations": {"map": ["uint8", 4.0, 8, 8]}}, r"observations\.map must have sizes abo"),
        ({"observations": {"map": ["uint8", True, 8, 8]}}, r"observations\.map must have sizes a"),
        (
            {"observations": {f"{k}": ["uint8", 1] for k in range(10_000)}},
            "observations must have at most 64 entries",
        ),
        ({"n_candidates": "6"}, r"PolicyMetadata\.n_candidates must be .*, got '6'"),
        ({"n_candidates": 0}, r"PolicyMetadata\.n_candidates must be .*, got 0"),
        ({"n_candidates": 10**30}, r"PolicyMetadata\.n_candidates must be "),
        ({"n_candidates": 10**9}, r"observations\.candidates must be of n_candidates = 1000000000"),
        ({"n_candidates": None}, r"one of n_candidates and action_size .* got None and None"),
        ({"action_size": 3}, r"one of n_candidates and action_size .* got 6 and 3"),
        ({"n_candidates": None, "action_size": 10**10}, r"the action has 10,000,000,000 cells"),
        ({"n_candidates": None, "action_size": 2.5}, r"PolicyMetadata\.action_size must be "),
        ({"ppo": [1]}, r"ppo must be a JSON object, got \(1,\)"),
        ({"training": "none"}, r"training must be a JSON object, got 'none'"),
        ({"version": 3}, r"PolicyMetadata\.version must be str, got 3"),
        ({"owner": "me"}, r"unknown settings \['owner'\]; known are .* of PolicyMetadata"),
    ],
)
def test_metadata_of_another_form_are_refused_with_the_field(changes, named, tmp_path):
    path = changed(tiny_policy_file(tmp_path), **changes)
    with pytest.raises(FileError, match=NOT_OURS + named):
        read_metadata(path)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"hidden": "64"}, r"PPOSettings\.hidden must be a tuple"),
        ({"hidden": []}, r"PPOSettings\.hidden must have 1 to 64 layers, got \(\)"),
        ({"gamma": float("nan")}, r"PPOSettings\.gamma must be "),
        ({"initial_policy": "best"}, r"PPOSettings\.initial_policy must be one of"),
        ({"speed": 3}, r"unknown settings \['speed'\]"),
    ],
)
def test_settings_that_are_none_are_refused_with_the_field(changes, named, tmp_path):
    path = changed_settings(tiny_policy_file(tmp_path), **changes)
    with pytest.raises(FileError, match=rf"^{path}: .*{named}"):
        load_policy(path)


@pytest.mark.parametrize(
    ("name", "entry"),
    [("teammates", ["float32"]), ("a.b", ["uint8", 4, 8, 8]), ("pose", ["float32"])],
)
def test_observations_of_which_no_network_can_be_made_are_refused(name, entry, tmp_path):
    path = changed_observation(tiny_policy_file(tmp_path), name, entry)
    with pytest.raises(FileError, match=f"^{path}: "):
        load_policy(path)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_weights_that_are_not_finite_are_refused_by_name(value, tmp_path):
    path = tiny_policy_file(tmp_path)
    weights = load_file(path)["network.score.weight"]
    weights[0, 3] = value
    rewrite(path, **{"network.score.weight": weights})
    with pytest.raises(FileError, match=rf"^{path}: the weights network\.score\.weight must be fi"):
        LearnedPolicy(path)


@pytest.mark.parametrize("dtype", [torch.float64, torch.float16, torch.int32])
def test_weights_of_another_type_are_refused_by_name(dtype, tmp_path):
    path = tiny_policy_file(tmp_path)
    rewrite(path, **{"network.rating_weight": torch.zeros((), dtype=dtype)})
    with pytest.raises(FileError, match=r"network\.rating_weight must be of type float32, not "):
        load_policy(path)


def test_a_network_with_weights_that_are_not_finite_is_not_written(tmp_path):
    network = tiny_network()
    network.network.rating_weight.data.fill_(float("nan"))
    path = tmp_path / "policy.safetensors"
    with pytest.raises(ValueError, match=rf"^{path} cannot be written: .*rating_weight must be fi"):
        save_policy(network, PPOSettings(hidden=(16, 8), image_features=8), path)
    assert not path.exists()


def test_other_shapes_are_refused_with_both(tmp_path):
    path = tiny_policy_file(tmp_path)
    rewrite(path, **{"network.rating_weight": torch.zeros(3)})
    with pytest.raises(FileError, match=r"network\.rating_weight has the shape \(3,\), not \(\)"):
        load_policy(path)
    rewrite(path, **{"network.rating_weight": torch.zeros(()), "extra": torch.zeros(2)})
    with pytest.raises(FileError, match=r"extra has the shape \(2,\), not None"):
        load_policy(path)


@pytest.mark.parametrize("length", [0, 7, 8, 100, -1])
def test_a_truncated_file_is_refused_by_name(length, tmp_path):
    path = tiny_policy_file(tmp_path)
    path.write_bytes(path.read_bytes()[:length])
    with pytest.raises(FileError, match=NOT_OURS):
        load_policy(path)


def test_a_header_longer_than_the_file_is_refused(tmp_path):
    path = tmp_path / "policy.safetensors"
    path.write_bytes((2**63 - 1).to_bytes(8, "little") + b"{}")
    with pytest.raises(FileError, match=NOT_OURS):
        load_policy(path)


@pytest.mark.parametrize(
    "text", ["[]", "3", "null", '"format"', "{", "[" * 100_000, '{"format": 2}', "9" * 5000]
)
def test_metadata_that_are_no_json_object_are_refused(text, tmp_path):
    path = tiny_policy_file(tmp_path)
    path.write_bytes(save(load_file(path), {METADATA_KEY: text}))
    with pytest.raises(FileError, match=NOT_OURS):
        read_metadata(path)


def test_names_of_no_policy_file_are_told_apart(tmp_path):
    with pytest.raises(ValueError, match=r"model '.*' is a folder: name a file in it, such as pol"):
        make_policy(f"learned:model={tmp_path}")
    for spec in ("learned:model=nobody", "learned:model=3", f"learned:model={'x' * 5000}"):
        with pytest.raises(ValueError, match=r"model .* is neither a file nor one of the pretrain"):
            make_policy(spec)
    with pytest.raises(ValueError, match="learned has no argument 'path'; it takes model"):
        make_policy("learned:path=policy.safetensors")
    for seed in ("True", "1.0", "7", "first", "[0]"):
        with pytest.raises(ValueError, match=r"trained with the seeds \[0, 1, 2\], got "):
            make_policy(f"learned:model=planar-pose+seed={seed}")


def test_a_seed_may_be_any_integer():
    assert pretrained_path("planar-pose", np.int64(1)) == pretrained_path("planar-pose", 1)


@BOTH
def test_finite_weights_that_are_too_large_to_compute_with_are_one_error(actions):
    from coopmap_agents.networks import stack
    from coopmap_agents.pretrained.torch_network import TorchNetwork

    network = tiny_network(actions)
    for values in network.parameters():
        values.data.fill_(-1e38)
    network.observation_space.seed(0)
    rows = stack([network.observation_space.sample()])
    with pytest.raises(ValueError, match="network gives no actions for these observations: Exp"):
        TorchNetwork(network).decide(rows)


def test_the_shapes_of_a_network_are_known_before_it_is_made():
    network = tiny_network()
    shapes = parameter_shapes(
        network.observation_space,
        network.action_space,
        PPOSettings(hidden=(16, 8), image_features=8),
    )
    assert shapes == {name: tuple(one.shape) for name, one in network.named_parameters()}


def test_the_limit_on_a_network_is_raised_by_the_variable(monkeypatch):
    monkeypatch.setenv("COOPMAP_MAX_BYTES", "20000")
    with pytest.raises(
        ValueError, match=r"the network has .* limit of 20,000; .*COOPMAP_MAX_BYTES"
    ):
        tiny_network()
    monkeypatch.setenv("COOPMAP_MAX_BYTES", "50000")
    tiny_network()


@cases(short=300, long=20_000)
def test_a_mutated_policy_file_is_read_or_refused_by_name(n_cases, tmp_path):
    path = tmp_path / "mutant.safetensors"
    originals = []
    for number, actions in enumerate((CANDIDATES, POSES)):
        (tmp_path / str(number)).mkdir()
        content = tiny_policy_file(tmp_path / str(number), actions).read_bytes()
        header_end = 8 + int.from_bytes(content[:8], "little")
        originals += [content, content[: header_end + 8]]
    for mutant in mutants(originals, n_cases):
        path.write_bytes(mutant)
        check_read_or_refused(path)


@cases(short=300, long=20_000)
def test_mutated_metadata_are_read_or_refused_by_name(n_cases, tmp_path):
    """The file around the metadata is whole, so that mutations reach them."""
    files = []
    for number, actions in enumerate((CANDIDATES, POSES)):
        (tmp_path / str(number)).mkdir()
        files.append(tiny_policy_file(tmp_path / str(number), actions))
    weights = [load_file(path) for path in files]
    path = tmp_path / "mutant.safetensors"
    originals = [json.dumps(metadata_of(one)).encode() for one in files]
    for number, mutant in enumerate(mutants(originals, n_cases)):
        text = mutant.decode(errors="replace")
        path.write_bytes(save(weights[number % 2], {METADATA_KEY: text}))
        check_read_or_refused(path)


def check_read_or_refused(path):
    network = read_or_refuse(load_policy, path, FileError)
    if network is not None:
        assert all(values.isfinite().all() for values in network.parameters())
