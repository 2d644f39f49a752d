"""Tables and pages of families."""

import re

import numpy as np
import pytest
from plain.episodes import example_episode

import coopmap_baselines
from coopmap_env import families
from coopmap_env.envs.field import FieldSettings
from coopmap_env.envs.planar import PlanarSettings
from coopmap_env.evaluation import Evaluation
from coopmap_env.evaluation.bounds import Efficiency
from coopmap_env.sensing import DepthCamera, PlanarCamera
from coopmap_env.studies.families import field_references, page_text, play_family, table_of
from coopmap_env.studies.families.admission import admission_of, admission_text
from coopmap_env.studies.families.page import table_text
from coopmap_env.studies.families.play import PLAYED_POLICIES, Played, _usual_policies
from coopmap_env.studies.families.timing import time_policies

SMALL = families.Family(
    "small",
    "planar",
    "A small world.",
    {"name": "obstacles", "shape": [24, 24], "side_min": 2.0, "side_max": 6.0},
    {"n_robots": 2, "max_scans": 3},
    PlanarSettings(
        camera=PlanarCamera(depth_of_field=6.0, n_beams=16), reach=4.0, crop_cells=8,
        initial_free_radius=1.0, max_start_distance=6.0,
    ),
)  # fmt: skip
NAMES = ["random", "coverage, m = 300, sequential", "look-ahead", "clairvoyant, greedy"]


@pytest.fixture(scope="module")
def played(tmp_path_factory):
    folder = tmp_path_factory.mktemp("families")
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(families.FAMILIES, "small", SMALL)
        yield play_family(SMALL, "train", range(3), folder, names=NAMES)


def test_all_policies_and_references_play_the_same_worlds(played):
    assert list(played.evaluations) == NAMES
    assert list(played.kinds.values()) == ["random", "one step", "look-ahead", "clairvoyant"]
    for evaluation in played.evaluations.values():
        assert [episode.seed for episode in evaluation.episodes] == [0, 1, 2]
        assert (evaluation.table["efficiency"] <= 1).all()
    ends = {name: own.table["efficiency"].mean() for name, own in played.evaluations.items()}
    assert ends["clairvoyant, greedy"] == max(ends.values())
    assert ends["random"] == min(ends.values())


@pytest.fixture(scope="module")
def times(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(families.FAMILIES, "small", SMALL)
        yield time_policies(SMALL, "train", 0, NAMES, tmp_path_factory.mktemp("times"))


def test_decisions_are_timed_one_by_one(times):
    assert list(times) == NAMES
    assert all(own > 0 for own in times.values())


def test_the_bound_has_a_gap_and_a_price(played):
    bound = table_of(played).bound
    shown = np.array([own.bounds[-1] for own in played.shown_bounds]) / 24**2
    assert bound.most.estimate == pytest.approx(shown.mean())
    assert bound.most.estimate < 1
    assert 0 <= bound.gap.estimate < 0.2
    assert bound.cpu_seconds > 0


def test_the_page_has_a_row_for_each_policy_and_the_command(played, times):
    text = page_text(SMALL, table_of(played, times), "train", 3)
    assert text.startswith("# small\n\nA small world.\n")
    for name in NAMES:
        assert sum(line.startswith(f"| {name} |") for line in text.splitlines()) == 1
    assert "| upper bound | bound | " in text
    assert re.search(r"The bound is \d\.\d \[.*\] % above .* takes \d+\.\d CPU seconds", text)
    widths = {line.count("|") for line in text.splitlines() if line.startswith("| r")}
    assert widths == {line.count("|") for line in text.splitlines() if "upper bound |" in line}
    assert "`coopmap/Planar-small-v1`" in text
    assert "2 robots, 3 scans each" in text
    assert "python -m coopmap_env.studies.families small --split train --worlds 3" in text
    assert "--policies" not in text
    text = page_text(SMALL, table_of(played, times), "train", 3, ";".join(NAMES))
    assert f' --out results/families \\\n    --policies "{";".join(NAMES)}"\n' in text


def test_planners_that_weigh_motion_play_where_time_ends_episodes():
    names = {
        name: set(_usual_policies(families.get(name))) for name in ("crowded", "motion-budget")
    }
    assert names["motion-budget"] - names["crowded"] == {
        "expected coverage, weighing motion",
        "expected coverage, m = 1000, weighing motion",
        "look-ahead, weighing motion",
        "predicted map, m = 1000, weighing motion",
        "predicted map, look-ahead, m = 1000, weighing motion",
    }


def test_policies_of_one_kind_of_environment_do_not_play_the_other():
    only = {
        kind: {name for name, entry in PLAYED_POLICIES.items() if entry.only == kind}
        for kind in ("planar", "field")
    }
    assert (len(only["planar"]), len(only["field"])) == (8, 2)
    assert not only["planar"] & set(_usual_policies(families.get("time")))
    assert not only["field"] & set(_usual_policies(families.get("motion-budget")))


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("greedy", "unknown policy 'greedy'; choose from random; rating"),
        ("surface, m = 100", "'surface, m = 100' is for field families, and 'crowded' is a planar"),
    ],
)
def test_names_that_do_not_fit_are_refused_before_the_first_episode(name, message, tmp_path):
    with pytest.raises(ValueError, match=message):
        play_family(families.get("crowded"), "test", [0, 1], tmp_path, names=["random", name])
    assert not list(tmp_path.iterdir())


