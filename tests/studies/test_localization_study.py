import json
import math
from functools import partial

import numpy as np
import pytest
from plain.pages import check_report_page
from scipy import stats

from coopmap_env.cli import main
from coopmap_env.evaluation.statistics import bootstrap_clusters
from coopmap_env.studies.localization import estimator_comparison, map_quality
from coopmap_env.studies.localization import study as localization_study
from coopmap_env.studies.localization import summary as summary_module
from coopmap_env.studies.localization.episodes import run_search_episode
from coopmap_env.studies.localization.estimator_comparison import (
    ESTIMATORS,
    compare_pose_estimators,
)
from coopmap_env.studies.localization.map_quality import same_scans_summary
from coopmap_env.studies.localization.study import LocalizationSize
from coopmap_env.studies.localization.summary import (
    errors_summary,
    nees_summary,
    search_summary,
)
from coopmap_env.studies.localization.verdicts import at_least, is_not_worse


@pytest.fixture(autouse=True)
def few_resamples(monkeypatch):
    """Intervals of 200 resamples: wider ones, in a tenth of the time."""
    few = partial(bootstrap_clusters, n_resamples=200)
    for module in (summary_module, map_quality):
        monkeypatch.setattr(module, "bootstrap_clusters", few)


def robot(scans, position=0.01, angle=0.001, nees=6.0):
    return {"n_scans": scans, "position": position, "angle": angle, "nees": nees}


SEARCHES = [
    {"robots": [robot(1), robot(4)], "registration_ms": [50.0]},
    {"robots": [robot(3, position=0.5), None], "registration_ms": [70.0, 90.0]},
]


def test_a_robot_counts_as_located_within_the_scans_that_it_took():
    found = search_summary(SEARCHES)
    shares = {k: share["estimate"] for k, share in found["located_fraction"].items()}
    assert (shares["1"], shares["3"], shares["4"], shares["10"]) == (0.25, 0.5, 0.75, 0.75)
    assert found["never_located"] == 1
    assert found["robots"] == 4


def test_a_base_half_a_metre_off_is_a_false_match():
    assert search_summary(SEARCHES)["false_matches"] == 1
    turned = [{"robots": [robot(1, angle=0.1), robot(2)], "registration_ms": [1.0]}] * 2
    assert search_summary(turned)["false_matches"] == 2


def test_errors_of_bases_are_those_of_located_robots():
    found = search_summary(SEARCHES)
    assert found["position_error"]["median"]["estimate"] == pytest.approx(0.01)
    assert found["largest_errors"] == [0.5, 0.001]
    assert found["registration_ms"]["median"] == 70.0


def scan(before, after):
    errors = ("position", "angle", "point_displacement")
    values = {"encoders": before, "kinematic": before, "estimated": after, "smoothed": after}
    return {kind: dict.fromkeys(errors, value) for kind, value in values.items()}


def test_the_error_ratio_is_that_of_the_medians():
    groups = [[scan(8.0, 1.0), scan(10.0, 2.0)], [scan(12.0, 4.0), scan(math.nan, 1.0)]]
    found = errors_summary(groups, np.random.default_rng(0))
    assert found["scans"] == 4
    assert found["position"]["encoders"]["error_ratio"]["estimate"] == 1.0
    ratio = found["position"]["estimated"]["error_ratio"]
    assert ratio["estimate"] == 5.0  # 10 over 2, without the scan that has no points
    assert ratio["low"] <= 5.0 <= ratio["high"]
    assert found["point_displacement"]["encoders"]["median"]["estimate"] == 10.0


def test_the_95th_percentile_is_compared_with_that_of_the_prediction():
    groups = [[scan(8.0, 1.0)] * 10, [scan(8.0, 3.0)] * 10]
    found = errors_summary(groups, np.random.default_rng(0))["position"]
    assert found["kinematic"]["p95_minus_kinematic"]["estimate"] == 0.0
    assert found["smoothed"]["p95_minus_kinematic"]["estimate"] == -5.0


def test_the_gap_is_that_between_encoders_and_exact_poses():
    """Half of it by the prediction, four fifths when fused, nine tenths by all scans."""
    values = {"encoders": 2.0, "kinematic": 1.5, "estimated": 1.2, "smoothed": 1.1, "exact": 1.0}
    scores = ("f_score", "chamfer", "log_loss")
    same = {kind: dict.fromkeys(scores, value) for kind, value in values.items()}
    found = same_scans_summary([{"same_scans": same}] * 3)
    closed = {
        kind: found["gap_closed"][kind]["chamfer"]["estimate"] for kind in found["gap_closed"]
    }
    assert closed == pytest.approx({"kinematic": 0.5, "estimated": 0.8, "smoothed": 0.9})
    assert found["smoothed_minus_estimated"]["f_score"]["estimate"] == pytest.approx(-0.1)


