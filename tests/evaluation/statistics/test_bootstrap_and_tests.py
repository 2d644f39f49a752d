import numpy as np
import pytest

from coopmap_env.evaluation.statistics import (
    Interval,
    bootstrap_interquartile_mean,
    bootstrap_mean,
    bootstrap_paired_difference,
    equivalence_test,
    interquartile_mean,
    page_trend_test,
    probability_of_improvement,
)

WORLDS = np.random.default_rng(7).normal(10.0, 2.0, size=(24, 4))


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def test_an_interval_reads_as_estimate_and_bounds():
    assert str(Interval(9.1234, 8.9, 9.333)) == "9.12 [8.90, 9.33]"
    assert f"{Interval(0.5, 0.25, 0.75):.1%}" == "50.0% [25.0%, 75.0%]"


def test_an_interval_as_dict_names_its_parts():
    assert Interval(2.0, 1.0, 3.0).as_dict() == {"estimate": 2.0, "low": 1.0, "high": 3.0}


def test_the_interquartile_mean_of_one_to_eight_is_the_mean_of_three_to_six():
    assert interquartile_mean([8, 1, 7, 2, 6, 3, 5, 4]) == 4.5


def test_the_interquartile_mean_ignores_an_outlier_that_moves_the_mean():
    assert interquartile_mean([1, 2, 3, 4, 5, 6, 7, 800]) == 4.5
    assert interquartile_mean([3.0]) == 3.0


def test_the_bootstrap_of_two_worlds_spans_both():
    # a resample is (1, 1), (1, 3), (3, 1) or (3, 3): a quarter of the means lie at either end
    assert bootstrap_mean([1.0, 3.0], rng()) == Interval(2.0, 1.0, 3.0)


def test_the_paired_difference_sees_what_the_spread_of_worlds_hides():
    hard_and_easy = np.array([1.0, 50.0, 7.0, 90.0, 20.0])
    gain = np.array([1.0, 1.2, 0.8, 1.1, 0.9])
    interval = bootstrap_paired_difference(hard_and_easy + gain, hard_and_easy, rng())
    assert interval.estimate == pytest.approx(1.0)
    assert interval.low > 0.8
    assert interval.high < 1.2


def test_the_paired_difference_takes_another_statistic():
    a, b = np.array([1.0, 2.0, 3.0, 100.0, 5.0]), np.zeros(5)
    assert bootstrap_paired_difference(a, b, rng(), statistic=np.median).estimate == 3.0


def test_swapping_the_pair_mirrors_the_difference():
    a, b = WORLDS[:, 0], WORLDS[:, 1]
    forth = bootstrap_paired_difference(a, b, rng())
    back = bootstrap_paired_difference(b, a, rng())
    # the same resamples with every sign turned
    assert back.estimate == pytest.approx(-forth.estimate)
    assert back.low == pytest.approx(-forth.high)
    assert back.high == pytest.approx(-forth.low)


def test_the_probability_of_improvement_counts_a_tie_as_half():
    # wins, ties, losses: 2, 1, 1 of four worlds
    interval = probability_of_improvement([2, 3, 1, 0], [1, 1, 1, 1], rng())
    assert interval.estimate == (2 + 0.5) / 4
    assert 0 <= interval.low < interval.estimate < interval.high <= 1


def test_the_probabilities_of_improvement_both_ways_add_to_one():
    a, b = WORLDS[:, 0], WORLDS[:, 1]
    forth, back = probability_of_improvement(a, b, rng()), probability_of_improvement(b, a, rng())
    assert forth.estimate + back.estimate == pytest.approx(1.0)


def test_winning_every_world_leaves_the_resamples_no_choice():
    assert probability_of_improvement([2, 3], [1, 1], rng()) == Interval(1.0, 1.0, 1.0)


def test_the_pooled_interquartile_mean_is_that_of_all_strata_together():
    interval = bootstrap_interquartile_mean([[1, 2, 3], [4, 5, 6, 7, 8]], rng())
    assert interval.estimate == 4.5
    assert interval.low < 4.5 < interval.high


def test_strata_are_resampled_separately():
    # strata that do not vary leave nothing to resample, though the pooled values differ
    interval = bootstrap_interquartile_mean([[1.0, 1.0, 1.0, 1.0], [5.0, 5.0, 5.0, 5.0]], rng())
    assert interval == Interval(3.0, 3.0, 3.0)


