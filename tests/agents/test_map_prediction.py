"""The network that predicts unknown cells, its files and examples, and its planner."""

import json
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
import torch
from plain.fuzz import cases, mutants, read_or_refuse
from plain.random_maps import random_map, set_cells
from safetensors.torch import load_file, save
from torch.nn import functional

from coopmap_agents.map_prediction import (
    MapNetwork,
    MapNetworkSettings,
    MapPredictor,
    MapTrainingConfig,
    PredictionScores,
    PredictivePolicy,
    PredictiveSurfacePolicy,
    collect_examples,
    load_map_network,
    map_image,
    save_map_network,
    score_predictions,
)
from coopmap_agents.map_prediction.examples import cell_weights, predicted_cells
from coopmap_agents.map_prediction.images import fold, unfold
from coopmap_agents.map_prediction.library import network_file, shipped_path, shipped_seeds
from coopmap_agents.map_prediction.metadata import METADATA_KEY
from coopmap_env import families
from coopmap_env.core.files import FileError
from coopmap_env.core.settings import settings_from_dict
from coopmap_env.envs.field import FieldEnv, FieldSettings
from coopmap_env.envs.planar import PlanarEnv
from coopmap_env.evaluation import make_policy, rollout
from coopmap_env.information import PlanarExpectedViews, near_surface_weights
from coopmap_env.mapping import OccupancyMap, VoxelGrid
from coopmap_env.simulation.scenes.planar import Rooms

TINY = MapNetworkSettings(widths=(4, 6, 8), stride=2)


SMALL = MapNetworkSettings(dimension=3, widths=(3, 4, 5), stride=4)


def tiny_network(seed=0, settings=TINY):
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        return MapNetwork(settings).eval()


def small_env(**options):
    return PlanarEnv(scene=Rooms(shape=(48, 40)), max_scans=4, **options)


def test_the_image_of_a_map_by_hand():
    map_ = OccupancyMap(VoxelGrid((2, 3)))
    set_cells(map_, 0, 0.2)
    set_cells(map_, 4, 0.5)
    # a level of log-odds is 1 / 1024 nat
    np.testing.assert_array_equal(map_image(map_), [[51, 255, 255], [255, 127, 255]])


def test_cells_count_by_their_distance_from_known_free_ones():
    image = np.full((3, 6), 255, np.uint8)
    image[1, 0], image[1, 1] = 0, 254
    steps = [[1, 1, 2, 3, 4, 5], [np.inf, np.inf, 2, 3, 4, 5], [1, 1, 2, 3, 4, 5]]
    world = image == 254
    weights = cell_weights(image, world)
    np.testing.assert_allclose(weights, np.exp(-np.array(steps) / 12), rtol=1e-6)
    np.testing.assert_array_equal(cell_weights(np.full((2, 2), 255, np.uint8), world[:2, 2:4]), 1)


def test_the_inside_of_obstacles_does_not_count():
    world = np.zeros((5, 7), bool)
    world[:, 2:] = True
    world[4, 6] = False
    weights = cell_weights(np.full((5, 7), 255, np.uint8), world)
    expected = np.ones((5, 7))
    expected[:, 3:] = 0
    expected[3:, 5:] = 1  # around the free corner
    np.testing.assert_array_equal(weights, expected)


def test_in_space_surface_alone_is_predicted():
    world = np.zeros((5, 5, 5), bool)
    world[1:4, 1:4, 1:4] = True
    surface = world.copy()
    surface[2, 2, 2] = False
    np.testing.assert_array_equal(predicted_cells(world), surface)
    np.testing.assert_array_equal(cell_weights(np.full((5, 5, 5), 255, np.uint8), surface), 1)
    np.testing.assert_array_equal(predicted_cells(world[2]), world[2])


