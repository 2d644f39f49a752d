"""A stored episode that is damaged counts as missing: it is played again."""

import copy
import json
import math
from dataclasses import replace
from functools import partial

import pytest
from plain.fuzz import cases, mutants

from coopmap_env.evaluation import Evaluation, compare, episode_from_dict, is_episode
from coopmap_env.evaluation.jobs import _read
from coopmap_env.studies.localization.stored_results import is_correction_result, is_search_result
from coopmap_env.studies.localization.summary import search_summary

N_SCANS = 2
PLANAR = {
    "seed": 4, "coverage_curve": [0.0, 0.25, 0.5], "entropy_curve": [9.0, 8.5, 7.0], "reward": 1.5,
    "elapsed_curve": [0.0, 2.5, 6.0], "max_time": None,
    "motion_distance": 3.25, "log_loss": 0.125, "brier_score": 0.0625,
    "log_loss_free": 0.0625, "log_loss_occupied": 0.25,
    "extent": {"max_radius": 9.0, "mean_radius": 4.5, "radius_std": 2.0},
    "n_rejected_actions": 0, "n_collisions": 1, "planning_time_ms": 0.75, "surface": None,
}  # fmt: skip
SURFACE = {
    "coverage_curve": [0.0, 0.125, 0.25], "target_coverage": 0.5, "f_score": 0.75,
    "precision": 0.875, "recall": 0.625, "chamfer": math.nan,
    "chi2_median": 0.5, "chi2_tail": math.nan, "false_free_fraction": 0.0,
}  # fmt: skip
FIELD = {**PLANAR, "surface": SURFACE}
ERRORS = {"position": 0.01, "angle": 0.001, "nees": 6.0}
SEARCH = {"robots": [{"n_scans": 3, **ERRORS}, None], "registration_ms": [50.0, 60.0]}
CAMERA = {**ERRORS, "point_displacement": math.nan}
SCAN = {
    "corrected_directions": 6, "correction_failure": "", "n_hits": 80, "noise_floor": 0.002,
    **dict.fromkeys(("encoders", "kinematic", "estimated", "smoothed"), CAMERA),
}  # fmt: skip
MEAN_POINTS = {"linear": {"position": 0.1, "angle": 0.1}, "rigid": {"position": 0.1, "angle": 0.1}}
CORRECTED = {**SCAN, "correction_ms": 2.0, "n_fiducials": 7, "n_outliers": 1}
QUALITY = {"f_score": 0.5, "chamfer": 0.1, "log_loss": 0.2}
CORRECTION = {
    "episode": FIELD,
    "scans": [
        SCAN, {**CORRECTED, "mean_points": MEAN_POINTS}, {**CORRECTED, "mean_points": None},
    ],
    "same_scans": dict.fromkeys(
        ("encoders", "kinematic", "estimated", "smoothed", "exact"), QUALITY
    ),
}  # fmt: skip
ODD_VALUES = (
    None, True, "x", "1", [], {}, [1], {"a": 1}, -1, -0.5, 0.5, math.nan, math.inf, 10**400, 2**63,
)  # fmt: skip


def changed(value, path, new):
    """A copy of a JSON value with another value at a path."""
    value = copy.deepcopy(value)
    place = value
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = new
    return value


def paths(value, path=()):
    """Paths of all parts of a JSON value."""
    yield from [path] if path else []
    items = value.items() if isinstance(value, dict) else enumerate(value)
    for key, item in items if isinstance(value, dict | list) else ():
        if isinstance(item, dict | list):
            yield from paths(item, (*path, key))
        else:
            yield (*path, key)


def is_usable(result):
    """Whether everything that is made of an episode can be made."""
    evaluation = Evaluation((episode_from_dict(result),) * 2)
    assert all(len(column) == 2 for column in evaluation.table.values())
    assert all(curve.shape == (2, N_SCANS + 1) for curve in evaluation.curves.values())
    assert all(values.dtype == float for values in evaluation.curves.values())
    return True


