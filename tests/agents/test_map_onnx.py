"""Map networks by ONNX Runtime: the predictions and the decisions of torch, from equal weights."""

import json
import pickle
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
import torch
from plain.fuzz import cases, mutants, read_or_refuse

from coopmap_agents import model_files
from coopmap_agents.map_prediction import (
    MapNetwork,
    MapNetworkSettings,
    MapPredictor,
    PredictivePolicy,
    PredictiveSurfacePolicy,
    convert_map_network,
    load_map_network,
    map_image,
    save_map_network,
)
from coopmap_agents.map_prediction.graph import map_graph
from coopmap_agents.map_prediction.library import shipped_path
from coopmap_agents.map_prediction.metadata import MAP_NETWORKS, METADATA_KEY
from coopmap_agents.map_prediction.onnx_network import OnnxMapNetwork
from coopmap_agents.onnx.encoding import encode_model, split_model
from coopmap_env.core.files import FileError
from coopmap_env.envs.field import FieldEnv, FieldSettings
from coopmap_env.envs.planar import PlanarEnv
from coopmap_env.evaluation import make_policy, rollout
from coopmap_env.simulation.scenes.planar import Rooms

pytest.importorskip("onnxruntime")
PLANAR = MapNetworkSettings(widths=(4, 6, 8), stride=2)
FIELD = MapNetworkSettings(widths=(3, 4, 5), stride=4, dimension=3)


def tiny_network(settings=PLANAR, seed=0):
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        return MapNetwork(settings).eval()


def random_images(rng, n, shape):
    """A quarter of the cells are known; others are often so."""
    images = rng.integers(256, size=(n, *shape), dtype=np.uint8)
    images[rng.random(images.shape) < 0.75] = 255
    return images


def assert_equal_to_torch(network, by_onnx, images):
    with torch.no_grad():
        logits = network(torch.from_numpy(images))
    # in 3-D, logits reach -50
    np.testing.assert_allclose(by_onnx.logits(images), logits.numpy(), rtol=1e-5, atol=1e-5)
    expected = logits.sigmoid().numpy()
    np.testing.assert_allclose(by_onnx.probability(images), expected, rtol=0, atol=1e-5)


@pytest.mark.parametrize("stride", [1, 2, 3])
@pytest.mark.parametrize("shapes", [[(1, 1), (7, 13), (40, 48)], [(1, 1, 1), (9, 16, 5)]])
def test_maps_of_any_size_have_the_logits_of_torch(shapes, stride, tmp_path):
    network = tiny_network(replace(PLANAR, stride=stride, dimension=len(shapes[0])))
    save_map_network(network, tmp_path / "map.onnx")
    by_onnx, rng = OnnxMapNetwork.from_path(tmp_path / "map.onnx"), np.random.default_rng(0)
    for n, shape in enumerate(shapes, start=1):
        assert_equal_to_torch(network, by_onnx, random_images(rng, n, shape))


@pytest.mark.parametrize(("dimension", "shape"), [(2, (61, 83)), (3, (40, 33, 21))])
def test_the_networks_that_ship_are_those_of_torch(dimension, shape):
    paths = [shipped_path(dimension, suffix) for suffix in ("safetensors", "onnx")]
    network, by_onnx = load_map_network(paths[0]), OnnxMapNetwork.from_path(paths[1])
    images = random_images(np.random.default_rng(1), 2, shape)
    assert_equal_to_torch(network, by_onnx, images)
    (origin, weights), (other, others) = (
        model_files.read_model(path, MAP_NETWORKS) for path in paths
    )
    assert origin == other
    assert list(others) == list(network.state_dict())
    for name, values in others.items():
        np.testing.assert_array_equal(values, weights[name])
    one, two = (MapPredictor(path, dimension) for path in paths)
    for name in ("fingerprint", "n_parameters", "model_bytes"):
        assert getattr(one, name) == getattr(two, name)
    assert paths[1].stat().st_size < 1_000_000


@pytest.mark.parametrize("settings", [PLANAR, FIELD])
def test_the_graph_has_the_weights_of_the_network(settings):
    needed = {name: tuple(v.shape) for name, v in tiny_network(settings).state_dict().items()}
    assert list(map_graph(settings).weights.items()) == list(needed.items())


def played(env, policy, seed):
    """Maps and actions of an episode."""
    steps = [(map_image(step.belief.map), step.actions) for step in rollout(env, policy, seed)]
    return [image for image, _ in steps], [actions for _, actions in steps]


def assert_decides_as_torch(env, kind, dimension, seeds, **options):
    by_torch, by_onnx = (
        kind(shipped_path(dimension, suffix), **options) for suffix in ("safetensors", "onnx")
    )
    for seed in seeds:
        images, actions = played(env, by_torch, seed)
        assert_equal_to_torch(
            load_map_network(shipped_path(dimension)), by_onnx.predictor.network, np.stack(images)
        )
        for one, other in zip(actions, played(env, by_onnx, seed)[1], strict=True):
            for agent, action in one.items():
                np.testing.assert_array_equal(action, other[agent])


