"""The sweep on training worlds, its record, and the opponents that it chooses."""

import json
import math
from dataclasses import replace

import pytest

from coopmap_env.core.files import FileError
from coopmap_env.evaluation import make_policy
from coopmap_env.studies.benchmark import tuning
from coopmap_env.studies.benchmark.families import (
    MOTION_WEIGHTS,
    SEARCH_POSES,
    planner_spec,
    sweep_specs,
)
from coopmap_env.studies.benchmark.methods import POSE_MODE, with_n_candidates
from coopmap_env.studies.benchmark.tuned_planners import (
    TunedCase,
    default_settings,
    find_case,
    read_record,
    record_notes,
)


def scores(area, reward, motion=100.0):
    means = {"coverage_auc": area, "reward": reward, "motion_distance": motion}
    return {score: {"estimate": mean} for score, mean in means.items()}


CASE = TunedCase(
    "planar",
    with_n_candidates(8),
    2,
    {
        "coverage": {
            "coverage": scores(0.07, 30.0),
            "coverage:motion_weight=0": scores(0.08, 9.0, 200.0),
        },
        "frontier": {"frontier": scores(0.04, 5.0)},
    },
    default_settings("planar"),
)


def test_the_strongest_planner_of_a_family_depends_on_the_score():
    assert CASE.strongest("coverage", "coverage_auc") == "coverage:motion_weight=0"
    assert CASE.strongest("coverage", "reward") == "coverage"
    found = {(o.score, o.method.policy_specs[0]): o.training_mean for o in CASE.opponents()}
    assert found == {
        ("coverage_auc", "coverage:motion_weight=0"): 0.08,
        ("coverage_auc", "frontier"): 0.04,
        ("reward", "coverage"): 30.0,
        ("reward", "frontier"): 5.0,
    }
    assert all(o.method.env_kwargs == with_n_candidates(8) for o in CASE.opponents())
    assert {o.training_worlds for o in CASE.opponents()} == {2}


def test_the_opponents_at_equal_motion_are_the_hull_of_each_family_and_of_all():
    found = {
        (line.family, line.score): [method.policy_specs[0] for method in line.methods]
        for line in CASE.lines()
    }
    both = ["coverage", "coverage:motion_weight=0"]
    assert found == {
        ("the planners", "coverage_auc"): both,
        ("coverage", "coverage_auc"): both,
        ("frontier", "coverage_auc"): ["frontier"],
        ("the planners", "reward"): ["coverage"],
        ("coverage", "reward"): ["coverage"],
        ("frontier", "reward"): ["frontier"],
    }
    assert {line.training_worlds for line in CASE.lines()} == {2}


def test_a_case_is_found_by_environment_and_actions():
    assert find_case([CASE], "planar", with_n_candidates(8)) is CASE
    assert find_case([CASE], "planar", with_n_candidates(9)) is None
    assert find_case([CASE], "field", with_n_candidates(8)) is None


def test_planners_that_were_tuned_with_other_constants_are_named_once():
    assert CASE.is_current
    rating = {**CASE.settings, "rating": {**CASE.settings["rating"], "K": 7.0}}
    beam = {**CASE.settings, "beam": {**CASE.settings["beam"], "free": 0.4}}
    for settings in (rating, beam, {"rating": CASE.settings["rating"]}):
        other = replace(CASE, settings=settings)
        assert not other.is_current
    assert record_notes([CASE]) == []
    (note,) = record_notes([CASE, other, other])
    assert note.startswith("planar: the opponents were tuned with other constants")


def test_specs_leave_out_what_is_the_default():
    assert planner_spec("frontier", None, "independent", 100) == "frontier"
    assert planner_spec("coverage", 0, "independent") == "coverage:motion_weight=0"
    assert (
        planner_spec("rating_function", 0.05, "sequential", 100)
        == "rating_function:search=100+motion_weight=0.05+coordination=sequential"
    )


@pytest.mark.parametrize("env_name", ["planar", "field"])
def test_every_family_is_swept_from_no_price_of_motion_in_both_coordinations(env_name):
    for family in MOTION_WEIGHTS[env_name]:
        specs = list(sweep_specs(family, env_name, search=100))
        assert len(set(specs)) == len(specs) == 2 * len(MOTION_WEIGHTS[env_name][family])
        for spec in specs:
            make_policy(spec)
        if family != "frontier":
            assert planner_spec(family, 0, "independent", 100) in specs
            assert planner_spec(family, 0, "sequential", 100) in specs


@pytest.fixture
def small_sweep(monkeypatch):
    """Three planners on two training worlds."""
    weights = {"planar": {"coverage": (0,), "frontier": (None,)}}
    monkeypatch.setattr(tuning, "MOTION_WEIGHTS", weights)
    monkeypatch.setattr("coopmap_env.studies.benchmark.families.MOTION_WEIGHTS", weights)
    case = tuning.TuningCase("planar", with_n_candidates(4), 2)
    monkeypatch.setattr(tuning, "FULL", (case,))