def test_page_statistic_of_two_perfect_rankings_by_hand():
    # rank sums 2, 4, 6 by predicted ranks 1, 2, 3; one of 36 pairs of rankings does as well
    trend = page_trend_test([[10, 20, 30], [1, 2, 3]])
    assert trend.statistic == 1 * 2 + 2 * 4 + 3 * 6
    assert trend.p_value == pytest.approx(1 / 36)


def test_page_statistic_of_a_published_table():
    # ten students rate tutorial, lecture and seminar: the worked example of scipy's manual
    ratings = np.array(
        [
            [3, 4, 3],
            [2, 2, 4],
            [3, 3, 5],
            [1, 3, 2],
            [2, 3, 2],
            [2, 4, 5],
            [1, 2, 4],
            [3, 4, 4],
            [2, 4, 5],
            [1, 3, 4],
        ]
    )
    trend = page_trend_test(ratings)
    assert trend.statistic == 133.5
    assert trend.p_value == pytest.approx(0.00182, abs=5e-6)


def test_a_decreasing_trend_is_an_increasing_one_reversed():
    falling = WORLDS + np.array([3.0, 2.0, 1.0, 0.0])
    trend = page_trend_test(falling, "decreasing")
    assert trend == page_trend_test(falling[:, ::-1])
    assert trend.p_value < 0.01
    assert page_trend_test(falling).p_value > 0.99


def test_columns_that_never_differ_show_no_trend():
    assert page_trend_test(np.full((20, 4), 3.0)).p_value == pytest.approx(0.5)


def test_columns_within_the_margin_are_equivalent():
    level = WORLDS[:, :1]
    table = level * np.array([1.0, 1.01, 0.99])
    result = equivalence_test(table, 0.05, rng())
    assert result.equivalent
    # the columns are proportional, so every resample has the same ratios
    np.testing.assert_allclose([i.low for i in result.intervals], [1.0, 1.01, 0.99])
    assert result.max_deviation == pytest.approx(0.01)


def test_one_column_outside_the_margin_breaks_equivalence():
    table = WORLDS[:, :1] * np.array([1.0, 1.0, 1.3])
    result = equivalence_test(table, 0.05, rng())
    assert not result.equivalent
    assert result.max_deviation == pytest.approx(1.3 / 1.1 - 1)


def test_equal_means_over_too_few_noisy_worlds_do_not_prove_equivalence():
    result = equivalence_test([[1.0, 3.0], [3.0, 1.0], [2.0, 2.0]], 0.1, rng())
    assert [i.estimate for i in result.intervals] == [1.0, 1.0]
    assert not result.equivalent


def test_equivalence_does_not_depend_on_the_unit():
    metres = equivalence_test(WORLDS, 0.2, rng())
    millimetres = equivalence_test(1000 * WORLDS, 0.2, rng())
    assert metres.equivalent == millimetres.equivalent
    assert metres.max_deviation == pytest.approx(millimetres.max_deviation)


RANDOMISED = {
    "mean": lambda g: bootstrap_mean(WORLDS[:, 0], g),
    "difference": lambda g: bootstrap_paired_difference(WORLDS[:, 0], WORLDS[:, 1], g),
    "interquartile mean": lambda g: bootstrap_interquartile_mean(list(WORLDS.T), g),
    "improvement": lambda g: probability_of_improvement(WORLDS[:, 0], WORLDS[:, 1], g),
    "equivalence": lambda g: equivalence_test(WORLDS, 0.05, g),
}


@pytest.mark.parametrize("compute", RANDOMISED.values(), ids=RANDOMISED.keys())
def test_the_same_generator_gives_the_same_interval(compute):
    assert compute(rng(3)) == compute(rng(3))


@pytest.mark.parametrize("compute", RANDOMISED.values(), ids=RANDOMISED.keys())
def test_all_draws_are_from_the_given_generator(compute):
    generator = rng(3)
    before = generator.bit_generator.state
    compute(generator)
    assert generator.bit_generator.state != before


def test_a_higher_confidence_gives_a_wider_interval():
    narrow = bootstrap_mean(WORLDS[:, 0], rng(), confidence=0.5)
    wide = bootstrap_mean(WORLDS[:, 0], rng(), confidence=0.99)
    assert wide.low < narrow.low < narrow.high < wide.high


