"""The price of motion: families compared at equal motion, from hand-made tables of scores."""

import pytest
from plain.episodes import example_episode

from coopmap_env.evaluation import Evaluation
from coopmap_env.studies.benchmark.methods import (
    LEARNED,
    Condition,
    Method,
    planner_method,
    with_n_candidates,
)
from coopmap_env.studies.benchmark.motion_figure import draw_sweep
from coopmap_env.studies.benchmark.study import ConditionResult, MethodResult
from coopmap_env.studies.benchmark.sweep_summary import sweep_summary
from coopmap_env.studies.benchmark.tuned_planners import TunedCase

ACTIONS = with_n_candidates(8)
TABLE = {
    "coverage:motion_weight=0": (0.080, 400.0, 10.0),
    "coverage:motion_weight=0.01": (0.070, 200.0, 30.0),
    "rating_function:motion_weight=0": (0.075, 420.0, 5.0),
    "rating_function:motion_weight=0.1": (0.065, 100.0, 50.0),
    "frontier": (0.040, 90.0, 2.0),
}
"""Area, motion and reward of each planner, the same in both worlds."""
TRAINING = TABLE | {"rating_function:motion_weight=0.1": (0.040, 100.0, 50.0)}
"""The same on seven training worlds."""
SCORES = ("coverage_auc", "motion_distance", "reward")
CASE = TunedCase(
    "planar",
    ACTIONS,
    7,
    {
        family: {
            spec: {score: {"estimate": mean} for score, mean in zip(SCORES, row, strict=True)}
            for spec, row in TRAINING.items()
            if spec.startswith(family)
        }
        for family in ("coverage", "rating_function", "frontier")
    },
    {},
)


def result(method, *runs):
    """Each run has one (area, motion, reward) in both worlds."""

    def episode(seed, area, motion, reward):
        return example_episode(seed, (0.0, 2 * area), motion_distance=motion, reward=reward)

    return MethodResult(
        method, tuple(Evaluation(tuple(episode(seed, *run) for seed in (0, 1))) for run in runs)
    )


@pytest.fixture(scope="module")
def summary():
    learned = Method("learned", ("coverage", "coverage"), ACTIONS, LEARNED)
    results = [result(learned, (0.081, 290.0, 20.0), (0.077, 310.0, 20.0))]
    results += [result(planner_method(spec, ACTIONS), row) for spec, row in TABLE.items()]
    methods = tuple(found.method for found in results)
    condition = Condition("price of motion", "planar", 2, {}, methods, lines=CASE.lines())
    return sweep_summary(ConditionResult(condition, tuple(results)))


def test_lines_join_the_planners_that_training_worlds_have_chosen(summary):
    lines = summary["lines"]["coverage_auc"]
    assert lines["coverage"] == [
        "coverage, 8 candidates, motion weight 0.01",
        "coverage, 8 candidates, motion weight 0",
    ]
    # on test worlds the rating function would be one of them
    assert lines["the planners"] == ["frontier, 8 candidates", *lines["coverage"]]
    assert summary["lines"]["reward"]["the planners"] == [
        "frontier, 8 candidates",
        "rating function, 8 candidates, motion weight 0.1",
    ]
    assert summary["training_worlds"] == [7]
    assert {entry["training_worlds"] for entry in summary["equal_motion"]} == {7}


def test_the_learned_policy_is_compared_with_every_family_at_its_own_motion(summary):
    found = {
        entry["planners"]: entry
        for entry in summary["equal_motion"]
        if entry["score"] == "coverage_auc"
    }
    assert set(found) == {"the planners", "coverage", "rating function", "frontier"}
    # the policy moves 300 on average, half-way between the coverage planners
    for family in ("the planners", "coverage"):
        assert found[family]["planners_score"] == pytest.approx(0.075)
        assert found[family]["motion"] == pytest.approx(300.0)
        assert found[family]["is_equal"]
    # between 100 and 420, 200 of 320 on
    assert found["rating function"]["planners_score"] == pytest.approx(0.065 + 0.010 * 200 / 320)
    assert not found["frontier"]["is_equal"]
    difference = found["coverage"]["difference"]
    assert difference["estimate"] == pytest.approx(0.004)
    # runs differ from the line by 0.0065 and 0.0015: two runs, one degree of freedom
    assert difference["high"] - difference["estimate"] == pytest.approx(12.7062 * 0.0025, rel=1e-4)
    assert found["coverage"]["verdict"] == "no difference found"


def test_every_method_has_its_scores_and_its_motion(summary):
    for label, method in summary["methods"].items():
        assert set(method) == {
            "family", "policies", "coverage_auc", "reward", "motion_distance",
        }, label  # fmt: skip
    assert summary["methods"]["learned"]["motion_distance"]["estimate"] == pytest.approx(300.0)


def test_the_figure_is_drawn(summary, tmp_path):
    pytest.importorskip("matplotlib")
    draw_sweep(summary, tmp_path / "motion.png")
    assert (tmp_path / "motion.png").stat().st_size > 10_000
