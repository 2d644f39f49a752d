"""What all reference planners have in common."""

import numpy as np
import pytest
from plain.planar_worlds import NO_NOISE, env_with_world, open_world, set_poses
from plain.rollouts import MODES

import coopmap_baselines
from coopmap_env.envs.planar import PlanarEnv, PlanarSettings

POLICIES = [
    *((name, {}) for name in coopmap_baselines.POLICIES if name != "surface"),  # field only
    ("rating_function", {"search": "exhaustive"}),
    ("rating_function", {"search": 10, "coordination": "sequential"}),
    ("information_gain", {"search": "exhaustive", "coordination": "sequential"}),
    ("coverage", {"search": "exhaustive", "coordination": "sequential"}),
    ("frontier", {"coordination": "sequential"}),
    ("frontier", {"utility": "nearest"}),
    ("lookahead", {"horizon": 3, "width": 3, "coordination": "joint"}),
]
SCORING = ["rating_function", "information_gain", "coverage", "frontier", "projection"]


def episode(env, policy, seed=1, rng=0):
    """Actions, pose numbers and reasons for refusal of every step."""
    observations, _ = env.reset(seed=seed)
    policy.reset(np.random.default_rng(rng))
    steps = []
    while env.agents:
        actions = policy.act(env.belief(), observations)
        assert list(actions) == env.agents
        for agent, action in actions.items():
            assert env.action_space(agent).contains(action)
        observations, _, _, _, infos = env.step(actions)
        reasons = tuple(info["rejected_reason"] for info in infos.values())
        steps.append((env.belief().pose_ids, reasons))
    return steps


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize(("name", "options"), POLICIES)
def test_whole_episodes_without_a_rejection_repeat_with_the_same_generator(
    name, options, mode, small_scene
):
    env = PlanarEnv(2, mode, scene=small_scene, max_scans=4, n_candidates=12)
    policy = coopmap_baselines.make(name, **options)
    first = episode(env, policy)
    assert all(reasons == (0, 0) for _, reasons in first)
    episode(env, policy, seed=5, rng=3)  # a used policy starts afresh
    assert episode(env, policy) == first
    assert episode(env, coopmap_baselines.make(name, **options)) == first


@pytest.mark.parametrize(("name", "options"), POLICIES)
def test_planning_changes_neither_belief_nor_environment(name, options):
    env = PlanarEnv(2, max_scans=3)
    env.reset(seed=0)
    belief = env.belief()
    state, map_ = env.state(), belief.map.copy()
    coopmap_baselines.make(name, **options).act(belief, {})
    np.testing.assert_array_equal(env.state(), state)
    np.testing.assert_array_equal(belief.map.log_odds_fixed, map_.log_odds_fixed)
    assert env.belief() is belief


@pytest.mark.parametrize(("name", "options"), POLICIES)
def test_a_robot_that_is_walled_in_turns_where_it_stands(name, options):
    env = env_with_world(open_world(), n_robots=1)
    belief = set_poses(env, (20, 20, 3))
    *_, infos = env.step(coopmap_baselines.make(name, **options).act(belief, {}))
    assert infos["robot_0"]["rejected_reason"] == 0
    assert env.belief().cell(0) == belief.cell(0)


@pytest.mark.parametrize("name", ["rating_function", "information_gain", "coverage"])
@pytest.mark.parametrize("m", [1, 10, 10**6])
def test_random_m_takes_the_best_of_its_sample(name, m, small_scene):
    env = PlanarEnv(2, scene=small_scene, max_scans=5 if m < 1000 else 2)  # all poses take long
    policy = coopmap_baselines.make(name, search=m)
    observations, _ = env.reset(seed=2)
    policy.reset(np.random.default_rng(7))
    rng = np.random.default_rng(7)  # draws what the policy draws
    while env.agents:
        belief = env.belief()
        actions = policy.act(belief, observations)
        for robot, agent in enumerate(belief.agents):
            sample = belief.random_poses(robot, m, rng)
            feasible = belief.feasible_poses(robot)
            assert len(set(sample.tolist())) == len(sample) == min(m, len(feasible))
            assert np.isin(sample, feasible).all()
            scores = policy.score(belief, robot, sample, None)
            chosen, _ = belief.actions.decode(agent, actions[agent], belief)
            assert scores[sample.tolist().index(chosen)] == scores.max()
        observations, *_ = env.step(actions)


def test_feasible_poses_are_all_headings_at_all_feasible_cells():
    belief = set_poses(
        env_with_world(open_world(), n_robots=1), (20, 20, 3), known=[20 * 40 + 21, 900]
    )
    expected = {cell * 16 + heading for cell in (820, 821) for heading in range(16)}
    assert set(belief.feasible_poses(0).tolist()) == expected
    assert len(belief.feasible_poses(0)) == 32


def test_among_candidates_the_planners_search_only_those():
    env = PlanarEnv(2, "candidates", n_candidates=5, max_scans=4)
    env.reset(seed=0)
    for search in (3, 100, "exhaustive"):
        policy = coopmap_baselines.make("rating_function", search=search)
        for robot in range(2):
            offered = env.belief().candidates[robot]
            np.testing.assert_array_equal(policy.candidate_poses(env.belief(), robot), offered)


def overlap(belief, actions):
    """Cells that both robots' views show."""
    views = []
    for agent, action in actions.items():
        pose, _ = belief.actions.decode(agent, action, belief)
        views.append(set(belief.rating_function.visible_cells(belief.map, pose).tolist()))
    return len(views[0] & views[1])


@pytest.mark.parametrize("name", SCORING)
def test_sequential_robots_at_one_pose_choose_different_views(name):
    env = env_with_world(open_world(), n_robots=2, settings=PlanarSettings(noise=NO_NOISE))
    known = np.zeros((40, 40), dtype=bool)
    known[19:22, 19:22] = True
    belief = set_poses(env, (20, 20, 0), (20, 20, 0), known=known)
    options = {} if name == "frontier" else {"search": "exhaustive"}
    alone = coopmap_baselines.make(name, **options).act(belief, {})
    in_turn = coopmap_baselines.make(name, coordination="sequential", **options).act(belief, {})
    np.testing.assert_array_equal(alone["robot_0"], alone["robot_1"])
    np.testing.assert_array_equal(in_turn["robot_0"], alone["robot_0"])
    assert overlap(belief, in_turn) < 0.2 * overlap(belief, alone)


@pytest.mark.parametrize("name", [*SCORING, "lookahead"])
def test_a_team_of_one_has_nobody_to_wait_for(name, small_scene):
    env = PlanarEnv(1, scene=small_scene, max_scans=4)
    options = {} if name == "frontier" else {"search": 20}
    independent = coopmap_baselines.make(name, **options)
    sequential = coopmap_baselines.make(name, coordination="sequential", **options)
    assert episode(env, independent) == episode(env, sequential)
