"""The equality study: a short run of it, and differences that it must find."""

import json
import subprocess
import sys
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from coopmap_env.studies.equality import (
    Case,
    Counts,
    DifferenceError,
    field_cases,
    jobs,
    planar_cases,
    play_case,
)
from coopmap_env.studies.equality.__main__ import main
from coopmap_env.studies.equality.shown import first_difference
from coopmap_env.vector import PlanarVectorEnv

SMALL = Case(
    "planar",
    {"scene": "obstacles", "n_robots": 2, "max_scans": 3},
    {"autoreset_mode": "SameStep"},
    n_worlds=2,
    n_steps=5,
)


def test_planar_vector_environments_are_single_ones_in_a_short_run():
    total, cases = Counts(), list(planar_cases())[::23]
    for case in cases:
        total += play_case(replace(case, n_steps=20), 120, np.random.default_rng(0))
    assert total.steps == len(cases) * 120
    assert total.collisions > 0
    assert total.episodes_ended >= len(cases) * 6
    assert set(total.rejections) == {
        "outside the world",
        "goal is unknown",
        "goal is not known to be free",
        "no path through known free space leads there",
        "candidate is masked out",
    }


@pytest.mark.parametrize("number", [5, 36], ids=["candidates", "search-pose"])
def test_field_vector_environments_are_single_ones_in_a_short_run(number):
    pytest.importorskip("pybullet")
    pytest.importorskip("embreex")
    case = list(field_cases())[number]
    short = replace(case, arguments={**case.arguments, "max_scans": 2}, n_worlds=2, n_steps=4)
    assert play_case(short, 1, np.random.default_rng(0)).steps == 8


def test_cases_have_every_kind_of_reset_and_number_of_threads_or_workers_for_each_team():
    for cases, parallel in ((planar_cases(), "num_threads"), (field_cases(), "num_workers")):
        ways = Counter(
            (c.arguments["n_robots"], c.options["autoreset_mode"], c.options[parallel])
            for c in cases
        )
        assert len(ways) == 5 * 2 * 2
        assert len(set(ways.values())) == 1


def patched(monkeypatch, method, change):
    """Let a method of the planar vector environment give results that are changed."""
    original, calls = getattr(PlanarVectorEnv, method), []

    def changed(env, *args, **kwargs):
        calls.append(None)
        results = original(env, *args, **kwargs)
        change(len(calls), *results)
        return results

    monkeypatch.setattr(PlanarVectorEnv, method, changed)


def one_unit_more(values, at):
    values[at] = np.nextafter(values[at], np.inf)


def test_a_reward_that_is_larger_by_one_unit_in_the_last_place_is_found(monkeypatch):
    def change(call, observations, rewards, terminated, truncated, infos):
        if call == 2:
            one_unit_more(rewards, 3)

    patched(monkeypatch, "step", change)
    with pytest.raises(DifferenceError) as raised:
        play_case(SMALL, 1, np.random.default_rng(0))
    found = raised.value.difference
    assert found.plays == "vector beside single environments"
    assert (found.world, found.robot, found.step, found.entry) == (1, 1, 2, "reward")
    assert float(found.found) == np.nextafter(float(found.expected), np.inf)
    assert "scene='obstacles'" in str(raised.value)
    assert f"world 1 of seed {found.seed}, step 2, robot_1, reward: " in str(raised.value)


def test_what_only_the_replay_does_is_found(monkeypatch):
    def change(call, observations, infos):
        if call == 2:
            observations["map"][2, 1, 4, 5] ^= 1

    patched(monkeypatch, "reset", change)
    with pytest.raises(DifferenceError) as raised:
        play_case(SMALL, 1, np.random.default_rng(0))
    found = raised.value.difference
    assert found.plays == "replayed beside first play"
    assert (found.world, found.robot, found.step) == (1, 0, 0)
    assert found.entry == "observation map [1, 4, 5]"


