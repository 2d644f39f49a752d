import numpy as np
import pytest
from plain.episodes import example_episode

from coopmap_env.evaluation import Evaluation, MappedExtent
from coopmap_env.studies.section3.trends import (
    equal_coverage,
    extent_decreases,
    raster_coverage_is_lower,
    smallest_search_is_widest,
)


def evaluation(coverage, sigma=5.0, worlds=24, seed=0):
    """Worlds whose scores scatter a little around the given ones."""
    rng = np.random.default_rng(seed)

    def scatter(value):
        return value * (1 + 0.05 * rng.standard_normal())

    return Evaluation(
        tuple(
            example_episode(
                world,
                (0.0, scatter(coverage)),
                extent=MappedExtent(4 * scatter(sigma), 2 * sigma, scatter(sigma)),
            )
            for world in range(worlds)
        )
    )


def searches(coverages, sigmas=(5.0, 5.0, 5.0)):
    return {
        f"m{k}": evaluation(coverage, sigma, seed=k)
        for k, (coverage, sigma) in enumerate(zip(coverages, sigmas, strict=True))
    }


def test_equal_coverage_is_held_within_the_margin():
    trend = equal_coverage(searches([0.09, 0.092, 0.088]))
    assert trend.held
    assert trend.value < 0.15


def test_equal_coverage_is_not_held_if_one_search_is_far_off():
    trend = equal_coverage(searches([0.09, 0.09, 0.05]))
    assert not trend.held
    # mean 0.0767: the third lies at 0.65 of it
    assert trend.details["ratio_to_mean"]["m2"]["estimate"] == pytest.approx(0.652, abs=0.01)


def test_a_raster_scan_with_half_the_coverage_is_far_less():
    trend = raster_coverage_is_lower(evaluation(0.045, seed=9), searches([0.09, 0.1, 0.09]))
    assert trend.held
    assert trend.value == pytest.approx(0.5, abs=0.03)
    assert trend.p_value < 1e-4


def test_a_raster_scan_with_slightly_less_coverage_is_not_far_less():
    trend = raster_coverage_is_lower(evaluation(0.08, seed=9), searches([0.09, 0.1, 0.09]))
    assert not trend.held
    assert trend.p_value < 0.05


def test_decreasing_extents_are_detected():
    trend = extent_decreases(searches([0.09] * 3, sigmas=(9.0, 8.0, 7.0)))
    assert trend.held
    assert trend.p_value < 1e-6


def test_increasing_extents_are_not_decreasing():
    trend = extent_decreases(searches([0.09] * 3, sigmas=(7.0, 8.0, 9.0)))
    assert not trend.held
    assert trend.p_value > 0.9


def test_the_smallest_search_is_widest_if_it_views_further_than_the_next():
    trend = smallest_search_is_widest(searches([0.09] * 3, sigmas=(9.0, 8.0, 7.0)))
    assert trend.held
    assert trend.verdict == "above"
    assert trend.value > 0


def test_a_smallest_search_that_is_narrower_within_noise_is_not_called_wider():
    trend = smallest_search_is_widest(searches([0.09] * 3, sigmas=(5.0, 5.0, 5.0)))
    assert trend.held
    assert trend.verdict == "within noise: not shown to be lower"
    assert trend.as_dict()["verdict"] == trend.verdict


def test_a_smallest_search_that_is_surely_narrower_is_not_widest():
    trend = smallest_search_is_widest(searches([0.09] * 3, sigmas=(8.0, 9.0, 7.0)))
    assert not trend.held
    assert trend.verdict == "below"
    assert trend.details["radius_std"]["high"] < 0


def test_a_trend_is_json():
    import json

    text = json.dumps(extent_decreases(searches([0.09] * 3)).as_dict())
    assert '"held": ' in text