def test_the_same_decisions_follow_on_test_worlds():
    with closing(PlanarEnv(scene=Rooms(), max_scans=4, split="test")) as env:
        assert_decides_as_torch(env, PredictivePolicy, 2, (0, 1), search=100)


def test_the_same_decisions_follow_on_test_worlds_of_the_field():
    pytest.importorskip("pybullet")
    settings = FieldSettings(crop_cells=(8, 4), max_grid_poses=243)
    with closing(FieldEnv(max_scans=2, settings=settings, split="test")) as env:
        assert_decides_as_torch(env, PredictiveSurfacePolicy, 3, (0, 1), search=20)


def test_a_planner_is_given_an_onnx_file_by_its_name(tmp_path):
    path = tmp_path / "map.onnx"
    save_map_network(tiny_network(), path)
    policy = make_policy(f"predictive:model={path}")
    assert isinstance(policy.predictor.network, OnnxMapNetwork)
    assert policy.fingerprint == MapPredictor(tiny_network()).fingerprint
    with pytest.raises(ValueError, match="maps of 3 dimensions is needed, and this one is for 2"):
        make_policy(f"predictive_surface:model={path}")


def test_with_torch_it_predicts_except_for_onnx_files():
    for model, predicts in {
        None: "TorchMapNetwork",
        shipped_path(2): "TorchMapNetwork",
        shipped_path(2, "onnx"): "OnnxMapNetwork",
    }.items():
        assert type(MapPredictor(model).network).__name__ == predicts


def test_a_network_can_be_sent_to_another_process(tmp_path):
    save_map_network(tiny_network(FIELD), tmp_path / "map.onnx")
    network = OnnxMapNetwork.from_path(tmp_path / "map.onnx")
    images = random_images(np.random.default_rng(0), 1, (9, 8, 7))
    sent = pickle.loads(pickle.dumps(network))
    np.testing.assert_array_equal(sent.logits(images), network.logits(images))


@pytest.mark.parametrize("settings", [PLANAR, FIELD])
def test_a_network_is_converted_there_and_back(settings, tmp_path):
    path, there, back = (tmp_path / name for name in ("a.safetensors", "b.onnx", "c.safetensors"))
    save_map_network(tiny_network(settings), path, {"steps": 64})
    convert_map_network(path, there)
    convert_map_network(there, back)
    assert back.read_bytes() == path.read_bytes()
    save_map_network(tiny_network(settings), tmp_path / "direct.onnx", {"steps": 64})
    assert (tmp_path / "direct.onnx").read_bytes() == there.read_bytes()
    with pytest.raises(ValueError, match=r"of a map network must be \.safetensors or \.onnx, got"):
        convert_map_network(path, tmp_path / "map.pt")


def test_weights_that_are_not_finite_are_not_written(tmp_path):
    network = tiny_network()
    network.up[0].bias.data[3] = torch.inf
    for name in ("map.onnx", "map.safetensors"):
        with pytest.raises(ValueError, match=rf"{name} cannot be written: .* up\.0\.bias must be"):
            save_map_network(network, tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_another_graph_than_that_of_the_metadata_is_refused(tmp_path):
    path = tmp_path / "map.onnx"
    save_map_network(tiny_network(), path)
    file = model_files.read_onnx(path, MAP_NETWORKS)
    text, graph = split_model(file.content, METADATA_KEY)[0], map_graph(PLANAR)
    k = next(k for k, node in enumerate(graph.nodes) if node.operation == "Conv")
    attributes = {**graph.nodes[k].attributes, "dilations": (2, 2)}
    graph.nodes[k] = replace(graph.nodes[k], attributes=attributes)
    path.write_bytes(encode_model(graph, file.weights, METADATA_KEY, text))
    with pytest.raises(FileError, match=rf"^{path}: its graph is not .*by `save_map_network`"):
        MapPredictor(path)
    metadata = {**json.loads(text), "network": {"widths": [4, 6, 9], "stride": 2}}
    content = encode_model(map_graph(PLANAR), file.weights, METADATA_KEY, json.dumps(metadata))
    path.write_bytes(content)
    with pytest.raises(FileError, match=rf"^{path}: the weights do not belong to the metadata"):
        MapPredictor(path)


def test_the_file_of_a_policy_is_no_map_network(tmp_path):
    from coopmap_agents.pretrained import pretrained_path

    for suffix in ("onnx", "safetensors"):
        path = pretrained_path("planar-pose", file_format=suffix)
        with pytest.raises(FileError, match="was not written by `coopmap train-map` or `save_map_"):
            MapPredictor(path)


@cases(short=200, long=20_000)
def test_a_mutated_file_is_read_or_refused_by_name(n_cases, tmp_path):
    path = tmp_path / "map.onnx"
    save_map_network(tiny_network(), path)
    for mutant in mutants([path.read_bytes()], n_cases):
        path.write_bytes(mutant)
        file = read_or_refuse(lambda p: model_files.read_onnx(p, MAP_NETWORKS), path, FileError)
        if file is not None:
            assert read_or_refuse(load_map_network, path, FileError) is not None
