"""The baselines in the field: the same classes, against the same protocol."""

from dataclasses import replace

import numpy as np
import pytest

import coopmap_baselines
from coopmap_env.envs.field import FieldEnv, FieldSettings
from coopmap_env.envs.planar import PlanarEnv
from coopmap_env.evaluation import run_episode
from coopmap_env.information import (
    adjacent_to_unknown,
    first_visible_point,
    near_surface_weights,
)

pytest.importorskip("pybullet")

SETTINGS = FieldSettings(crop_cells=(8, 4), max_grid_poses=243)
POLICIES = {
    "rating_function": {"search": 40},
    "information_gain": {"search": 10},
    "coverage": {"search": 10},
    "frontier": {},
    "allocation": {},
    "projection": {"search": 10},
    "tour": {"search": 10, "viewpoints": 2},
    "lookahead": {"search": 10, "width": 2, "samples": 5},
    "surface": {"search": 10},
    "raster": {},
    "random": {},
}
N_EXACT = 60
"""The most poses that are all scored at the map's own resolution."""
ALONE = ("allocation", "tour", "raster", "random")
"""Those without the option `coordination`."""
COORDINATED = [name for name in POLICIES if name not in ALONE]


@pytest.fixture(scope="module")
def env():
    made = FieldEnv(max_scans=3, settings=SETTINGS, split="test")
    yield made
    made.close()


@pytest.fixture
def belief(env):
    """After two scans of both robots."""
    env.reset(seed=1)
    rng = np.random.default_rng(0)
    for _ in range(2):
        now = env.belief()
        env.step(
            {
                agent: now.action_for(robot, now.random_poses(robot, 1, rng)[0])
                for robot, agent in enumerate(env.agents)
            }
        )
    return env.belief()


@pytest.mark.parametrize("name", POLICIES)
def test_every_baseline_plays_the_same_episode_for_the_same_seed(env, name):
    policy = coopmap_baselines.make(name, **POLICIES[name])
    one, two = (replace(run_episode(env, policy, seed=0), planning_time_ms=0.0) for _ in range(2))
    assert one == two
    assert one.n_rejected_actions == 0
    assert one.surface.coverage_curve[-1] > one.surface.coverage_curve[0] == 0.0
    assert one.coverage_curve[-1] > one.coverage_curve[0]


@pytest.mark.parametrize("name", COORDINATED)
def test_sequential_planning_runs_and_leaves_the_first_robot_as_it_was(belief, name):
    actions = {}
    for coordination in ("independent", "sequential"):
        policy = coopmap_baselines.make(name, coordination=coordination, **POLICIES[name])
        policy.reset(np.random.default_rng(3))
        actions[coordination] = policy.act(belief, {})
    np.testing.assert_array_equal(
        actions["independent"]["robot_0"], actions["sequential"]["robot_0"]
    )


@pytest.mark.parametrize("mode", ["pose", "candidates"])
def test_the_rating_function_takes_the_pose_of_the_highest_rating(mode):
    env = FieldEnv(action_mode=mode, n_candidates=N_EXACT, max_scans=2, settings=SETTINGS)
    env.reset(seed=2)
    belief = env.belief()
    policy = coopmap_baselines.make("rating_function", search=N_EXACT)
    policy.reset(np.random.default_rng(0))
    actions = policy.act(belief, {})
    rng = np.random.default_rng(0)
    for robot, agent in enumerate(belief.agents):
        poses = (
            belief.candidates[robot]
            if belief.candidates
            else belief.random_poses(robot, N_EXACT, rng)
        )
        best = poses[np.argmax(belief.rate(robot, poses).rating)]
        np.testing.assert_array_equal(actions[agent], belief.action_for(robot, best))
    env.close()


def test_a_large_search_is_ranked_roughly_first_and_ends_near_the_best(belief):
    poses = belief.random_poses(0, 200, np.random.default_rng(1))
    ratings = belief.rate(0, poses).rating
    policy = coopmap_baselines.make("rating_function", search=200)
    policy.reset(np.random.default_rng(1))
    chosen = policy.act(belief, {})["robot_0"]
    actions = np.array([belief.action_for(0, pose) for pose in poses])
    (picked,) = np.nonzero((actions == chosen).all(axis=1))
    assert ratings[picked[0]] >= np.sort(ratings)[-2]