@pytest.mark.parametrize(
    ("entry", "change"),
    [
        ("info rejected_reason", lambda infos: infos["rejected_reason"].__setitem__(1, 7)),
        ("info reward_coverage", lambda infos: one_unit_more(infos["reward_coverage"], 1)),
        ("info _collided", lambda infos: infos.__setitem__("_collided", ~infos["_collided"])),
        ("info distance", lambda infos: infos.pop("distance")),
    ],
)
def test_a_changed_info_is_found(entry, change, monkeypatch):
    patched(monkeypatch, "step", lambda call, *results: change(results[-1]))
    with pytest.raises(DifferenceError) as raised:
        play_case(SMALL, 1, np.random.default_rng(0))
    assert raised.value.difference.entry == entry


def test_a_changed_last_observation_is_found_in_its_row(monkeypatch):
    def change(call, observations, rewards, terminated, truncated, infos):
        if "final_obs" in infos:
            one_unit_more(infos["final_obs"][2]["pose"], 3)

    patched(monkeypatch, "step", change)
    with pytest.raises(DifferenceError) as raised:
        play_case(SMALL, 1, np.random.default_rng(0))
    found = raised.value.difference
    assert (found.step, found.world, found.robot) == (3, 1, 0)
    assert found.entry == "last observation pose [3]"


def test_arrays_are_equal_only_with_the_same_bytes():
    nan, zero = {"x": np.array([np.nan, 1.0])}, {"x": np.array([0.0])}
    assert first_difference(nan, {"x": np.array([np.nan, 1.0])}) is None
    assert first_difference(zero, {"x": np.array([-0.0])}) == (0, "x", "0.0", "-0.0")
    other = first_difference(zero, {"x": np.array([0])})
    assert other == (0, "x", "float64 of shape (1,)", "int64 of shape (1,)")
    assert first_difference(zero, {}) == (0, "x", "present", "absent")


def test_the_command_writes_a_record_and_ends_with_1_after_a_difference(tmp_path, monkeypatch):
    options = [str(tmp_path / "record.json"), "--planar-steps", "1", "--field-steps", "0"]
    patched(monkeypatch, "step", lambda call, *results: one_unit_more(results[1], 0))
    with pytest.raises(SystemExit) as ended:
        main(options)
    assert ended.value.code == 1
    record = json.loads((tmp_path / "record.json").read_text())
    (difference,) = record["planar"]["differences"]
    assert difference["entry"] == "reward"

    monkeypatch.undo()
    main(options)  # a case with a difference is played again
    record = json.loads((tmp_path / "record.json").read_text())
    assert record["planar"]["differences"] == []
    assert record["planar"]["steps"] == sum(case["steps"] for case in record["planar"]["cases"])


def test_finished_cases_are_kept_as_long_as_the_sources_are_the_same(tmp_path, monkeypatch):
    played = []

    def play(case, n_steps, rng):
        played.append(n_steps)
        return Counts(n_steps, 2 * n_steps, 1, 3, Counter({"goal is unknown": 1}))

    monkeypatch.setattr(jobs, "play_case", play)
    first = jobs.play_cases("field", 7, 0, tmp_path)
    assert played == [1] * 7
    assert (first["steps"], first["robot_steps"], first["collisions"]) == (7, 14, 21)
    assert first["rejections"] == {"goal is unknown": 7}
    assert jobs.play_cases("field", 7, 0, tmp_path) == first
    assert len(played) == 7
    monkeypatch.setattr(jobs, "source_hash", lambda: "others")
    jobs.play_cases("field", 7, 0, tmp_path)
    assert len(played) == 14


def test_the_command_plays_cases_beside_each_other(tmp_path):
    command = [sys.executable, "-m", "coopmap_env.studies.equality", str(tmp_path / "record.json")]
    options = ["--planar-steps", "2", "--field-steps", "0", "--workers", "2"]
    subprocess.run([*command, *options], check=True, capture_output=True)
    record = json.loads((tmp_path / "record.json").read_text())
    assert len(record["planar"]["cases"]) == 2
    assert record["planar"]["differences"] == []