@pytest.mark.parametrize("episode", [PLANAR, FIELD])
def test_a_value_of_another_type_or_range_makes_no_episode(episode):
    assert is_episode(episode, N_SCANS)
    for path in paths(episode):
        for odd in ODD_VALUES:
            result = changed(episode, path, odd)
            assert not is_episode(result, N_SCANS) or is_usable(result)


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (["seed"], "4"),
        (["seed"], 4.0),
        (["seed"], True),
        (["seed"], -4),
        (["reward"], None),
        (["reward"], "1.5"),
        (["reward"], math.nan),
        (["reward"], 10**400),
        (["n_collisions"], 0.5),
        (["n_rejected_actions"], -1),
        (["planning_time_ms"], math.inf),
        (["coverage_curve"], []),
        (["coverage_curve"], [0.5]),
        (["coverage_curve"], [0.0, 0.25]),
        (["coverage_curve"], [0.0, 0.25, 0.5, 0.75]),
        (["coverage_curve"], {"0": 0.5}),
        (["coverage_curve"], "012"),
        (["coverage_curve", 1], None),
        (["coverage_curve", 1], [0.25]),
        (["coverage_curve", 1], math.nan),
        (["coverage_curve", 1], 1.25),
        (["entropy_curve", 2], -1.0),
        (["elapsed_curve", 0], 1.0),
        (["elapsed_curve", 1], 7.0),
        (["elapsed_curve", 2], math.inf),
        (["elapsed_curve"], [0.0, 1.0]),
        (["max_time"], "6"),
        (["extent"], None),
        (["extent"], [9.0, 4.5, 2.0]),
        (["extent"], {}),
        (["extent", "max_radius"], "far"),
        (["extent", "max_radius"], math.inf),
        (["extent", "another"], 1.0),
        (["another"], 1.0),
        (["surface"], {}),
        (["surface"], []),
        (["surface", "coverage_curve"], [0.0]),
        (["surface", "f_score"], None),
    ],
)
def test_this_makes_no_episode(path, value):
    assert not is_episode(changed(FIELD, path, value), N_SCANS)


@pytest.mark.parametrize("field", FIELD)
def test_an_episode_without_a_field_is_none(field):
    result = {name: value for name, value in FIELD.items() if name != field}
    assert is_episode(result, N_SCANS) == (field == "surface")
    assert not is_episode(result, N_SCANS, with_surface=True)


@pytest.mark.parametrize("result", [None, [], [PLANAR], "episode", 1, math.nan, True, {}])
def test_other_values_than_objects_are_no_results(result):
    assert not is_episode(result)
    assert not is_search_result(result)
    assert not is_correction_result(result)


def test_an_episode_of_another_length_or_kind_is_not_used():
    assert not is_episode(PLANAR, n_scans=3)
    assert not is_episode(PLANAR, N_SCANS, with_surface=True)
    assert not is_episode(FIELD, N_SCANS, with_surface=False)
    assert is_episode(FIELD, N_SCANS, with_surface=True)


def test_only_time_that_has_run_out_makes_an_episode_shorter():
    assert is_episode({**PLANAR, "max_time": 5.0}, N_SCANS)
    assert is_episode({**PLANAR, "max_time": 5.0}, n_scans=9)
    assert not is_episode({**PLANAR, "max_time": 6.5}, n_scans=9)
    assert not is_episode({**PLANAR, "max_time": 5.0}, n_scans=1)


def test_episodes_have_what_scans_showed_if_it_is_asked_for():
    shown = {**PLANAR, "shown_curve": [0.0, 0.25, 0.25]}
    assert is_episode(shown, N_SCANS)
    assert is_episode(shown, N_SCANS, with_shown=True)
    assert not is_episode(shown, N_SCANS, with_shown=False)
    assert not is_episode(PLANAR, N_SCANS, with_shown=True)
    assert not is_episode({**PLANAR, "shown_curve": None}, N_SCANS, with_shown=True)
    for wrong in ([0.0, 0.25], [0.0, 0.25, 1.5], [0.0, 0.25, math.nan], "012"):
        assert not is_episode({**PLANAR, "shown_curve": wrong}, N_SCANS)


