import numpy as np
import pytest
from scipy import stats

from coopmap_env.evaluation.statistics import Interval, bootstrap_mean, training_runs

GENERATED = np.random.default_rng(5).normal(10.0, 2.0, size=(3, 30))


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def test_a_planner_on_two_worlds_has_an_interval_that_spans_both():
    # a quarter of the resamples of the worlds holds either one alone
    assert training_runs.mean([[1.0, 3.0]], rng()) == Interval(2.0, 1.0, 3.0)


def test_two_training_runs_that_differ_on_all_worlds_span_the_interval():
    # one of two runs is drawn, for all worlds: drawn for each world, the means would lie near 2
    assert training_runs.mean([[1.0] * 50, [3.0] * 50], rng()) == Interval(2.0, 1.0, 3.0)


def test_of_three_training_runs_the_interval_is_the_range():
    # two are drawn, and both are the worst one in a ninth of the resamples
    assert training_runs.mean([[1.0, 1.0], [2.0, 2.0], [6.0, 6.0]], rng()) == Interval(3, 1, 6)


def test_drawing_n_minus_1_runs_gives_the_mean_its_variance():
    runs = np.array([1.0, 2.0, 6.0])
    (drawn,) = training_runs.resample([np.repeat(runs[:, None], 4, axis=1)], rng(), 40_000)
    assert drawn.shape == (40_000, 2, 4)
    # 7/3; of 40,000 draws, the variance is known to about one percent
    assert drawn.mean(axis=(1, 2)).var() == pytest.approx(runs.var(ddof=1) / 3, rel=0.03)


def test_a_resample_draws_the_same_worlds_for_every_algorithm():
    worlds = np.arange(20.0)
    first, second = training_runs.resample([worlds[None], np.stack([worlds] * 3)], rng(), 50)
    np.testing.assert_array_equal(first, second[:, :1])
    np.testing.assert_array_equal(second[:, 0], second[:, 1])
    assert len(np.unique(first[0])) < 20  # with replacement


def test_the_same_generator_draws_the_same_worlds_for_different_algorithms():
    worlds = np.arange(20.0)
    (alone,) = training_runs.resample([worlds[None]], rng(3), 50)
    first, _ = training_runs.resample([worlds[None], np.stack([worlds] * 3)], rng(3), 50)
    np.testing.assert_array_equal(alone, first)


def test_the_interquartile_mean_of_two_runs_on_four_worlds_is_that_of_their_eight_scores():
    found = training_runs.interquartile_mean([[8, 1, 7, 2], [6, 3, 5, 400]], rng())
    assert found.estimate == (3 + 5 + 6 + 7) / 4
    assert found.low < found.estimate < found.high


def test_a_gain_on_every_world_is_certain_however_worlds_differ():
    theirs = np.array([[1.0, 50.0, 7.0, 90.0]])
    found = training_runs.mean_difference(theirs + 0.5, theirs)
    assert (found.estimate, found.low, found.high) == pytest.approx((0.5, 0.5, 0.5))
    found = training_runs.ratio_of_means(2 * theirs, theirs, rng())
    assert (found.estimate, found.low, found.high) == pytest.approx((2, 2, 2))


def test_the_difference_of_runs_and_a_planner_by_hand():
    # means of the runs 16 and 14, so their mean has the variance 2/2, with one degree of freedom
    theirs = np.array([[10.0, 20.0]])
    ours = np.concatenate([theirs + 1, theirs - 1])
    found = training_runs.mean_difference(ours, theirs)
    assert found.estimate == 0
    assert (found.low, found.high) == pytest.approx((-12.7062, 12.7062), abs=1e-4)


def test_the_difference_of_two_planners_is_that_of_a_paired_t_test():
    ours, theirs = GENERATED[:1], GENERATED[1:2]
    found = training_runs.mean_difference(ours, theirs)
    plain = stats.ttest_rel(ours[0], theirs[0]).confidence_interval(0.95)
    assert (found.low, found.high) == pytest.approx((plain.low, plain.high))


@pytest.mark.parametrize(("of_runs", "of_both"), [(0.0, 1.0), (0.5, 1.0), (1.0, 0.1)])
def test_intervals_of_differences_contain_the_truth_at_their_level(of_runs, of_both):
    generator, held, n = rng(), 0, 500
    for _ in range(n):
        worlds = generator.normal(0, 3, 40)
        runs = generator.normal(0, of_runs, (3, 1)) + generator.normal(0, of_both, (3, 40))
        found = training_runs.mean_difference(worlds + runs, [worlds + generator.normal(0, 1, 40)])
        held += found.low <= 0 <= found.high
    # 95 % of 500 is known to one percent; it may be more, see `difference`
    assert held / n > 0.92


def test_improvement_compares_all_runs_on_the_same_world():
    # wins, losses and ties of two runs against one: 1, 1, 2 of four
    found = training_runs.probability_of_improvement([[2, 0], [1, 1]], [[1, 1]], rng())
    assert found.estimate == (1 + 2 * 0.5) / 4
    # every run wins on its world, though not against the other world's scores
    won = training_runs.probability_of_improvement([[2, 20], [3, 30]], [[1, 10], [0, 9]], rng())
    assert won == Interval(1.0, 1.0, 1.0)