@pytest.mark.parametrize("shape", [(1, 1), (7, 13), (40, 48), (1, 1, 1), (9, 16, 5)])
@pytest.mark.parametrize("stride", [1, 2, 3])
def test_maps_of_any_size_get_a_logit_for_each_cell(shape, stride):
    network = tiny_network(settings=replace(TINY, dimension=len(shape), stride=stride))
    images = torch.randint(0, 256, (2, *shape), dtype=torch.uint8)
    logits = network(images)
    assert logits.shape == (2, *shape)
    assert logits.dtype == torch.float32
    torch.testing.assert_close(network(images[1:])[0], logits[1], rtol=1e-4, atol=1e-5)


def test_blocks_are_folded_as_torch_does_and_back():
    image, blocks = torch.rand(2, 3, 8, 12), torch.rand(2, 12, 4, 6)
    folded = functional.pixel_unshuffle(image, 2)
    np.testing.assert_array_equal(fold(image.numpy(), 2), folded.numpy())
    assert torch.equal(unfold(blocks, 2), functional.pixel_shuffle(blocks, 2))
    voxels = np.arange(2.0 * 4 * 6 * 2, dtype=np.float32).reshape(1, 2, 4, 6, 2)
    folded = fold(voxels, 2)
    assert folded.shape == (1, 16, 2, 3, 1)
    # the first channel has the first voxel of each block
    np.testing.assert_array_equal(folded[0, 0, :, :, 0], voxels[0, 0, ::2, ::2, 0])
    np.testing.assert_array_equal(unfold(folded, 2), voxels)
    np.testing.assert_array_equal(unfold(torch.from_numpy(folded), 2).numpy(), voxels)


def test_what_a_network_is_shown_of_a_cell():
    network, image = tiny_network(), torch.full((1, 16, 16), 255, dtype=torch.uint8)
    seen = []
    for value in (255, 0, 60, 126, 127, 254):
        image[0, 8, 8] = value
        seen.append(network(image)[0, 8, 8].item())
    assert len(set(seen)) == len(seen)  # unknown and each probability differ


def test_predictions_are_those_of_the_network_in_steps_of_a_255th():
    map_ = random_map(np.random.default_rng(0), (21, 17))
    network = tiny_network()
    occupancy = MapPredictor(network).occupancy(map_)
    with torch.no_grad():
        expected = network(torch.from_numpy(map_image(map_))[None])[0].sigmoid().ravel()
    assert occupancy.shape == (21 * 17,)
    np.testing.assert_allclose(occupancy, expected, atol=0.5 / 255 + 1e-6)
    np.testing.assert_allclose(255 * occupancy, np.round(255 * occupancy), atol=1e-4)


def test_predictions_do_not_depend_on_threads():
    map_ = random_map(np.random.default_rng(1), (64, 64))
    network, used = tiny_network(), []
    network.register_forward_hook(lambda *_: used.append(torch.get_num_threads()))
    threads = torch.get_num_threads()
    try:
        torch.set_num_threads(3)
        MapPredictor(network).occupancy(map_)
        assert torch.get_num_threads() == 3
    finally:
        torch.set_num_threads(threads)
    assert used == [1]  # with more, sums round differently


def test_weights_that_are_too_large_are_named_when_they_are_used():
    network = tiny_network()
    for values in network.parameters():
        values.data.copy_(3e38 * values.sign())  # sums are infinite, and so are their differences
    with pytest.raises(ValueError, match="this map network gives no predictions for this map"):
        MapPredictor(network).occupancy(random_map(np.random.default_rng(1), (16, 16)))


@pytest.mark.parametrize(("settings", "shape"), [(TINY, (3, 3, 3)), (SMALL, (5, 5))])
def test_maps_of_another_dimension_are_refused(settings, shape):
    predictor = MapPredictor(tiny_network(settings=settings), dimension=settings.dimension)
    with pytest.raises(ValueError, match=rf"this one has {len(shape)}: choose predictive in"):
        predictor.occupancy(OccupancyMap(VoxelGrid(shape)))