def test_results_of_the_localization_study_have_their_form():
    assert is_search_result(SEARCH)
    assert is_correction_result(CORRECTION, N_SCANS)
    for path in paths(SEARCH):
        for odd in (True, "x", {}, [], {"a": 1}, 10**400):
            is_list = odd == [] and path == ("registration_ms",)
            assert is_search_result(changed(SEARCH, path, odd)) == is_list
    for path in paths(CORRECTION):
        for odd in (True, {}, {"a": 1}, 10**400):
            assert not is_correction_result(changed(CORRECTION, path, odd), N_SCANS)
    for name in ("correction_ms", "n_fiducials", "n_outliers", "mean_points"):
        result = copy.deepcopy(CORRECTION)
        del result["scans"][1][name]
        assert not is_correction_result(result, N_SCANS)


DAMAGED = {
    "empty": b"",
    "cut": lambda content: content[: len(content) // 2],
    "not UTF-8": b"\xff\xfe{}",
    "UTF-16": lambda content: content.decode().encode("utf-16"),
    "zeros": lambda content: bytes(len(content)),
    "a number": b"1",
    "null": b"null",
    "a list": lambda content: b"[" + content + b"]",
    "nested too deeply": b"[" * 100_000,
    "too many digits": lambda content: content.replace(b'"reward": ', b'"reward": ' + b"9" * 5000),
    "another length": lambda content: content.replace(b'_curve": [', b'_curve": [0.0, '),
    "another type": lambda content: content.replace(b'"extent": {', b'"extent": [1], "e": {'),
    "a field less": lambda content: content.replace(b'"log_loss"', b'"log_lost"'),
}  # fmt: skip


@pytest.fixture(scope="module")
def played(tmp_path_factory):
    """One episode, and the content of its file."""
    folder = tmp_path_factory.mktemp("played")
    episode = play(folder)
    (path,) = folder.iterdir()
    return episode, path.name, path.read_bytes()


def play(folder):
    arguments = {"max_scans": N_SCANS, "split": "test"}
    (evaluation,) = compare(["random"], [4], arguments, folder, progress=False).values()
    return replace(evaluation.episodes[0], planning_time_ms=0.0)


@pytest.mark.parametrize("kind", DAMAGED)
def test_a_damaged_stored_episode_is_played_again(kind, played, tmp_path):
    episode, name, content = played
    damage = DAMAGED[kind]
    damaged = damage(content) if callable(damage) else damage
    assert damaged != content
    (tmp_path / name).write_bytes(damaged)
    assert play(tmp_path) == episode
    stored = json.loads((tmp_path / name).read_bytes())
    assert {**stored, "planning_time_ms": 0} == {**json.loads(content), "planning_time_ms": 0}


def test_a_stored_episode_is_used(played, tmp_path):
    _, name, content = played
    marked = json.loads(content)
    marked["reward"] = 12345.5
    (tmp_path / name).write_text(json.dumps(marked))
    assert play(tmp_path).reward == 12345.5


@cases(short=3_000, long=100_000)
def test_a_fuzzed_stored_result_is_used_only_where_it_can_be(n_cases, tmp_path):
    validators = [
        partial(is_episode, n_scans=N_SCANS),
        is_search_result,
        partial(is_correction_result, n_scans=N_SCANS),
    ]
    path, n_used = tmp_path / "result.json", 0
    originals = [json.dumps(value).encode() for value in (PLANAR, FIELD, SEARCH, CORRECTION)]
    for content in mutants(originals, n_cases):
        path.write_bytes(content)
        for is_valid in validators:
            result = _read(path, is_valid)
            if result is None:
                continue
            n_used += 1
            if is_valid is is_search_result:
                if n_used % 50 == 0:  # it draws thousands of bootstrap samples
                    search_summary([result, result])
            else:
                assert is_usable(result.get("episode", result))
    assert n_used > 0.01 * n_cases
