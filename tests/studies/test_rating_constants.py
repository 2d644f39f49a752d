"""The choice of the rating function's constants: its rules by hand, and a short search."""

import json

import numpy as np
import pytest

from coopmap_env.core.version import __version__
from coopmap_env.envs.field import FieldSettings
from coopmap_env.envs.planar import PlanarSettings
from coopmap_env.evaluation.statistics.interval import Interval
from coopmap_env.information import FieldRatingSettings, PlanarRatingSettings
from coopmap_env.studies.rating_constants import sweep
from coopmap_env.studies.rating_constants.choice import (
    Trial,
    area_at_motion,
    best_area,
    difference,
    largest_good,
)


def trial(K, area, motion, **constants):
    settings = PlanarRatingSettings(K=K, **constants)
    return Trial(settings, np.asarray(area, dtype=float), np.asarray(motion, dtype=float))


def test_the_largest_motion_weight_within_two_per_cent_of_the_best_area_is_chosen():
    areas = {0.0: 0.099, 0.1: 0.100, 0.2: 0.0981, 0.3: 0.0979, 0.4: 0.05}
    trials = [trial(K, [area - 0.01, area + 0.01], [1, 1]) for K, area in areas.items()]
    assert best_area(trials).constants.K == 0.1
    assert largest_good(trials).constants.K == 0.2
    assert largest_good(trials[::-1]).constants.K == 0.2


def test_the_area_at_a_motion_lies_between_the_two_trials_beside_it():
    trials = [
        trial(0.1, [0.5, 0.3], [100, 60]),
        trial(0.2, [0.4, 0.2], [50, 30]),
        trial(0.3, [0.1, 0.1], [10, 10]),
    ]
    # 60 is half of the way from 40 to 80
    assert area_at_motion(trials, 60.0) == pytest.approx([0.45, 0.25])
    assert area_at_motion(trials[::-1], 40.0) == pytest.approx([0.4, 0.2])
    assert area_at_motion(trials, 81.0) is None
    assert area_at_motion(trials, 9.0) is None


def test_differences_are_taken_world_by_world():
    assert difference(np.array([0.3, 0.5]), np.array([0.2, 0.4])) == Interval(
        pytest.approx(0.1), pytest.approx(0.1), pytest.approx(0.1)
    )


@pytest.mark.parametrize(
    ("better", "expected"), [(0.01, (2.0, 128)), (0.0, (1.0, 64)), (-0.01, (1.0, 64))]
)
def test_other_exponents_and_bins_are_chosen_only_if_they_are_surely_better(better, expected):
    rng = np.random.default_rng(0)
    area, noise = rng.uniform(0.1, 0.2, 40), rng.normal(0, 0.001, 40)
    chosen = trial(0.1, area, np.full(40, 50))
    other = area + better + noise - noise.mean()
    by_exponent = {
        2.0: [
            trial(K, other, np.full(40, motion), exponent=2.0) for K, motion in ((1, 9), (0, 90))
        ],
        0.5: [trial(0.1, other, np.full(40, 90.0), exponent=0.5)],  # moves too much
    }
    by_bins = {128: trial(0.1, other, np.full(40, 50), n_gray_bins=128)}
    record = sweep.describe(sweep.SWEEPS[0], [chosen], chosen, by_exponent, by_bins)
    assert record["choice"] == {
        "K": 0.1, "exponent": expected[0], "n_gray_bins": expected[1],
    }  # fmt: skip
    assert record["exponents_that_do_not_reach_this_motion"] == ["0.5"]
    assert [one["K"] for one in record["trials"]] == [0.1, 1, 0, 0.1, 0.1]


@pytest.fixture
def short(monkeypatch):
    monkeypatch.setattr(sweep, "ENV_KWARGS", {"max_scans": 2, "split": "train"})
    monkeypatch.setattr(sweep, "OTHER_N_BINS", (32,))
    monkeypatch.setattr(sweep, "POLICY", "rating_function:search=5")
    planar = sweep.Sweep(
        "planar", sweep.PlanarSettings(), "coverage_auc", 2, 3, {1.0: (0.0, 0.5), 2.0: (0.1,)}
    )
    monkeypatch.setattr(sweep, "SWEEPS", (planar,))


def test_a_search_writes_its_record_and_continues_after_an_interruption(short, tmp_path):
    sweep.main([str(tmp_path)])
    record = json.loads((tmp_path / "planar.json").read_text())
    assert [(t["K"], t["exponent"], t["n_gray_bins"]) for t in record["trials"]] == [
        (0.0, 1.0, 64), (0.5, 1.0, 64), (0.1, 2.0, 64), (record["choice"]["K"], 1.0, 32),
    ]  # fmt: skip
    again = record["other_worlds"]
    assert again["worlds"] == "seeds 2 to 4"
    assert again["trials"][-1]["n_gray_bins"] == 32
    episodes = sorted((tmp_path / "episodes").glob("*.json"))
    assert len(episodes) == 2 * 4 + 3 * len(again["trials"])
    written = {path: path.stat().st_mtime_ns for path in episodes}
    episodes[0].unlink()
    sweep.main([str(tmp_path)])
    assert json.loads((tmp_path / "planar.json").read_text()) == record
    assert {p: p.stat().st_mtime_ns for p in episodes[1:]} == {
        p: t for p, t in written.items() if p != episodes[0]
    }


@pytest.mark.parametrize(
    ("name", "defaults"), [("planar", PlanarRatingSettings()), ("field", FieldRatingSettings())]
)
def test_the_defaults_are_those_of_the_record(name, defaults):
    record = json.loads((sweep.RECORDS / f"{name}.json").read_text())
    assert record["choice"] == {
        "K": defaults.K,
        "exponent": defaults.exponent,
        "n_gray_bins": defaults.n_gray_bins,
    }


@pytest.mark.parametrize(
    ("name", "defaults"), [("planar", PlanarSettings()), ("field", FieldSettings())]
)
def test_the_records_were_played_with_the_present_settings(name, defaults):
    record = json.loads((sweep.RECORDS / f"{name}.json").read_text())
    present = json.loads(json.dumps(sweep.played_settings(defaults)))
    assert record["settings"] == present
    assert record["version"] == __version__


def test_played_settings_leave_out_only_what_is_swept():
    other_beam = sweep.played_settings(PlanarSettings.v0())["beam"]
    played = sweep.played_settings(PlanarSettings())
    assert other_beam != played["beam"]
    assert set(played["rating"]) == {
        "interpretation", "hidden", "alpha_position", "alpha_heading",
    }  # fmt: skip
