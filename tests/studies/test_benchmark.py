"""The comparison of learned policies and planners; planners stand in for learned policies."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from plain.episodes import example_episode
from plain.pages import check_report_page

from coopmap_env.cli import main
from coopmap_env.evaluation import Evaluation
from coopmap_env.studies.benchmark import plan as benchmark_plan
from coopmap_env.studies.benchmark import study as benchmark_study
from coopmap_env.studies.benchmark.methods import (
    ALL_PLANNERS,
    LEARNED,
    POSE_MODE,
    Condition,
    Method,
    MotionLine,
    Opponent,
    clairvoyant_method,
    planner_method,
    with_n_candidates,
)
from coopmap_env.studies.benchmark.plan import FULL, QUICK, BenchmarkPlan, make_plan
from coopmap_env.studies.benchmark.report import write_benchmark_report
from coopmap_env.studies.benchmark.study import ConditionResult, MethodResult
from coopmap_env.studies.benchmark.summary import benchmark_summary, condition_summary
from coopmap_env.studies.benchmark.tables import benchmark_text, split_by_score
from coopmap_env.studies.benchmark.verdicts import headlines, verdicts

SHORT = {"n_robots": 2, "max_scans": 2, "split": "test", "reward": "rating"}
STAND_IN = Method(
    "learned", ("coverage", "information_gain"), with_n_candidates(8), LEARNED, plotted=True
)
"""Two planners as two training runs."""
METHODS = (
    STAND_IN,
    planner_method("rating_function", with_n_candidates(8), plotted=True),
    planner_method("coverage", with_n_candidates(8)),
    planner_method("rating_function:search=100", POSE_MODE),
    planner_method("random", POSE_MODE, plotted=True),
    clairvoyant_method("clairvoyant, greedy"),
)
RATING, COVERAGE, ANY_POSE = METHODS[1:4]
OPPONENTS = (
    Opponent("coverage_auc", RATING, 0.3, 7),
    Opponent("coverage_auc", COVERAGE, 0.5, 7),
    Opponent("coverage_auc", ANY_POSE, 0.2, 7),
    Opponent("reward", RATING, 40.0, 7),
    Opponent("reward", COVERAGE, 20.0, 7),
    Opponent("reward", ANY_POSE, 50.0, 7),
)
LINES = (MotionLine(ALL_PLANNERS, "coverage_auc", (RATING, COVERAGE), 7),)


def test_methods_are_compared_with_the_strongest_planner_of_the_same_actions():
    condition = Condition("here", "planar", 2, SHORT, METHODS, OPPONENTS)
    learned, rating, coverage, any_pose, random, _ = METHODS
    assert condition.baseline_for(learned) is coverage
    assert condition.baseline_for(rating) is coverage
    assert condition.baseline_for(coverage) is None
    assert condition.baseline_for(random) is any_pose
    assert condition.compared_methods(learned) == [coverage, rating, any_pose]
    assert condition.compared_methods(rating) == [coverage]
    assert condition.compared_methods(coverage) == []
    without = replace(condition, opponents=())
    assert without.baseline_for(learned) is None
    assert without.compared_methods(learned) == [rating, coverage]


def episode(seed, area, reward=0.0):
    """An episode of one scan with this area under the coverage curve."""
    return example_episode(seed, (0.0, 2 * area), reward=reward, motion_distance=1.0)


def method_result(method, *runs):
    """Result of a method: one row of areas under the curve for each run, one area per world."""
    return MethodResult(
        method, tuple(Evaluation(tuple(episode(k, a) for k, a in enumerate(row))) for row in runs)
    )


def example_condition():
    method_results = (
        method_result(METHODS[0], [0.3, 0.5], [0.4, 0.6]),
        method_result(METHODS[1], [0.2, 0.4]),
        method_result(METHODS[2], [0.4, 0.6]),
        method_result(METHODS[3], [0.2, 0.2]),
        method_result(METHODS[4], [0.1, 0.1]),
    )
    return ConditionResult(
        Condition("here", "planar", 2, SHORT, METHODS, OPPONENTS), method_results
    )


def test_scores_are_summarised_over_runs_and_worlds():
    found = condition_summary(example_condition())["methods"]["learned"]
    area = found["scores"]["coverage_auc"]
    assert area["runs"] == pytest.approx([0.4, 0.5])
    assert area["mean"]["estimate"] == pytest.approx(0.45)
    assert area["interquartile_mean"]["estimate"] == pytest.approx(0.45)  # of 0.4 and 0.5
    assert found["curve"]["estimate"] == pytest.approx([0.0, 0.9])
    assert "surface_coverage" not in found["scores"]


def test_the_verdict_follows_from_the_paired_difference():
    found = verdicts(condition_summary(example_condition()))
    areas = {v["planner"]: v for v in found if v["score"] == "coverage_auc"}
    # runs lead the rating function by 0.1 and 0.2 on both worlds; the best planner is coverage
    over_rating = areas["rating function, 8 candidates"]
    half = 12.7062 * 0.05  # two runs, one degree of freedom
    assert list(over_rating["difference"].values()) == pytest.approx(
        [0.15, 0.15 - half, 0.15 + half], abs=1e-5
    )
    assert over_rating["runs"] == pytest.approx([0.1, 0.2])
    assert over_rating["verdict"] == "no difference found"
    assert areas["coverage, 8 candidates"]["difference"]["estimate"] == pytest.approx(-0.05)
    assert set(areas) == {*(method.label for method in METHODS[1:4])}


def test_the_strongest_opponent_is_that_of_the_training_worlds_and_of_the_score():
    found = verdicts(condition_summary(example_condition()))
    strongest = {(v["score"], v["same_actions"]): v["spec"] for v in found if v["is_strongest"]}
    assert strongest == {
        ("coverage_auc", True): "coverage",
        ("reward", True): "rating_function",
        ("coverage_auc", False): "rating_function:search=100",
        ("reward", False): "rating_function:search=100",
    }
    assert len(found) == 6


def test_improvement_and_ratio_are_against_the_same_worlds():
    against = condition_summary(example_condition())["methods"]["learned"]["comparisons"]
    rating = against["rating function, 8 candidates"]
    assert rating["probability_of_improvement"]["coverage_auc"]["estimate"] == 1.0
    assert rating["ratio"]["coverage_auc"]["estimate"] == pytest.approx(1.5)
    assert rating["same_env_kwargs"]
    assert not against["rating function, m = 100"]["same_env_kwargs"]


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    store = tmp_path_factory.mktemp("store")
    generalization = Condition(
        "3 robots", "planar", 2, {**SHORT, "n_robots": 3}, METHODS[:3], OPPONENTS[:2]
    )
    sweep = Condition("price of motion", "planar", 3, SHORT, METHODS[:3], lines=LINES)
    small = BenchmarkPlan(
        (Condition("all policies", "planar", 3, SHORT, METHODS, OPPONENTS),),
        (sweep,),
        (generalization,),
        notes=("planar: tuned with other constants",),
    )
    return benchmark_study.run_benchmark(store, small, 1, print)


def test_all_methods_play_on_the_same_worlds(study):
    for method_result in study.main[0].method_results:
        assert len(method_result.runs) == len(method_result.method.policy_specs)
        assert method_result.scores["coverage_auc"].shape == (len(method_result.runs), 3)
        assert method_result.curves("coverage").shape == (len(method_result.runs), 3, 3)
        for run in method_result.runs:
            assert run.table["seed"].tolist() == [0, 1, 2]
        efficiency = method_result.scores["efficiency"]
        assert ((efficiency > 0) & (efficiency <= 1)).all()
    learned, _, coverage, *_, clairvoyant = study.main[0].method_results
    others = [result.scores["efficiency"] for result in study.main[0].method_results[:-1]]
    assert all((clairvoyant.scores["efficiency"] >= other).all() for other in others)
    np.testing.assert_array_equal(learned.scores["reward"][:1], coverage.scores["reward"])


def test_a_missing_policy_is_named_before_any_episode(tmp_path):
    first = Condition("all policies", "planar", 2, SHORT, METHODS[1:])
    last = replace(first, methods=(Method("late", ("nobody",), POSE_MODE, LEARNED),))
    with pytest.raises(ValueError, match="unknown policy 'nobody'"):
        benchmark_study.run_benchmark(
            tmp_path / "store", BenchmarkPlan((first,), (), (last,)), 1, print
        )
    assert not (tmp_path / "store").exists()


def test_the_table_has_a_row_for_each_method_and_condition(study):
    summary = benchmark_summary(study)
    text = benchmark_text(summary)
    for method in METHODS:
        assert f"| {method.label} " in text
    assert "| learned (2 training runs) |" in text
    for line in headlines(summary):
        assert f"- {line}\n" in text
    assert "`coverage` with the same actions" in text
    assert "`rating_function:search=100` with any pose (m = 100)" in text
    assert "Planar-v1, 3 worlds, area under the coverage curve: " in text
    assert text.startswith("Note: planar: tuned with other constants.\n")
    assert "that was strongest on 7 training worlds" in text
    assert "Planar-v1, 3 worlds; 7 training worlds have chosen the planners:" in text
    assert "on training worlds (Planar-v1: 7 training worlds):" in text
    assert "| learned | the planners | area under the coverage curve |" in text
    assert "| Planar-v1: 3 robots | 2 |" in text
    widths = {line.count(" | ") for line in text.splitlines() if line.startswith("| method")}
    assert widths == {11}


def test_all_files_of_the_report_are_written(study, tmp_path):
    for module in ("matplotlib", "jinja2"):
        pytest.importorskip(module)
    found = write_benchmark_report(study, tmp_path)
    assert json.loads((tmp_path / "summary.json").read_text()) == json.loads(json.dumps(found))
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    check_report_page(page)
    assert "Note: planar: tuned with other constants." in page
    assert found["notes"] == ["planar: tuned with other constants"]
    assert " ".join(page.split()).count("Planar-v1: 7 training worlds") == 2
    assert "strongest on 7 training worlds by the area" in " ".join(page.split())
    assert "that 7 training worlds have chosen" in " ".join(page.split())
    for part in (*found["main"], *found["sweeps"], *found["generalization"]):
        assert part["training_worlds"] == [7]
    assert (tmp_path / "table.md").read_text() == benchmark_text(found)
    rows = list(csv.DictReader((tmp_path / "planar_episodes.csv").read_text().splitlines()))
    assert len(rows) == 3 * 7
    assert {row["policy"] for row in rows} >= {"learned; coverage", "learned; information_gain"}


def test_a_table_of_several_scores_becomes_one_for_each_with_its_unit():
    table = [
        ["learned", "score", "difference", "verdict"],
        ["a", "reward", "+1", "higher"],
        ["a", "area under the coverage curve", "-2", "lower"],
        ["b", "reward", "+3", "higher"],
    ]
    assert split_by_score(table) == [
        (
            "reward",
            [
                ["learned", "difference, nats", "verdict"],
                ["a", "+1", "higher"],
                ["b", "+3", "higher"],
            ],
        ),
        (
            "area under the coverage curve",
            [["learned", "difference, points", "verdict"], ["a", "-2", "lower"]],
        ),
    ]
    assert split_by_score(table[:1]) == []


def test_the_command_compares_in_the_named_environments(tmp_path, monkeypatch, capsys):
    for module in ("matplotlib", "jinja2", "tyro"):
        pytest.importorskip(module)
    calls = []

    def small_plan(size, env_names):
        calls.append((size, tuple(env_names)))
        return BenchmarkPlan((Condition("all policies", "planar", 2, SHORT, METHODS[1:4]),))

    monkeypatch.setattr(benchmark_plan, "make_plan", small_plan)
    folder = ["--out", str(tmp_path)]
    main(["compare", "--quick", "--envs", "planar", *folder])
    main(["compare", "--n-worlds", "3", "--no-generalization", *folder])
    assert calls == [(QUICK, ("planar",)), (FULL.at_most(3), ("planar", "field"))]
    assert "| rating function, m = 100 |" in capsys.readouterr().out
    assert (tmp_path / "report.html").is_file()


def test_bad_input_is_named(tmp_path):
    with pytest.raises(SystemExit, match="environments must be planar, field or both, got moon"):
        main(["compare", "--envs", "planar,moon", "--out", str(tmp_path)])
    with pytest.raises(ValueError, match="field or both, got none"):
        make_plan(FULL, ())
    with pytest.raises(ValueError, match="n_worlds must be at least 2 for an interval, got 1"):
        Condition("here", "planar", 1, SHORT, METHODS)
    with pytest.raises(ValueError, match=r"\['learned'\] occur more than once"):
        Condition("here", "planar", 2, SHORT, (STAND_IN, STAND_IN))
    with pytest.raises(ValueError, match=r"opponents must be among the methods, \['rating.*not"):
        Condition("here", "planar", 2, SHORT, METHODS[2:], OPPONENTS)
    with pytest.raises(ValueError, match=r"opponents must be among the methods, \['rating.*not"):
        Condition("here", "planar", 2, SHORT, METHODS[2:], lines=LINES)
    with pytest.raises(ValueError, match=r"one of learned, rating function, .* got 'magic'"):
        Method("label", ("random",), POSE_MODE, "magic")
    with pytest.raises(ValueError, match="method 'label' needs at least one policy"):
        Method("label", (), POSE_MODE, LEARNED)
