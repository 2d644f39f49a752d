"""Broken ONNX files, and those of others: refused by name, before ONNX Runtime gets them."""

import json
import resource
from dataclasses import replace

import numpy as np
import pytest
from plain.fuzz import cases, mutants, read_or_refuse
from tiny_policies import CANDIDATES, POSES, SETTINGS, tiny_network

from coopmap_agents import model_files
from coopmap_agents.config import PPOSettings
from coopmap_agents.onnx import encoding
from coopmap_agents.onnx.encoding import decode_tensors, encode_model, split_model
from coopmap_agents.pretrained import LearnedPolicy, load_policy, save_policy
from coopmap_agents.pretrained.metadata import FORMAT, METADATA_KEY
from coopmap_agents.pretrained.onnx.file_kind import POLICIES
from coopmap_agents.pretrained.onnx.graph import policy_graph
from coopmap_env.core.files import FileError

NOT_OURS = r"^.*policy\.onnx was not written by .*"
ANOTHER_GRAPH = "its graph is not the one of its metadata"


def read_onnx(path):
    return model_files.read_onnx(path, POLICIES)


@pytest.fixture(scope="module", params=[CANDIDATES, POSES], ids=["candidates", "poses"])
def original(request, tmp_path_factory):
    """A file of a policy."""
    path = tmp_path_factory.mktemp("original") / "policy.onnx"
    save_policy(tiny_network(request.param), SETTINGS, path, {"steps": 64})
    return read_onnx(path)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "policy.onnx"


def metadata_of(file):
    return json.loads(split_model(file.content, METADATA_KEY)[0])


def write(path, file, metadata=None, weights=None, graph=None):
    """Write a file with other metadata, weights or another graph."""
    graph = graph or policy_graph(file.metadata)
    text = split_model(file.content, METADATA_KEY)[0] if metadata is None else json.dumps(metadata)
    path.write_bytes(encode_model(graph, {**file.weights, **(weights or {})}, METADATA_KEY, text))


def test_a_file_that_is_written_again_is_the_same(original, path):
    write(path, original)
    assert path.read_bytes() == original.content
    assert list(read_onnx(path).weights) == list(policy_graph(original.metadata).weights)


@pytest.mark.parametrize("length", [0, 1, 7, 100, 5000, -1])
def test_a_truncated_file_is_refused_by_name(original, length, path):
    path.write_bytes(original.content[:length])
    with pytest.raises(FileError, match=NOT_OURS):
        LearnedPolicy(path)


@pytest.mark.parametrize(
    "content", [b"PK zip", b"\xff" * 1000, b"\x08" * 1000, bytes(1000), b"\x3a" + b"\xff" * 9]
)
def test_other_files_are_refused_by_name(content, path):
    path.write_bytes(content)
    with pytest.raises(FileError, match=NOT_OURS):
        LearnedPolicy(path)


def test_a_missing_file_is_named(path):
    with pytest.raises(ValueError, match=r"policy\.onnx'.* is neither a file nor one of the pre"):
        LearnedPolicy(path)
    with pytest.raises(FileError, match=rf"^{path}: there is no such file"):
        read_onnx(path)


def test_a_seed_is_for_pretrained_policies(original, path):
    write(path, original)
    with pytest.raises(ValueError, match="seed=1 selects a training of a pretrained policy"):
        LearnedPolicy(path, seed=1)


def other_operation(graph):
    graph.nodes[-1] = replace(graph.nodes[-1], operation="Loop")


def one_more_operation(graph):
    graph.add("RandomNormal", shape=(1 << 40,))


def other_order(graph):
    graph.weights = dict(reversed(graph.weights.items()))


def other_output(graph):
    graph.outputs = {name: (*shape, 1) for name, shape in graph.outputs.items()}


