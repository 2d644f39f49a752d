import numpy as np
import pytest

from coopmap_env.evaluation.metrics.calibration import (
    binary_log_loss,
    brier_score,
    expected_calibration_error,
    log_loss,
    reliability_curve,
)

ALL_SCORES = [brier_score, log_loss, expected_calibration_error]


def test_brier_score_of_two_cells_is_the_mean_of_their_squared_errors():
    # (0.8 - 1)² = 0.04 and (0.4 - 0)² = 0.16
    assert brier_score([0.8, 0.4], [True, False], [True, True]) == pytest.approx(0.10)


def test_log_loss_of_two_cells_is_the_mean_of_their_surprises():
    expected = -(np.log(0.8) + np.log(0.6)) / 2
    assert log_loss([0.8, 0.4], [True, False], [True, True]) == pytest.approx(expected)


def test_a_map_that_knows_nothing_scores_a_quarter_and_ln_2():
    half = np.full((2, 2), 0.5)
    occupied = np.array([[True, False], [False, False]])
    sampled = np.ones((2, 2), dtype=bool)
    assert brier_score(half, occupied, sampled) == pytest.approx(0.25)
    assert log_loss(half, occupied, sampled) == pytest.approx(np.log(2))


def test_expected_calibration_error_weighs_the_gap_of_each_bin_by_its_cells():
    # four cells called 0.8 of which two are occupied: gap 0.3; one free cell called 0.1: gap 0.1
    probability = [0.8, 0.8, 0.8, 0.8, 0.1]
    occupied = [True, True, False, False, False]
    error = expected_calibration_error(probability, occupied, np.ones(5, dtype=bool))
    assert error == pytest.approx((4 * 0.3 + 1 * 0.1) / 5)


def test_the_reliability_curve_holds_means_fractions_and_counts_of_its_bins():
    curve = reliability_curve(
        [0.1, 0.3, 0.6, 0.9], [False, True, True, True], np.ones(4, dtype=bool), n_bins=2
    )
    np.testing.assert_array_equal(curve.edges, [0.0, 0.5, 1.0])
    np.testing.assert_array_equal(curve.counts, [2, 2])
    np.testing.assert_allclose(curve.mean_predicted, [0.2, 0.75])
    np.testing.assert_allclose(curve.occupied_fraction, [0.5, 1.0])


def test_a_probability_on_an_edge_belongs_to_the_upper_bin_and_one_to_the_last():
    tenths = np.arange(11) / 10
    curve = reliability_curve(tenths, np.zeros(11, dtype=bool), np.ones(11, dtype=bool))
    np.testing.assert_array_equal(curve.counts, [1] * 9 + [2])


def test_empty_bins_are_nan_and_do_not_spoil_the_calibration_error():
    probability, occupied, sampled = [0.05], [False], [True]
    curve = reliability_curve(probability, occupied, sampled)
    assert np.isnan(curve.mean_predicted[1:]).all()
    assert np.isnan(curve.occupied_fraction[1:]).all()
    assert expected_calibration_error(probability, occupied, sampled) == pytest.approx(0.05)


def test_certain_and_wrong_is_infinite_and_certain_and_right_is_zero():
    loss = binary_log_loss([0.0, 1.0, 0.0, 1.0], [True, False, False, True])
    np.testing.assert_array_equal(loss, [np.inf, np.inf, 0.0, 0.0])
    assert not np.signbit(loss).any()
    assert log_loss([0.0, 0.5], [True, True], [True, True]) == np.inf


@pytest.mark.parametrize("score", ALL_SCORES)
def test_a_perfect_map_scores_zero(score):
    occupied = np.array([[[True, False], [False, True]]])
    assert score(occupied.astype(float), occupied, np.ones(occupied.shape, dtype=bool)) == 0


@pytest.mark.parametrize("score", ALL_SCORES)
def test_unsampled_cells_change_nothing_whatever_they_hold(score):
    seen = score([0.8, 0.4], [True, False], [True, True])
    with_unseen = score(
        [0.8, np.nan, 0.4, 0.0], [True, True, False, True], [True, False, True, False]
    )
    assert with_unseen == seen


@pytest.mark.parametrize("score", ALL_SCORES)
def test_a_map_without_a_sampled_cell_scores_nan(score):
    assert np.isnan(score([0.5, 0.5], [True, False], [False, False]))


def test_the_reliability_curve_of_an_unsampled_map_counts_nothing():
    curve = reliability_curve([0.5], [True], [False])
    assert curve.counts.sum() == 0
    assert np.isnan(curve.occupied_fraction).all()


@pytest.mark.parametrize("score", [*ALL_SCORES, reliability_curve])
def test_shapes_that_differ_are_rejected(score):
    with pytest.raises(ValueError, match=r"\(3,\), \(2,\) and \(3,\)"):
        score(np.full(3, 0.5), np.zeros(2, dtype=bool), np.ones(3, dtype=bool))


@pytest.mark.parametrize("bad", [-0.1, 1.1, np.nan])
def test_a_sampled_cell_outside_the_unit_interval_is_rejected_with_its_value(bad):
    with pytest.raises(ValueError, match=str(bad)):
        brier_score([0.5, bad], [True, True], [True, True])


def test_a_curve_needs_a_bin():
    with pytest.raises(ValueError, match="n_bins must be at least 1, got 0"):
        reliability_curve([0.5], [True], [True], n_bins=0)


@pytest.mark.parametrize("score", [brier_score, log_loss])
def test_reporting_the_true_probability_beats_reporting_another(score):
    # proper scores: with 30 % of the cells occupied, the constant that scores best is 0.3
    occupied = np.arange(100) < 30
    sampled = np.ones(100, dtype=bool)
    constants = np.arange(1, 20) / 20
    scores = [score(np.full(100, p), occupied, sampled) for p in constants]
    assert constants[np.argmin(scores)] == 0.3


def test_outcomes_drawn_with_the_stated_probability_are_calibrated():
    rng = np.random.default_rng(0)
    probability = rng.uniform(size=(200, 200))
    occupied = rng.uniform(size=(200, 200)) < probability
    sampled = np.ones((200, 200), dtype=bool)
    # about 4000 cells a bin, so the fraction of each has a standard deviation below 0.008
    assert expected_calibration_error(probability, occupied, sampled) < 0.02
    assert expected_calibration_error(probability**3, occupied, sampled) > 0.2
