"""What the environments report of the cells that scans truly show: for scoring, never a belief."""

from dataclasses import fields, replace

import numpy as np
import pytest
from plain.planar_worlds import NO_NOISE, env_with_world, open_world, set_poses
from plain.rollouts import random_actions
from plain.small_worlds import SETTINGS, small_world

from coopmap_env import field_v1, planar_v1
from coopmap_env.evaluation import evaluate
from coopmap_env.evaluation.policy import make_policy
from coopmap_env.sensing import PlanarCamera

FIELD = {"settings": field_v1.FieldSettings(crop_cells=(8, 4)), "max_scans": 3}


def planar(**arguments):
    return small_world(**{"report_shown": True, **arguments})


def field(**arguments):
    pytest.importorskip("pybullet")
    pytest.importorskip("embreex")
    return field_v1.parallel_env(**{"report_shown": True, **FIELD, **arguments})


BOTH = pytest.mark.parametrize("make", [planar, field])
TRUE_ENTRIES = {"shown_fraction", "reward_shown"}
COLLISION_COST = {planar: 0.0, field: field_v1.FieldSettings().collision_cost}


@BOTH
def test_infos_say_how_much_is_shown_and_the_mask_which_cells(make):
    env = make()
    _, infos = env.reset(seed=3)
    rng, before = np.random.default_rng(0), env.shown_mask
    assert (before == env.belief().map.sampled).all()  # what is known at the start
    assert {info["shown_fraction"] for info in infos.values()} == {before.mean()}
    while env.agents:
        *_, infos = env.step(random_actions(env, rng))
        mask = env.shown_mask
        assert mask.shape == env.belief().map.grid.shape
        assert mask.dtype == bool
        assert (mask >= before).all()
        assert {info["shown_fraction"] for info in infos.values()} == {mask.mean()}
        before = mask
    assert before.mean() > infos["robot_0"]["observed_fraction"] * 0.8
    env.close()


@BOTH
@pytest.mark.parametrize("team_reward", ["individual", "shared"])
def test_the_reward_pays_each_robot_for_what_its_scan_shows_first(make, team_reward):
    env = make(report_shown=False, reward="shown", team_reward=team_reward)
    _, infos = env.reset(seed=3)
    before, n_cells = infos["robot_0"]["shown_fraction"], env.belief().map.grid.n_cells
    rng = np.random.default_rng(0)
    while env.agents:
        _, rewards, *_, infos = env.step(random_actions(env, rng))
        terms = [info["reward_shown"] for info in infos.values()]
        costs = [COLLISION_COST[make] * info["collided"] for info in infos.values()]
        own = [term + cost for term, cost in zip(terms, costs, strict=True)]
        now = infos["robot_0"]["shown_fraction"]
        assert sum(own) == pytest.approx(now - before, abs=1e-12)
        assert all(round(one * n_cells, 6).is_integer() for one in own)
        if team_reward == "shared":
            assert set(rewards.values()) == {sum(terms) / 2}
        else:
            assert list(rewards.values()) == terms
        before = now
    env.close()


def test_the_reward_by_hand():
    """A camera with one beam, in a room: the second robot is paid only for what the first left."""
    camera = PlanarCamera(field_of_view=1.0, depth_of_field=5.0, n_beams=1)
    settings = planar_v1.PlanarSettings(camera=camera)
    world = open_world(walls=[(23, 20)])
    env = env_with_world(world, settings=settings, n_robots=2, reward="shown")
    set_poses(env, (20, 20, 0), (21, 20, 0))
    env._worlds.arrays.shown_mask[0] = 0  # nothing is known of the place where they started
    stay = {agent: np.zeros(3) for agent in env.agents}
    _, rewards, *_ = env.step(stay)
    # the first shows the cells 20 to 23; the second, whose beam crosses 21 to 23, nothing new
    assert np.argwhere(env.shown_mask).tolist() == [[x, 20] for x in range(20, 24)]
    assert rewards == {"robot_0": 4 / 40**2, "robot_1": 0.0}
    assert set(env.step(stay)[1].values()) == {0.0}


