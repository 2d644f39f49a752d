import numpy as np
import pytest

from coopmap_env.studies.section3.deviation import (
    PAPER_NUMBERS,
    deviation_interval,
    mean_deviation,
    relative_deviations,
)


def test_the_papers_own_numbers_deviate_by_nothing():
    assert mean_deviation(PAPER_NUMBERS) == 0.0


def test_the_mean_deviation_counts_both_directions_alike():
    ours = PAPER_NUMBERS.copy()
    ours[0, 0] *= 1.18  # one of 18 numbers 18 % too large, another one 9 % too small
    ours[5, 2] *= 0.91
    assert mean_deviation(ours) == pytest.approx((0.18 + 0.09) / 18)
    assert relative_deviations(ours)[5, 2] == pytest.approx(-0.09)


def test_tables_can_be_stacked():
    stacked = np.stack([PAPER_NUMBERS, 1.1 * PAPER_NUMBERS])
    assert mean_deviation(stacked) == pytest.approx([0.0, 0.1])


def test_the_interval_holds_the_deviation_of_the_means_over_worlds():
    rng = np.random.default_rng(0)
    scores = PAPER_NUMBERS * (1.1 + 0.2 * rng.standard_normal((40, 1, 1)))
    interval = deviation_interval(scores, np.random.default_rng(1))
    assert interval.estimate == pytest.approx(mean_deviation(scores.mean(axis=0)))
    assert interval.low < interval.estimate < interval.high


def test_worlds_without_noise_have_an_interval_of_no_width():
    interval = deviation_interval(np.stack([1.1 * PAPER_NUMBERS] * 3), np.random.default_rng(0))
    assert (interval.low, interval.high) == pytest.approx((0.1, 0.1))