def test_the_record_is_what_the_command_writes(small_sweep, tmp_path):
    tuning.main([str(tmp_path), "--envs", "planar"])
    path = tmp_path / "tuned_planners.json"
    (case,) = read_record(path)
    assert (case.env_name, case.n_worlds, case.env_kwargs) == ("planar", 2, with_n_candidates(4))
    assert case.is_current
    specs = [spec for family in case.families.values() for spec in family]
    assert specs == [
        "coverage:motion_weight=0",
        "coverage:motion_weight=0+coordination=sequential",
        "frontier",
        "frontier:coordination=sequential",
    ]
    row = case.families["coverage"]["coverage:motion_weight=0"]
    assert set(row) == {"coverage_auc", "reward", "motion_distance"}
    for interval in row.values():
        assert interval["low"] <= interval["estimate"] <= interval["high"]
    written = path.read_text()
    assert json.loads(written)["split"] == "train"
    stored = sorted((tmp_path / "episodes").glob("*.json"))
    tuning.main([str(tmp_path)])
    assert path.read_text() == written  # the same command again plays nothing
    assert sorted((tmp_path / "episodes").glob("*.json")) == stored


def test_the_record_of_the_repository_has_every_planner_of_the_sweep():
    record = read_record()
    assert [(c.env_name, c.env_kwargs) for c in record] == [
        (case.env_name, case.env_kwargs) for case in tuning.FULL
    ]
    for case, played in zip(record, tuning.FULL, strict=True):
        search = SEARCH_POSES if case.env_kwargs == POSE_MODE else None
        assert search == played.search
        for family, rows in case.families.items():
            assert list(rows) == list(sweep_specs(family, case.env_name, search))


def test_the_record_of_the_repository_is_that_of_the_present_constants():
    """`make planners` makes it again."""
    for case, played in zip(read_record(), tuning.FULL, strict=True):
        assert case.n_worlds == played.n_worlds
        assert case.is_current


@pytest.mark.parametrize("text", ["{}", "[1]", '{"cases": [{"env_name": "planar"}]}', "no JSON"])
def test_a_broken_record_is_named(tmp_path, text):
    path = tmp_path / "record.json"
    path.write_text(text)
    with pytest.raises(FileError, match=r"record\.json"):
        read_record(path)


BROKEN = {
    "the test split": (
        lambda record, case, row: record.update(split="test"),
        "split must be 'train', got 'test'",
    ),
    "no case": (
        lambda record, case, row: record.update(cases=[]),
        r"cases must be a list that is not empty, got \[\]",
    ),
    "no family": (
        lambda record, case, row: case.update(families={}),
        "families must be a mapping that is not empty, got {}",
    ),
    "an empty family": (
        lambda record, case, row: case["families"].update(coverage={}),
        "family coverage must be a mapping that is not empty, got {}",
    ),
    "an unknown environment": (
        lambda record, case, row: case.update(env_name="marine"),
        "env_name must be planar or field, got 'marine'",
    ),
    "a number of worlds in words": (
        lambda record, case, row: case.update(n_worlds="many"),
        "n_worlds must be a positive integer, got 'many'",
    ),
    "no worlds": (
        lambda record, case, row: case.update(n_worlds=0),
        "n_worlds must be a positive integer, got 0",
    ),
    "a mean that is no number": (
        lambda record, case, row: row["reward"].update(estimate=math.nan),
        "mean reward of frontier must be a number, got nan",
    ),
    "a mean in words": (
        lambda record, case, row: row["motion_distance"].update(estimate="0.9"),
        "mean motion_distance of frontier must be a number, got '0.9'",
    ),
    "an unknown planner": (
        lambda record, case, row: case["families"]["frontier"].update({"covrage:a=1": row}),
        "unknown policy 'covrage'",
    ),
    "an unknown option": (
        lambda record, case, row: case["families"]["frontier"].update({"frontier:a=1": row}),
        "frontier.* a",
    ),
}


@pytest.mark.parametrize("kind", BROKEN)
def test_a_broken_value_of_a_record_is_named_with_the_file(kind, tmp_path):
    break_record, message = BROKEN[kind]
    case = json.loads(json.dumps(vars(CASE)))
    record = {"split": "train", "cases": [case]}
    path = tmp_path / "record.json"
    path.write_text(json.dumps(record))
    assert read_record(path) == (CASE,)
    break_record(record, case, case["families"]["frontier"]["frontier"])
    path.write_text(json.dumps(record))
    with pytest.raises(FileError, match=rf"record\.json: .*{message}"):
        read_record(path)