def test_the_raster_scan_counts_through_the_grid_of_the_joints(belief):
    grid = belief.joint_spaces[0].grid()
    ahead = belief.planning.raster_offset(belief, 0, grid)
    assert sorted(ahead) == list(range(len(grid)))
    here = belief.joint_spaces[0].grid_index(belief.joints[0])
    assert ahead[(here + 1) % len(grid)] == 0
    feasible = belief.feasible_poses(0)
    policy = coopmap_baselines.make("raster")
    policy.reset(np.random.default_rng(0))
    chosen = policy.act(belief, {})["robot_0"]
    expected = feasible[np.argmin(belief.planning.raster_offset(belief, 0, feasible))]
    np.testing.assert_array_equal(chosen, belief.action_for(0, expected))


def test_frontier_views_the_nearest_frontier_that_any_pose_sees(belief):
    poses = belief.random_poses(0, 25, np.random.default_rng(5))
    shows = belief.unknown_fraction(0, poses) > 0
    there = belief.planning.nearest_frontier_mask(belief, 0, poses, shows)
    grid, map_ = belief.map.grid, belief.map
    frontier = adjacent_to_unknown(map_) & map_.sampled.ravel() & (map_.log_odds_fixed < 0)
    centers = grid.center(np.stack(np.unravel_index(np.flatnonzero(frontier), grid.shape), axis=-1))
    ways = np.linalg.norm(centers - belief.estimates[0].pose.translation, axis=1)
    rotations, translations = belief.vehicles[0].camera_poses(poses)
    nearest = {}
    for k in np.flatnonzero(shows):
        camera = rotations[k : k + 1], translations[k : k + 1]
        first, _ = first_visible_point(
            map_,
            centers[np.argsort(ways, kind="stable")],
            camera,
            belief.rating_function.fine.frustum,
        )
        nearest[k] = first
    best = min(nearest.values())
    assert there.any()
    assert np.flatnonzero(there).tolist() == [k for k in nearest if nearest[k] == best]
    assert not belief.planning.nearest_frontier_mask(
        belief, 0, poses, np.zeros(len(poses), dtype=bool)
    ).any()


def test_information_gain_expects_what_the_world_has(belief):
    poses = belief.random_poses(0, 5, np.random.default_rng(0))
    by_default = coopmap_baselines.make("information_gain").score(belief, 0, poses, None)
    stated = coopmap_baselines.make("information_gain", prior=0.02)
    other = coopmap_baselines.make("information_gain", prior=0.2)
    np.testing.assert_array_equal(by_default, stated.score(belief, 0, poses, None))
    assert not np.allclose(by_default, other.score(belief, 0, poses, None))


def test_expected_surface_is_that_of_the_new_voxels_in_view(belief):
    rng, n = np.random.default_rng(5), belief.map.grid.n_cells
    predicted = rng.random(n, dtype=np.float32)
    future, poses = belief.planning.foresight(belief, predicted), belief.random_poses(0, 4, rng)
    left = np.where(belief.map.sampled, 0.0, predicted.reshape(belief.map.grid.shape)).ravel()
    for pose in [None, *poses[:2]]:
        if pose is not None:
            future.take(0, pose)
            left[belief.visible_cells(0, pose)] = 0.0
        sums = [left[belief.visible_cells(0, one)].sum(dtype=float) for one in poses]
        expected = np.array(sums) / belief.rating_function.max_visible_cells
        np.testing.assert_allclose(future.gain(0, poses), expected, rtol=1e-9, atol=1e-12)
    assert future.gain(0, poses)[0] == 0.0


@pytest.mark.parametrize("values", [np.full(8, 0.1), np.full(128 * 128 * 40, 1.5)])
def test_predictions_that_are_no_probabilities_of_all_voxels_are_named(belief, values):
    with pytest.raises(ValueError, match="unknown_occupancy must"):
        belief.planning.foresight(belief, values)


def test_the_surface_planner_takes_the_pose_with_most_expected_surface(belief):
    policy = coopmap_baselines.make("surface", search=20, motion_weight=0.0)
    policy.reset(np.random.default_rng(3))
    chosen = policy.act(belief, {})["robot_0"]
    poses = belief.random_poses(0, 20, np.random.default_rng(3))
    weights = np.where(belief.map.sampled_mask == 0, near_surface_weights(belief.map), 0.0)
    sums = [weights[belief.visible_cells(0, pose)].sum(dtype=float) for pose in poses]
    np.testing.assert_array_equal(chosen, belief.action_for(0, poses[np.argmax(sums)]))


def test_the_surface_planner_refuses_planar_worlds():
    env = PlanarEnv(max_scans=2)
    env.reset(seed=0)
    with pytest.raises(ValueError, match="this one is planar: choose lookahead"):
        coopmap_baselines.make("surface").act(env.belief(), {})