def test_examples_are_the_maps_before_scans_with_their_worlds():
    with closing(small_env()) as env:
        policies = [make_policy("random"), make_policy("coverage:search=20")]
        examples = collect_examples(env, policies, [5, 6], n_maps=3)
        again = collect_examples(env, policies, [5, 6], n_maps=3)
        played = {}
        for number, seed in enumerate((5, 6)):
            for step in rollout(env, policies[number], seed):
                played.setdefault(seed, []).append(map_image(step.belief.map).tobytes())
            own = examples.images[3 * number : 3 * number + 3]
            assert {image.tobytes() for image in own} <= set(played[seed])
            assert (examples.occupied[3 * number] == env.truth.occupied).all()
    for one, other in zip(examples, again, strict=True):
        assert one.shape == (6, 48, 40)
        np.testing.assert_array_equal(one, other)


def test_scores_of_predictions_by_hand():
    p = np.array([0.75, 0.75, 0.0, 0.5], np.float32)
    scores = score_predictions(p, np.array([True, False, False, True]), np.array([1, 1, 2, 0.0]))
    logs = np.log(0.75) + np.log(0.25) + 2 * np.log(1 - 1e-3)
    assert scores.log_loss == pytest.approx(-logs / 4)
    assert scores.brier == pytest.approx((0.25**2 + 0.75**2) / 4)
    # the bin of 0.75 is half occupied
    assert scores.calibration_error == pytest.approx(2 * 0.25 / 4)


def test_a_file_gives_the_network_back(tmp_path):
    network = tiny_network()
    save_map_network(network, tmp_path / "map.safetensors", {"steps": 3})
    state = torch.random.get_rng_state()
    loaded = load_map_network(tmp_path / "map.safetensors")
    assert (torch.random.get_rng_state() == state).all()
    assert loaded.settings == TINY
    for name, values in network.state_dict().items():
        assert (loaded.state_dict()[name] == values).all()
    assert MapPredictor(loaded).fingerprint == MapPredictor(network).fingerprint
    assert MapPredictor(tiny_network(1)).fingerprint != MapPredictor(network).fingerprint


def changed(path, metadata=None, **weights):
    """The same file with other metadata or weights."""
    content = path.read_bytes()
    header = json.loads(content[8 : 8 + int.from_bytes(content[:8], "little")])
    values = {**json.loads(header["__metadata__"][METADATA_KEY]), **(metadata or {})}
    path.write_bytes(save({**load_file(path), **weights}, {METADATA_KEY: json.dumps(values)}))


@pytest.mark.parametrize(
    ("metadata", "weights", "message"),
    [
        ({"format": 7}, {}, r"in format 7, this is .* train the map network again"),
        ({"network": {"widths": [4, 6, 9]}}, {}, "the weights do not belong to the metadata: "),
        ({"network": {"widths": [4, 6, 1024]}}, {}, "the weights do not belong to the metadata"),
        ({"network": {"widths": [4, 6, -1]}}, {}, r"widths must be .*got \(4, 6, -1\)"),
        ({"network": 3}, {}, "was not written by `coopmap train-map` or `save_map_network`: "),
        ({"training": [1]}, {}, r"training must be a JSON object, got \(1,\)"),
        ({}, {"up.0.bias": torch.zeros(3)}, r"up\.0\.bias has the shape \(3,\), not \(24,\)"),
        ({}, {"up.0.bias": torch.full((24,), torch.nan)}, r"up\.0\.bias must be finite numbers"),
        ({}, {"up.0.bias": torch.zeros(24, dtype=torch.float16)}, r"of type float32, not float16"),
    ],
)
def test_a_file_of_another_network_is_refused_by_name(metadata, weights, message, tmp_path):
    path = tmp_path / "map.safetensors"
    save_map_network(tiny_network(), path)
    changed(path, metadata, **weights)
    with pytest.raises(FileError, match=rf"^{path}.*{message}"):
        load_map_network(path)


