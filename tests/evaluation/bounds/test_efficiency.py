"""Efficiency: shown beyond the start, as a fraction of what a bound allows."""

import math

import numpy as np
import pytest
from plain.episodes import example_episode
from plain.small_worlds import small_world

import coopmap_baselines
from coopmap_env.evaluation import run_episode
from coopmap_env.evaluation.bounds import (
    PlanarViews,
    bound_shown,
    efficiency,
    scans_in_time,
)

SHOWN = [0.1, 0.2, 0.4]
BOUNDS = np.array([10, 40, 60])  # of 100 cells


def shown_episode(**fields):
    return example_episode(**{"shown_curve": SHOWN, **fields})


def test_efficiency_at_the_end_and_of_the_area_by_hand():
    end, area = efficiency(shown_episode(), BOUNDS, 100, scan_time=2.0)
    assert end == pytest.approx(0.3 / 0.5)
    # means of the trapezoids .15 and .3, .25 and .5, less the start of .1
    assert area == pytest.approx((0.225 - 0.1) / (0.375 - 0.1))


def test_over_time_a_bound_has_its_scans_as_early_as_can_be():
    # three scans fit into 5 s of 2 s each; the episode has two, which end after 3 and 6 s
    episode = shown_episode(elapsed_curve=[0.0, 3.0, 6.0], max_time=5.0)
    bounds = np.array([10, 40, 60, 60])
    end, area = efficiency(episode, bounds, 100, scan_time=2.0)
    assert end == pytest.approx(0.3 / 0.5)
    own = (3 * 0.15 + 2 * (0.2 + 1 / 3) / 2) / 5  # 1/3 after 5 s
    allowed = (2 * 0.25 + 2 * 0.5 + 1 * 0.6) / 5
    assert area == pytest.approx((own - 0.1) / (allowed - 0.1))


@pytest.mark.parametrize(
    ("max_time", "scan_time", "n"),
    [
        (None, 2.0, 9),
        (5.0, 2.0, 3),
        (6.0, 2.0, 3),
        (6.1, 2.0, 4),
        (1e3, 2.0, 9),
        (5.0, 0.0, 9),
        (0.3, 0.1, 3),
    ],
)
def test_as_many_scans_as_begin_in_time(max_time, scan_time, n):
    assert scans_in_time(9, max_time, scan_time) == n


def test_times_are_summed_as_the_environment_sums_them():
    assert scans_in_time(99, 1.0, 0.1) == 11  # after ten, .9999999999999999 s have passed


@pytest.mark.parametrize(
    ("fields", "bounds", "message"),
    [
        ({"shown_curve": None}, BOUNDS, "report_shown"),
        ({}, BOUNDS[:2], "2 scans need as many bounds, got 1"),
        ({}, [10, 19, 60], "do not belong"),
        ({"shown_curve": [0.1, 0.1, 0.1]}, [10, 10, 10], "do not belong"),
    ],
)
def test_bounds_of_another_world_have_no_efficiency(fields, bounds, message):
    with pytest.raises(ValueError, match=message):
        efficiency(shown_episode(**fields), np.array(bounds), 100, scan_time=2.0)


@pytest.mark.parametrize("max_time", [None, 7.0, 16.0])
def test_no_policy_has_an_efficiency_above_one(max_time):
    env = small_world(report_shown=True, max_scans=6, max_time=max_time)
    scan_time = env.settings.scan_time
    n = scans_in_time(6, max_time, scan_time)
    for seed in range(3):
        env.reset(seed=seed)
        bounds = bound_shown(PlanarViews.from_env(env, n), n).bounds
        for name in ("coverage", "random"):
            episode = run_episode(env, coopmap_baselines.make(name), seed)
            found = efficiency(episode, bounds, env.truth.occupied.size, scan_time)
            assert 0 < found.end <= 1
            assert 0 < found.area <= 1
            assert math.isclose(episode.shown_curve[0] * env.truth.occupied.size, bounds[0])