def test_improvement_both_ways_adds_to_one():
    ours, theirs = GENERATED[:2], GENERATED[2:] + 0.3
    forth = training_runs.probability_of_improvement(ours, theirs, rng())
    back = training_runs.probability_of_improvement(theirs, ours, rng())
    assert forth.estimate + back.estimate == pytest.approx(1.0)


def test_the_profile_is_the_fraction_of_scores_above_each_threshold():
    found = training_runs.performance_profile([[1, 2], [3, 4]], [0, 1, 2.5, 4], rng())
    np.testing.assert_array_equal(found.estimate, [1.0, 0.75, 0.5, 0.0])
    assert (found.low <= found.estimate).all()
    assert (found.estimate <= found.high).all()
    # all above 0, none above 4; at 2.5 it is the one run or the other
    np.testing.assert_array_equal(found.low, [1.0, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(found.high, [1.0, 1.0, 1.0, 0.0])


def test_the_curve_of_a_planner_has_the_band_of_its_scores_at_each_scan():
    curves = GENERATED[:1, :, None] * np.array([0.0, 1.0, 2.0])
    found = training_runs.mean_curve(curves, rng(), n_resamples=2000)
    once = training_runs.mean(GENERATED[:1], rng())
    np.testing.assert_allclose(found.estimate, once.estimate * np.arange(3))
    np.testing.assert_allclose(found.low, once.low * np.arange(3))
    np.testing.assert_allclose(found.high, once.high * np.arange(3))
    assert found.as_dict()["low"] == found.low.tolist()


def plain_interval(scores, statistic, generator, n_resamples):
    """The bootstrap in loops."""
    n_runs, n_worlds = scores.shape
    worlds = generator.integers(n_worlds, size=(n_resamples, n_worlds))
    runs = generator.integers(n_runs, size=(n_resamples, max(n_runs - 1, 1)))
    values = [
        statistic([scores[run, world] for run in runs[k] for world in worlds[k]])
        for k in range(n_resamples)
    ]
    return Interval(statistic(scores.ravel()), *np.percentile(values, [2.5, 97.5]))


@pytest.mark.parametrize(
    ("ours", "statistic"),
    [
        (training_runs.mean, np.mean),
        (training_runs.interquartile_mean, lambda values: stats.trim_mean(values, 0.25)),
    ],
)
def test_intervals_are_those_of_the_plain_loops(ours, statistic):
    found = ours(GENERATED, rng(1), n_resamples=200)
    plain = plain_interval(GENERATED, statistic, rng(1), 200)
    for part in ("estimate", "low", "high"):
        assert getattr(found, part) == pytest.approx(getattr(plain, part))


def test_one_run_has_about_the_interval_of_the_plain_bootstrap_over_worlds():
    found = training_runs.mean(GENERATED[:1], rng(), n_resamples=20_000)
    plain = bootstrap_mean(GENERATED[0], rng(1), n_resamples=20_000)
    # ends of 20,000 resamples are known to about a hundredth of the width
    width = plain.high - plain.low
    assert found.low == pytest.approx(plain.low, abs=0.05 * width)
    assert found.high == pytest.approx(plain.high, abs=0.05 * width)


def test_the_generator_decides_the_interval():
    assert training_runs.mean(GENERATED, rng(3)) == training_runs.mean(GENERATED, rng(3))
    assert training_runs.mean(GENERATED, rng(3)) != training_runs.mean(GENERATED, rng(4))


def test_scores_that_are_no_matrix_of_runs_and_worlds_are_rejected():
    with pytest.raises(ValueError, match=r"axes \(n_runs, n_worlds\), got shape \(2,\)"):
        training_runs.mean([1.0, 2.0], rng())
    with pytest.raises(ValueError, match="at least 1 run and 2 worlds, got 3 and 1"):
        training_runs.mean([[1.0], [2.0], [3.0]], rng())
    with pytest.raises(ValueError, match=r"scores\[1, 0\] is nan"):
        training_runs.interquartile_mean([[1.0, 2.0], [np.nan, 1.0]], rng())
    with pytest.raises(ValueError, match=r"axes \(n_runs, n_worlds, n\), got shape \(1, 2\)"):
        training_runs.mean_curve([[1.0, 2.0]], rng())
    with pytest.raises(ValueError, match="the same worlds, got 3 and 2 of them"):
        training_runs.mean_difference([[1, 2, 3]], [[1, 2]])
    with pytest.raises(ValueError, match=r"denominators .* must be positive, got 0\.0"):
        training_runs.ratio_of_means([[1, 2]], [[1, 0]], rng())
    with pytest.raises(ValueError, match="n_resamples must be at least 1, got 0"):
        training_runs.mean([[1, 2]], rng(), n_resamples=0)