@cases(short=200, long=20_000)
def test_a_mutated_file_is_read_or_refused_by_name(n_cases, tmp_path):
    path = tmp_path / "map.safetensors"
    save_map_network(tiny_network(), path)
    for mutant in mutants([path.read_bytes()], n_cases):
        path.write_bytes(mutant)
        read_or_refuse(load_map_network, path, FileError, "")


def test_the_planner_counts_what_its_network_predicts():
    policy = PredictivePolicy(tiny_network())
    with closing(small_env()) as env:
        env.reset(seed=1)
        belief = env.belief()
        poses, planning = belief.feasible_poses(0), belief.planning
        hazards = policy.predictor.occupancy(belief.map) / 2
        gains = policy.foresight(belief).gain(0, poses)
        np.testing.assert_array_equal(gains, planning.foresight(belief, hazards).gain(0, poses))
        whole = PredictivePolicy(tiny_network(), hazard_scale=1).foresight(belief).gain(0, poses)
        assert (whole < gains).any()
        assert (whole <= gains).all()
        assert (gains != planning.foresight(belief).gain(0, poses)).any()


def test_the_planner_with_predictions_plays_an_episode_and_repeats_it():
    with closing(small_env(action_mode="candidates")) as env:
        policy = PredictivePolicy(tiny_network(), horizon=2, samples=10)
        runs = [[step.actions for step in rollout(env, policy, 3)] for _ in range(2)]
    assert runs[0] == runs[1]
    assert policy.n_parameters == sum(v.numel() for v in tiny_network().parameters())
    assert policy.model_bytes == 4 * policy.n_parameters


def test_wrong_options_are_named():
    with pytest.raises(ValueError, match="horizon must"):
        PredictivePolicy(tiny_network(), horizon=9)
    with pytest.raises(ValueError, match="hazard_scale must"):
        PredictivePolicy(tiny_network(), hazard_scale=1.5)
    with pytest.raises(FileError, match=r"nowhere\.safetensors"):
        PredictivePolicy("nowhere.safetensors")
    with pytest.raises(ValueError, match="maps of 3 dimensions is needed, and this one is for 2"):
        PredictiveSurfacePolicy(tiny_network())
    with pytest.raises(ValueError, match="maps of 2 dimensions is needed, and this one is for 3"):
        PredictivePolicy(shipped_path(3))
    with pytest.raises(ValueError, match=r"dimension must be one of \[2, 3\], got 4"):
        MapPredictor(dimension=4)
    for model in (True, 3, 3.5, b"nowhere"):
        with pytest.raises(ValueError, match="model must be a file or a MapNetwork, got"):
            PredictivePolicy(model)


def test_maps_are_drawn_from_the_scans_that_are_played():
    with closing(small_env(max_time=1e-3)) as env:  # only the first scan is played
        examples = collect_examples(env, [make_policy("random")], [0, 1, 2], n_maps=2)
    assert len(examples.images) == 3


def test_examples_of_no_episode_are_refused():
    for seeds, n_maps in (([], 1), ([0], 0), ([0], -1)):
        with closing(small_env()) as env, pytest.raises(ValueError, match="need seeds of episodes"):
            collect_examples(env, [make_policy("random")], seeds, n_maps)


def test_the_network_that_ships_predicts_better_than_constant_hazards():
    predictor, losses = MapPredictor(), {"network": [], "hazards": []}
    with closing(families.make("crowded", "validation")) as env:
        for scan, step in enumerate(rollout(env, make_policy("coverage:search=30"), 500)):
            if scan % 8 == 4:
                map_, truth = step.belief.map, env.truth.occupied
                weights = cell_weights(map_image(map_), truth)
                hazards = PlanarExpectedViews(step.belief.rating_function).cells(map_)
                guesses = {"network": predictor.occupancy(map_), "hazards": 1 - hazards.passing}
                for name, guess in guesses.items():
                    losses[name].append(score_predictions(guess, truth, weights).log_loss)
    assert np.mean(losses["network"]) < 0.75 * np.mean(losses["hazards"])