def other_attribute(graph):
    k = next(k for k, node in enumerate(graph.nodes) if node.operation == "Conv")
    strides = {**graph.nodes[k].attributes, "strides": (1, 1)}
    graph.nodes[k] = replace(graph.nodes[k], attributes=strides)


def other_constant(graph):
    name = next(name for name, values in graph.constants.items() if values.dtype == np.float32)
    graph.constants[name] = graph.constants[name] + 1


@pytest.mark.parametrize(
    "change",
    [
        other_operation, one_more_operation, other_order, other_output, other_attribute,
        other_constant,
    ],
)  # fmt: skip
def test_another_graph_than_that_of_the_metadata_is_refused(original, change, path):
    graph = policy_graph(original.metadata)
    change(graph)
    write(path, original, graph=graph)
    with pytest.raises(FileError, match=rf"^{path}: {ANOTHER_GRAPH}"):
        LearnedPolicy(path)


def test_weights_in_another_file_are_refused(original, path, monkeypatch):
    """As ONNX has them: field 13 of a tensor is the place, 14 says that it is external."""
    tensor = encoding._tensor

    def external(name, values):
        place = [(1, "location"), (2, "/etc/passwd")]
        return [*tensor(name, values)[:-1], (13, place), (14, 1)]

    with monkeypatch.context() as patch:
        patch.setattr(encoding, "_tensor", external)
        write(path, original)
    with pytest.raises(FileError, match=f"^{path}: "):
        read_onnx(path)

    def both(name, values):
        return [*tensor(name, values), (13, [(1, "location"), (2, "/etc/passwd")]), (14, 1)]

    with monkeypatch.context() as patch:
        patch.setattr(encoding, "_tensor", both)
        write(path, original)
    with pytest.raises(FileError, match=f"^{path}: {ANOTHER_GRAPH}"):
        read_onnx(path)


def test_what_follows_the_file_is_refused(original, path):
    for added in (b"\x08\x08", b"\x72\x00", original.content):
        path.write_bytes(original.content + added)
        with pytest.raises(FileError, match=rf"^{path}(: its graph is not the one| was not)"):
            read_onnx(path)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"hidden": [30000, 30000]}, r"the network has [\d,]+ bytes, more than the limit"),
        ({"hidden": [10**12]}, r"PPOSettings\.hidden must be .* <= 1\.04858e\+06"),
        ({"hidden": [16, 9]}, r"weights do not belong to the .* has the shape .*, not "),
        ({"image_features": 4096}, r"weights do not belong to the .* has the shape .*, not "),
        ({"speed": 3}, r"unknown settings \['speed'\]"),
    ],
)
def test_a_network_of_other_settings_is_refused_before_it_is_made(original, changes, named, path):
    metadata = metadata_of(original)
    write(path, original, {**metadata, "ppo": {**metadata["ppo"], **changes}})
    before_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(FileError, match=rf"^{path}: .*{named}"):
        read_onnx(path)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss < before_kib + 100_000


@pytest.mark.parametrize(
    ("name", "entry", "named"),
    [
        ("map", ["uint8", 4, 10**5, 10**5], r"space of a robot's observations has .* cells, more"),
        ("map", ["object", 4], r"observations\.map must be .*got \['object'"),
        ("teammates", ["float32"], r"observations\.teammates must have 2 sizes, got \[\]"),
        ("located", ["int8", 2, 2], r"observations\.located must have 1 sizes, got \[2, 2\]"),
        ("a.b", ["uint8", 4, 8, 8], r"observations\.a\.b must have a name without \. and /"),
        ("/3", ["float32", 4], r"observations\./3 must have a name without \. and /"),
        ("logits", ["float32", 4], r"observations\.logits has the name of an output or weight"),
        ("depth", ["uint8", 4, 8, 8], r"weights do not belong to the metadata: "),
    ],
)
def test_observations_of_another_network_are_refused(original, name, entry, named, path):
    metadata = metadata_of(original)
    write(path, original, {**metadata, "observations": {**metadata["observations"], name: entry}})
    with pytest.raises(FileError, match=named):
        read_onnx(path)