def test_verdicts_follow_from_the_intervals():
    sure = {"estimate": 3.8, "low": 3.6, "high": 4.0}
    assert at_least(sure, 3.5) == "the goal of 3.5 is reached"
    assert at_least(sure, 5.0) == "the goal of 5 is missed"
    assert at_least(sure, 3.9) == "the interval does not decide whether it is 3.9"
    assert is_not_worse({"estimate": -1.0, "low": -2.0, "high": -0.5}) == "it is smaller"
    assert is_not_worse({"estimate": 1.0, "low": 0.5, "high": 2.0}) == "it is larger"
    assert is_not_worse({"estimate": -1.0, "low": -2.0, "high": 0.5}) == "no difference is shown"


def test_consistent_errors_lie_in_the_band_and_overconfident_ones_do_not():
    rng = np.random.default_rng(0)
    groups = [stats.chi2.rvs(6, size=20, random_state=rng) for _ in range(20)]
    found = nees_summary(groups)
    np.testing.assert_allclose(found["band"], stats.chi2.ppf([0.025, 0.975], 2400) / 400)
    assert found["in_band"]
    assert not nees_summary([1.5 * group for group in groups])["in_band"]
    assert nees_summary([np.zeros(0)]) == {"scans": 0}


def test_clusters_are_resampled_as_a_whole():
    groups = [[0.0] * 50, [1.0] * 50]

    def mean(rows):
        return float(rows.mean())

    found = bootstrap_clusters(groups, mean, np.random.default_rng(0))
    assert found.estimate == 0.5
    assert (found.low, found.high) == (0.0, 1.0)  # a quarter of the resamples has one group alone
    with pytest.raises(ValueError, match="at least 2, got 1"):
        bootstrap_clusters(groups[:1], mean, np.random.default_rng(0))


def test_an_estimator_that_uses_more_information_has_smaller_errors(monkeypatch):
    """At the default noise: Eq. 12 < Umeyama < the Gaussian solution, and outliers matter."""
    monkeypatch.setattr(estimator_comparison, "NOISE_FACTORS", (1.0, 4.0))
    clean = compare_pose_estimators(np.random.default_rng(0), 80, 0.0)
    monkeypatch.setattr(estimator_comparison, "NOISE_FACTORS", (1.0,))
    moved = compare_pose_estimators(np.random.default_rng(0), 80, 0.2)
    linear, _, umeyama, rejected, gaussian, both = ESTIMATORS
    error = {name: clean[name]["position"][0] for name in ESTIMATORS}
    assert error[linear] > error[umeyama] > error[gaussian] >= error[both]
    assert moved[umeyama]["position"][0] > 1.5 * moved[rejected]["position"][0]
    for name in ESTIMATORS:  # all of them follow the noise
        assert clean[name]["angle"][1] > clean[name]["angle"][0]


def test_a_search_ends_when_all_are_located():
    pytest.importorskip("small_gicp")
    job = {
        "seed": 0,
        "split": "train",
        "max_scans": 8,
        "scene": "worksite",
        "policy": "rating_function:search=50",
    }
    found = run_search_episode(job)
    assert len(found["robots"]) == 2
    for base in found["robots"]:
        assert base is None or (1 <= base["n_scans"] <= 8 and base["position"] < 0.2)


@pytest.mark.slow
def test_the_command_writes_report_and_summary(tmp_path, monkeypatch, capsys):
    for module in ("small_gicp", "matplotlib", "jinja2"):
        pytest.importorskip(module)
    monkeypatch.setattr(localization_study, "QUICK", LocalizationSize(2, 2, 5))
    monkeypatch.setattr(localization_study, "SCANS_EACH", 3)
    main(["localization", "--quick", "--out", str(tmp_path)])
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["search"]["robots"] == 4
    assert set(summary["search"]["located_fraction"]["6"]) == {"estimate", "low", "high"}
    assert summary["search"]["false_matches"] == 0
    for part in ("all_scans", "corrected_scans"):
        assert "error_ratio" in summary["correction"][part]["position"]["smoothed"]
    assert len(summary["verdicts"]) == 12
    for setting in ("encoders", "kinematic", "fiducials", "exact"):
        assert set(summary["map_quality"][setting]) == {
            "f_score",
            "chamfer",
            "log_loss",
            "surface_coverage",
        }
    page = (tmp_path / "report.html").read_text()
    check_report_page(page)
    assert page.count('class="chart"') == 3
    assert "False matches" in page
    assert "located within 6 scans" in capsys.readouterr().out