@pytest.mark.parametrize("env_name", ["planar", "field"])
def test_the_record_of_a_network_that_ships_is_of_its_training(env_name):
    config = MapTrainingConfig(env_name=env_name)
    dimension = config.network.dimension
    for seed in shipped_seeds(dimension):
        path = shipped_path(dimension, seed=seed)
        assert load_map_network(path).settings == config.network
        assert path.stat().st_size < 1_000_000
        record = json.loads(shipped_path(dimension, "json", seed).read_text())
        recorded = settings_from_dict(record["config"], MapTrainingConfig)
        assert recorded == replace(config, seed=seed)
        best = record["rows"][record["best"]]
        for scores in best["validation"].values():
            assert PredictionScores(**scores).calibration_error < 0.05


def test_a_seed_selects_a_network_that_ships(tmp_path):
    assert 0 in shipped_seeds(2)
    for seed in shipped_seeds(2):
        assert PredictivePolicy(seed=seed).fingerprint == MapPredictor(seed=seed).fingerprint
    assert shipped_path(2) == shipped_path(2, seed=0) == network_file(2, 0)
    for seed in (10_000, -1, True, 0.0, "0"):
        match = rf"the networks of planar maps were trained with the seeds \[0.*got {seed!r}"
        with pytest.raises(ValueError, match=match):
            PredictivePolicy(seed=seed)
    with pytest.raises(ValueError, match="networks of field maps were trained with the seeds"):
        make_policy("predictive_surface:seed=10000")
    with pytest.raises(ValueError, match="seed=0 selects a network that ships with coopmap; "):
        PredictivePolicy(tiny_network(), seed=0)


def test_the_planner_of_surface_counts_what_its_network_predicts():
    pytest.importorskip("pybullet")
    settings = FieldSettings(crop_cells=(8, 4), max_grid_poses=243)
    with closing(FieldEnv(max_scans=2, settings=settings)) as env:
        policy = PredictiveSurfacePolicy(tiny_network(settings=SMALL), search=10)
        belief = next(iter(rollout(env, policy, 3))).belief
        poses, occupancy = belief.feasible_poses(0)[:5], policy.predictor.occupancy(belief.map)
        new = np.where(belief.map.sampled_mask == 0, occupancy, 0.0)
        sums = [new[belief.visible_cells(0, pose)].sum(dtype=float) for pose in poses]
        expected = np.array(sums) / belief.rating_function.max_visible_cells
        np.testing.assert_allclose(policy.foresight(belief).gain(0, poses), expected, rtol=1e-9)
        runs = [[step.actions for step in rollout(env, policy, 3)] for _ in range(2)]
    for one, other in zip(*runs, strict=True):
        for agent, action in one.items():
            np.testing.assert_array_equal(action, other[agent])


def best_table(distances, hit, weights):
    """The fraction of `hit` at each distance: no table by distance has a smaller loss."""
    _, index = np.unique(distances, return_inverse=True)
    totals, hits = np.bincount(index, weights), np.bincount(index, weights * hit)
    return (hits / np.maximum(totals, 1e-12))[index]


def test_the_field_network_that_ships_predicts_better_than_any_table_by_distance():
    pytest.importorskip("pybullet")
    predictor, losses = MapPredictor(dimension=3), {"network": [], "distances": []}
    with closing(families.make("occluded", "validation")) as env:
        for scan, step in enumerate(rollout(env, make_policy("surface:search=20"), 500)):
            if scan in (2, 5):
                map_, surface = step.belief.map, predicted_cells(env.truth.occupied).ravel()
                weights = cell_weights(map_image(map_), surface.reshape(map_.grid.shape)).ravel()
                guesses = {
                    "network": predictor.occupancy(map_),
                    "distances": best_table(near_surface_weights(map_), surface, weights),
                }
                for name, guess in guesses.items():
                    losses[name].append(score_predictions(guess, surface, weights).log_loss)
    assert np.mean(losses["network"]) < 0.75 * np.mean(losses["distances"]), losses