def test_references_of_the_field_are_played_with_a_bound(tmp_path, monkeypatch):
    pytest.importorskip("pybullet")
    pytest.importorskip("embreex")
    family = families.Family(
        "yard",
        "field",
        "A worksite.",
        {"name": "worksite"},
        {"n_robots": 2, "max_scans": 20, "max_time": 4.0},
        FieldSettings(camera=DepthCamera(width=24, height=18), max_grid_poses=40),
        {"mount": "mast"},
    )
    monkeypatch.setitem(families.FAMILIES, "yard", family)
    monkeypatch.setattr(field_references, "N_DRAWN", 10)
    names = ["random", "coverage, m = 300, sequential", "clairvoyant, greedy"]
    played = play_family(family, "train", range(2), tmp_path, names=names)
    assert list(played.evaluations) == names
    bounds = played.surface_bounds
    assert bounds.n_scans == 2  # of 2 s each
    assert ((bounds.chosen > 0) & (bounds.chosen <= bounds.most) & (bounds.most <= 1)).all()
    ends = played.evaluations["clairvoyant, greedy"].table
    assert (ends["surface_coverage"] < bounds.most).all()
    assert (ends["n_rejected_actions"] + ends["n_collisions"] == 0).all()
    again = play_family(family, "train", range(2), tmp_path, names=names)
    np.testing.assert_array_equal(again.surface_bounds.most, bounds.most)

    table = table_of(played)
    row = table.rows[-1]
    assert (row.name, row.kind, list(row.scores)) == ("upper bound", "bound", ["surface_coverage"])
    assert row.scores["surface_coverage"].estimate == pytest.approx(bounds.most.mean())
    text = page_text(family, table, "train", 2)
    (line,) = [line for line in text.splitlines() if line.startswith("| upper bound |")]
    assert line.count("|") == table_text(table).splitlines()[0].count("|")
    assert "2 noise-free scans of each robot" in text
    assert "without motions" in text
    assert admission_of(table).clairvoyant.name == "clairvoyant, greedy"


def evaluation(ends):
    episodes = tuple(
        example_episode(seed, shown_curve=[0.0, 0.1, end]) for seed, end in enumerate(ends)
    )
    return Evaluation(episodes, tuple(Efficiency(end, end / 2) for end in ends))


def test_policies_are_compared_with_the_best_one_step_planner_world_by_world():
    own = {
        "a": evaluation([0.2, 0.4]), "b": evaluation([0.4, 0.6]), "c": evaluation([0.5, 0.8]),
    }  # fmt: skip
    table = table_of(Played(own, {"a": "one step", "b": "one step", "c": "look-ahead"}, 2))
    assert table.best_one_step == "b"
    rows = {row.name: row for row in table.rows}
    assert rows["b"].beyond is None
    with pytest.raises(ValueError, match="needs a random policy"):
        admission_of(table)
    assert rows["a"].beyond.estimate == pytest.approx(-0.2)
    assert rows["c"].beyond.estimate == pytest.approx(0.15)
    assert rows["c"].scores["efficiency_auc"].estimate == pytest.approx(0.325)


@pytest.mark.parametrize(
    ("random", "one_step", "clairvoyant", "is_admitted"),
    [
        ([0.3, 0.3], [0.6, 0.7], [0.8, 0.9], True),
        ([0.5, 0.4], [0.6, 0.7], [0.8, 0.9], False),  # too easy for random poses
        ([0.3, 0.3], [0.8, 0.8], [0.9, 0.95], False),  # and for one step
        ([0.3, 0.3], [0.6, 0.7], [0.65, 0.75], False),  # nothing is left for others
        ([0.3, 0.3], [0.6, 0.7], [0.6, 1.0], False),  # uncertain
    ],
)
def test_a_family_is_admitted_if_it_separates_policies(random, one_step, clairvoyant, is_admitted):
    kinds = {"a": "random", "b": "one step", "c": "clairvoyant"}
    ends = dict(zip(kinds, (random, one_step, clairvoyant), strict=True))
    table = table_of(Played({name: evaluation(own) for name, own in ends.items()}, kinds, 2))
    found = admission_of(table)
    assert found.is_admitted == is_admitted
    line = admission_text({"small": found}).splitlines()[-1]
    assert line.startswith("| small |")
    assert line.endswith("| yes |" if is_admitted else "| no |")


def test_names_of_the_table_are_policies_that_are_installed():
    specs = {entry.spec.split(":")[0] for entry in PLAYED_POLICIES.values()}
    assert specs <= {*coopmap_baselines.POLICIES, "learned", "predictive", "predictive_surface"}