def test_observations_without_the_robot_or_the_rating_have_no_graph(original):
    observations = original.metadata.observations
    special = {key: values for key, values in observations.items() if key not in ("map", "pose")}
    with pytest.raises(ValueError, match="must have entries of the robot itself"):
        policy_graph(replace(original.metadata, observations=special))
    if original.metadata.n_candidates:
        narrow = {**observations, "candidates": ["float32", 6, 1]}
        with pytest.raises(ValueError, match=r"observations\.candidates must have at least two"):
            policy_graph(replace(original.metadata, observations=narrow))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_weights_that_are_not_finite_are_refused_by_name(original, value, path):
    name = "features_extractor.robot.map.1.bias"
    values = original.weights[name].copy()
    values[3] = value
    write(path, original, weights={name: values})
    with pytest.raises(FileError, match=rf"^{path}: the weights {name} must be finite numbers"):
        LearnedPolicy(path)


def test_weights_of_another_type_or_shape_are_refused_by_name(original, path):
    name = "features_extractor.robot.map.1.bias"
    write(path, original, weights={name: np.zeros(16, np.int64)})
    with pytest.raises(FileError, match=f"the weights {name} must be of type float32, not int64"):
        read_onnx(path)
    write(path, original, weights={name: np.zeros((4, 4), np.float32)})
    with pytest.raises(FileError, match=rf"{name} has the shape \(4, 4\), not \(16,\)"):
        read_onnx(path)


def test_a_file_of_another_format_names_both(original, path):
    write(path, original, {"version": "9.9.9", "format": FORMAT + 1})
    with pytest.raises(FileError, match=rf"written by coopmap 9\.9\.9 in format {FORMAT + 1}, "):
        LearnedPolicy(path)


@pytest.mark.parametrize("metadata", [[], 3, None, {"format": FORMAT}, {"owner": "me"}])
def test_metadata_of_another_form_are_refused(original, metadata, path):
    graph = policy_graph(original.metadata)
    path.write_bytes(encode_model(graph, original.weights, METADATA_KEY, json.dumps(metadata)))
    with pytest.raises(FileError, match=NOT_OURS):
        read_onnx(path)


def test_metadata_under_another_key_are_refused(original, path):
    text = split_model(original.content, METADATA_KEY)[0]
    graph = policy_graph(original.metadata)
    path.write_bytes(encode_model(graph, original.weights, "another", text))
    with pytest.raises(FileError, match=NOT_OURS + "metadata have no entry coopmap"):
        read_onnx(path)


def test_a_network_of_other_settings_is_not_written(path):
    with pytest.raises(ValueError, match="made with other settings"):
        save_policy(tiny_network(), PPOSettings(), path)
    assert not path.exists()


def test_no_more_fields_are_read_than_the_graph_has(original):
    fields = b"\x08\x00" * 1000
    assert decode_tensors(memoryview(fields), 10) == {}
    _, graph = split_model(original.content, METADATA_KEY)
    tensor = decode_tensors(graph, 10_000)
    assert len(decode_tensors(graph, len(graph))) == len(tensor)


@cases(short=300, long=20_000)
def test_a_mutated_file_is_read_or_refused_by_name(original, n_cases, path):
    graph = policy_graph(original.metadata)
    without_weights = {name: np.zeros(0, np.float32) for name in graph.weights}
    text = split_model(original.content, METADATA_KEY)[0]
    short = encode_model(graph, without_weights, METADATA_KEY, text)
    for mutant in mutants([original.content, short], n_cases):
        path.write_bytes(mutant)
        file = read_or_refuse(read_onnx, path, FileError)
        if file is not None:
            assert all(np.isfinite(values).all() for values in file.weights.values())
            assert read_or_refuse(load_policy, path, FileError) is not None
