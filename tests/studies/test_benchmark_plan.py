"""Which methods play under which conditions."""

import numpy as np
import pytest

from coopmap_env.evaluation import get_env_spec, make_policy
from coopmap_env.studies.benchmark.methods import (
    CLAIRVOYANT,
    LEARNED,
    POSE_MODE,
    STANDARD_TEAM,
    planner_method,
    with_n_candidates,
)
from coopmap_env.studies.benchmark.plan import FULL, QUICK, make_plan


def test_the_plan_has_the_documented_methods_and_conditions():
    whole = make_plan(FULL, ("planar", "field"))
    planar, field = whole.main
    assert (planar.n_worlds, field.n_worlds) == (100, 50)
    assert len([method for method in planar.methods if method.family == LEARNED]) == 7
    assert planar.methods[0].policy_specs == ("predictive:search=100",)
    assert field.methods[0].policy_specs == ("predictive_surface:search=100",)
    first = planar.methods[2]
    assert first.policy_specs == tuple(
        f"learned:model=planar-candidates+seed={k}" for k in (0, 1, 2)
    )
    assert first.env_kwargs == {"action_mode": "candidates", "n_candidates": 32}
    assert {
        c.env_kwargs["n_robots"] for c in whole.generalization if c.env_name == "planar"
    } == set(range(1, 6))
    assert [condition.n_worlds for condition in make_plan(QUICK, ("planar",)).main] == [4]


def test_every_learned_policy_meets_the_strongest_of_each_family_by_each_score():
    for condition in make_plan(FULL, ("planar", "field")).main:
        for method in condition.methods:
            if method.family == LEARNED:
                for score in ("coverage_auc", "reward"):
                    opponents = condition.opponents_by(score, method.env_kwargs)
                    assert {opponent.method.family for opponent in opponents} == {
                        "rating function", "coverage", "information gain", "frontier",
                    }  # fmt: skip
                    means = [opponent.training_mean for opponent in opponents]
                    assert means == sorted(means, reverse=True)


def test_planners_that_do_not_pay_for_motion_are_in_every_main_condition():
    for condition in make_plan(FULL, ("planar", "field")).main:
        here = {m.policy_specs[0] for m in condition.methods if "n_candidates" in m.env_kwargs}
        for family in ("rating_function", "coverage", "information_gain"):
            assert f"{family}:motion_weight=0" in here
            assert f"{family}:motion_weight=0+coordination=sequential" in here


def test_every_planner_of_the_comparison_can_be_made():
    whole = make_plan(FULL, ("planar", "field"))
    conditions = (*whole.main, *whole.sweeps, *whole.generalization)
    methods = [method for condition in conditions for method in condition.methods]
    planners = [m for m in methods if m.family not in (LEARNED, CLAIRVOYANT)]
    for spec in {m.policy_specs[0] for m in planners}:
        make_policy(spec)


def test_a_size_can_be_limited():
    assert FULL.at_most(30).planar == 30
    assert FULL.at_most(30).sweep_field == FULL.sweep_field < 30
    assert QUICK.at_most(100) == QUICK


@pytest.mark.parametrize("world", ["planar", "field"])
def test_every_environment_of_the_comparison_can_be_made(world):
    pytest.importorskip("rtbdata" if world == "planar" else "pybullet")
    whole = make_plan(FULL, (world,))
    for condition in (*whole.main, *whole.generalization):
        for arguments in (POSE_MODE, with_n_candidates(3)):
            get_env_spec(world).make(**{**condition.env_kwargs, **arguments}).close()


def test_the_seed_decides_world_and_starts_whatever_the_action_mode():
    starts = []
    for arguments in (POSE_MODE, with_n_candidates(32), with_n_candidates(300)):
        env = get_env_spec("planar").make(**STANDARD_TEAM, **arguments)
        env.reset(seed=4)
        starts.append((env.truth.occupied, env.belief().positions))
    for occupied, positions in starts[1:]:
        np.testing.assert_array_equal(occupied, starts[0][0])
        np.testing.assert_array_equal(positions, starts[0][1])


def test_labels_say_what_a_spec_does():
    reference = planner_method("rating_function:search=100", POSE_MODE)
    assert reference.label == "rating function, m = 100"
    exhaustive = planner_method("rating_function:search=exhaustive+motion_weight=0", POSE_MODE)
    assert exhaustive.label == "rating function, exhaustive, motion weight 0"
    sequential = planner_method("rating_function:coordination=sequential", with_n_candidates(32))
    assert sequential.label == "rating function, 32 candidates, sequential"
    assert sequential.family == "rating function"
    assert planner_method("raster", POSE_MODE).family == "other"
