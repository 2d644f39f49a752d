from dataclasses import replace

import numpy as np
import pytest

import coopmap_baselines
from coopmap_env.envs.planar import PlanarEnv, PlanarSettings
from coopmap_env.information import NewInformationCache, ViewContext
from coopmap_env.sensing import PlanarCamera

READINGS = ["literal", "distance_free"]


def settings_of(interpretation, resolution=1.0, **changes):
    base = PlanarSettings.for_resolution(resolution)
    return replace(base, rating=replace(base.rating, interpretation=interpretation), **changes)


def cache_of(env):
    return env.belief().planning._cache


def play_and_compare(env, policy, seed):
    """Compare every step's scores with rating all poses again; return how many poses those are."""
    observations, _ = env.reset(seed=seed)
    policy.reset(np.random.default_rng(0))
    brute = 0
    while env.agents:
        belief = env.belief()
        sequential = policy.coordination == "sequential"
        reserved_mask = np.zeros(belief.map.grid.n_cells, dtype=np.uint8) if sequential else None
        actions = policy.act(belief, observations)
        for robot, agent in enumerate(belief.agents):
            ids = belief.feasible_poses(robot)
            brute += len(ids)
            rated = belief.rate(robot, ids, reserved_mask)
            counter = cache_of(env).n_rated
            scores = policy.score(belief, robot, ids, reserved_mask)
            cache_of(env).n_rated = counter  # what this test asks does not count
            np.testing.assert_array_equal(scores, rated.rating)
            chosen, _ = belief.actions.decode(agent, actions[agent], belief)
            assert chosen == ids[np.argmax(rated.rating)]
            if sequential:
                reserved_mask[belief.rating_function.visible_cells(belief.map, chosen)] = 1
        observations, *_ = env.step(actions)
    return brute


@pytest.mark.parametrize("interpretation", READINGS)
@pytest.mark.parametrize("coordination", ["independent", "sequential"])
def test_the_exhaustive_search_rates_all_feasible_poses_at_every_step(
    coordination, interpretation, small_scene
):
    policy = coopmap_baselines.make(
        "rating_function", search="exhaustive", coordination=coordination
    )
    settings = settings_of(interpretation, small_scene.resolution)
    first = PlanarEnv(2, scene=small_scene, max_scans=6, settings=settings)
    other = PlanarEnv(1, scene=small_scene, max_scans=3, settings=settings)
    play_and_compare(first, policy, seed=0)
    cache = cache_of(first)
    play_and_compare(first, policy, seed=1)  # another world of the same environment
    assert cache_of(first) is cache
    play_and_compare(other, policy, seed=2)
    assert cache_of(other) is not cache
    play_and_compare(first, policy, seed=0)


def test_far_fewer_poses_are_rated_than_there_are():
    policy = coopmap_baselines.make("rating_function", search="exhaustive")
    env = PlanarEnv(2, max_scans=12)
    brute = play_and_compare(env, policy, seed=0)
    assert 0 < cache_of(env).n_rated < 0.6 * brute


# Two bins distinguish only sampled and unknown cells: what can change is occlusion.
@pytest.mark.parametrize(
    ("interpretation", "n_gray_bins"),
    [("literal", 64), ("distance_free", 64), ("distance_free", 2)],
)
@pytest.mark.parametrize("camera", [PlanarCamera(), PlanarCamera(np.pi, 6.0, 70)])
def test_remembered_new_information_is_that_of_the_map_as_it_is_now(
    camera, interpretation, n_gray_bins
):
    """Cells change one by one, also back again, at any place and by any amount."""
    settings = settings_of(interpretation, camera=camera, n_headings=5)
    settings = replace(settings, rating=replace(settings.rating, n_gray_bins=n_gray_bins))
    env = PlanarEnv(1, settings=settings)
    env.reset(seed=0)
    rating, map_ = env.belief().rating_function, env.belief().map
    cache, rng = NewInformationCache(rating), np.random.default_rng(0)
    cells = (rng.integers(80, 120, (400, 2)) * (200, 1)).sum(axis=1)
    for _ in range(60):
        changed = rng.choice(cells, rng.integers(1, 6))
        map_.sampled_mask[changed] = rng.random() < 0.8
        map_.log_odds_fixed[changed] = rng.integers(
            -map_.log_odds_range.clamp, map_.log_odds_range.clamp + 1
        )
        map_.log_odds_fixed[map_.sampled_mask == 0] = 0
        ids = rng.choice(cells, 50) * 5 + rng.integers(5, size=50)
        reserved_mask = np.zeros(map_.grid.n_cells, dtype=np.uint8)
        reserved_mask[rng.choice(cells, 20)] = 1
        np.testing.assert_array_equal(
            cache.new_information(map_, ids), rating.new_information(map_, ids)
        )
        np.testing.assert_array_equal(
            cache.new_information(map_, ids, ViewContext(reserved_mask)),
            rating.new_information(map_, ids, ViewContext(reserved_mask)),
        )


def test_a_map_that_did_not_change_is_not_rated_again():
    env = PlanarEnv(1)
    env.reset(seed=0)
    belief = env.belief()
    cache, ids = NewInformationCache(belief.rating_function), belief.feasible_poses(0)
    cache.new_information(belief.map, ids)
    assert cache.n_rated == len(ids)
    cache.new_information(belief.map.copy(), ids[::-1])
    assert cache.n_rated == len(ids)


@pytest.mark.parametrize("search", [30, "exhaustive"])
@pytest.mark.parametrize("weight", [0, 0.05, 3.0])
def test_a_motion_weight_takes_the_place_of_k_in_eq_9(search, weight):
    settings = PlanarSettings()
    settings = replace(settings, rating=replace(settings.rating, exponent=2.0))
    env = PlanarEnv(2, settings=settings)
    env.reset(seed=3)
    belief = env.belief()
    ids = belief.feasible_poses(1)
    policy = coopmap_baselines.make("rating_function", search=search, motion_weight=weight)
    rated = belief.rate(1, ids)
    by_hand = (rated.new_information - weight * rated.distance**2) * (1 - rated.occupancy)
    np.testing.assert_allclose(policy.score(belief, 1, ids, None), by_hand, rtol=1e-12, atol=1e-12)


def test_the_motion_weight_of_the_environment_is_the_default():
    env = PlanarEnv(1)
    env.reset(seed=0)
    belief = env.belief()
    ids = belief.feasible_poses(0)
    same = coopmap_baselines.make("rating_function", motion_weight=env.settings.rating.K)
    default = coopmap_baselines.make("rating_function")
    np.testing.assert_allclose(
        same.score(belief, 0, ids, None), default.score(belief, 0, ids, None), rtol=1e-12
    )