def test_a_95_percent_interval_covers_the_true_mean_about_95_times_in_100():
    draws = rng(11)
    covered = 0
    for _ in range(200):
        interval = bootstrap_mean(draws.normal(5.0, 1.0, size=30), draws, n_resamples=400)
        covered += interval.low <= 5.0 <= interval.high
    # nominal 190; the percentile method loses about two of 100 at n = 30, and three standard
    # deviations of a binomial with 200 trials are 10
    assert 175 <= covered <= 199


@pytest.mark.parametrize("level", [0.0, 0.1, -3.0])
def test_constant_data_give_an_interval_of_zero_width(level):
    constant = np.full(7, level)
    for interval in (
        bootstrap_mean(constant, rng()),
        bootstrap_interquartile_mean([constant, constant], rng()),
        bootstrap_paired_difference(constant, np.zeros(7), rng()),
    ):
        assert interval.low == interval.estimate == interval.high
        assert interval.estimate == pytest.approx(level)


def test_constant_columns_are_equivalent_to_zero_width():
    result = equivalence_test(np.full((3, 4), 0.1), 0.01, rng())
    assert result.equivalent
    assert all(i.low == i.high for i in result.intervals)


def test_a_single_world_is_rejected_with_the_number_needed():
    with pytest.raises(ValueError, match="values needs at least 2 worlds, got 1"):
        bootstrap_mean([1.0], rng())
    with pytest.raises(ValueError, match=r"strata\[1\] needs at least 2 worlds, got 1"):
        bootstrap_interquartile_mean([[1.0, 2.0], [3.0]], rng())
    with pytest.raises(ValueError, match=r"needs at least 2 worlds \(rows\), got 1"):
        equivalence_test([[1.0, 2.0]], 0.1, rng())
    with pytest.raises(ValueError, match=r"needs at least 2 worlds \(rows\), got 1"):
        page_trend_test([[1.0, 2.0, 3.0]])


def test_nan_is_rejected_with_its_index():
    with pytest.raises(ValueError, match=r"values\[2\] is nan"):
        bootstrap_mean([1.0, 2.0, np.nan], rng())
    with pytest.raises(ValueError, match=r"b\[0\] is nan"):
        probability_of_improvement([1.0, 2.0], [np.nan, 1.0], rng())
    with pytest.raises(ValueError, match=r"strata\[1\]\[1\] is nan"):
        bootstrap_interquartile_mean([[1.0, 2.0], [3.0, np.nan]], rng())
    with pytest.raises(ValueError, match=r"data\[1, 2\] is inf"):
        page_trend_test([[1.0, 2.0, 3.0], [1.0, 2.0, np.inf]])
    with pytest.raises(ValueError, match=r"values\[0, 1\] is nan"):
        equivalence_test([[1.0, np.nan], [1.0, 2.0]], 0.1, rng())


def test_pairs_must_cover_the_same_worlds():
    with pytest.raises(ValueError, match="same worlds, got 3 and 2"):
        bootstrap_paired_difference([1, 2, 3], [1, 2], rng())


def test_arguments_out_of_range_are_rejected_with_their_value():
    with pytest.raises(ValueError, match=r"confidence must lie in \(0, 1\), got 95"):
        bootstrap_mean([1.0, 2.0], rng(), confidence=95)
    with pytest.raises(ValueError, match="n_resamples must be at least 1, got 0"):
        bootstrap_mean([1.0, 2.0], rng(), n_resamples=0)
    with pytest.raises(ValueError, match=r"margin must lie in \(0, 1\), got 5"):
        equivalence_test(WORLDS, 5, rng())
    with pytest.raises(ValueError, match=r"values\[1\] is -1.5"):
        equivalence_test([[1.0, 2.0], [-1.0, -2.0]], 0.1, rng())
    with pytest.raises(ValueError, match="got 'down'"):
        page_trend_test(WORLDS, "down")
    with pytest.raises(ValueError, match="needs at least 3 columns, got 2"):
        page_trend_test(WORLDS[:, :2])
    with pytest.raises(ValueError, match=r"one axis \(n_worlds,\), got shape \(24, 4\)"):
        bootstrap_mean(WORLDS, rng())
    with pytest.raises(ValueError, match="at least 1 array, got none"):
        bootstrap_interquartile_mean([], rng())