def test_only_who_keeps_it_has_the_term():
    actions = np.random.default_rng(0)
    for arguments, has in [
        ({"report_shown": False}, False), ({}, True), ({"reward": "shown"}, True),
    ]:  # fmt: skip
        env = planar(**arguments)
        env.reset(seed=0)
        *_, infos = env.step(random_actions(env, actions))
        assert ("reward_shown" in infos["robot_0"]) == has
        assert ("reward_shown" in env.info_types) == has
        assert env.reports_shown == has


@BOTH
def test_it_changes_nothing_else(make):
    silent, reporting = make(report_shown=False), make()
    rng = np.random.default_rng(1)
    first, second = silent.reset(seed=5), reporting.reset(seed=5)
    while silent.agents:
        for one, other in zip(first, second, strict=True):
            for agent in other if isinstance(other, dict) else ():
                if isinstance(other[agent], dict):
                    assert set(other[agent]) - set(one[agent]) <= TRUE_ENTRIES
        np.testing.assert_array_equal(
            silent.belief().map.log_odds_fixed, reporting.belief().map.log_odds_fixed
        )
        assert "shown_fraction" not in first[-1]["robot_0"]
        actions = random_actions(silent, rng)
        first, second = silent.step(actions), reporting.step(actions)
        for agent, observation in first[0].items():
            for key, value in observation.items():
                np.testing.assert_array_equal(value, second[0][agent][key])
        assert first[1] == second[1]
    names = {part.name for part in fields(reporting.belief())}
    assert not any("shown" in name for name in names)
    silent.close()
    reporting.close()


def test_without_noise_the_map_has_all_that_is_shown():
    env = planar(settings=replace(SETTINGS, noise=NO_NOISE), max_scans=12)
    for seed in range(5):
        env.reset(seed=seed)
        rng = np.random.default_rng(seed)
        while env.agents:
            env.step(random_actions(env, rng))
        assert (env.belief().map.sampled >= env.shown_mask).all()


@BOTH
def test_an_environment_that_does_not_report_says_how_to_make_one_that_does(make):
    env = make(report_shown=False)
    with pytest.raises(RuntimeError, match="reset"):
        _ = env.shown_mask
    env.reset(seed=0)
    with pytest.raises(RuntimeError, match="report_shown=True"):
        _ = env.shown_mask
    env.close()


def test_scans_of_robots_that_are_not_located_count():
    """The space around all true bases is known from the start, as if all were located."""
    env = field(initialization="search")
    _, infos = env.reset(seed=0)
    np.testing.assert_array_equal(env.shown_mask, env.diagnostics.initial_free_mask)
    assert infos["robot_0"]["shown_fraction"] > infos["robot_0"]["observed_fraction"] == 0.0
    before = env.shown_mask.sum()
    env.step(random_actions(env, np.random.default_rng(0)))
    assert env.shown_mask.sum() > before
    with pytest.raises(AttributeError):
        env.reports_shown = False
    env.close()


def test_it_begins_again_with_each_episode():
    env = planar()
    env.reset(seed=1)
    env.step(random_actions(env, np.random.default_rng(0)))
    env.reset(seed=1)
    assert (env.shown_mask == env.belief().map.sampled).all()


@BOTH
def test_evaluations_have_its_curve_and_its_scores(make):
    random = make_policy("random")
    reporting = evaluate(make(), random, [0, 1])
    curve = reporting.curves["shown"]
    assert curve.shape == reporting.curves["coverage"].shape
    assert (np.diff(curve, axis=1) >= 0).all()
    np.testing.assert_array_equal(reporting.table["shown"], curve[:, -1])
    np.testing.assert_allclose(
        reporting.table["shown_auc"], np.trapezoid(curve, axis=1) / (curve.shape[1] - 1)
    )
    silent = evaluate(make(report_shown=False), random, [0, 1])
    assert "shown" not in silent.table
    assert "shown" not in silent.curves
    np.testing.assert_array_equal(silent.table["coverage"], reporting.table["coverage"])
