"""Fixed-point log-odds and their tables."""

import math

import numpy as np
import pytest

from coopmap_env.mapping import STEPS_PER_NAT, LogOddsRange, to_log_odds_fixed


def test_fixed_point_log_odds_of_known_probabilities():
    assert to_log_odds_fixed(0.5) == 0
    # ln 9 = 2.1972 nats
    assert to_log_odds_fixed(0.9) == 2250
    assert to_log_odds_fixed(0.1) == -2250


def test_the_clamp_keeps_a_cell_between_one_minus_the_maximum_and_the_maximum():
    limits = LogOddsRange(max_probability=0.999)
    assert limits.clamp == to_log_odds_fixed(0.999)
    # one fixed-point step is 1/1024 nat: 0.001 is known to half of that
    assert limits.probability[[0, -1]] == pytest.approx([0.001, 0.999], rel=1e-3)
    assert len(limits.probability) == len(limits.entropy) == 2 * limits.clamp + 1


def test_the_middle_of_the_tables_is_one_half_and_ln_two():
    limits = LogOddsRange()
    assert limits.probability[limits.clamp] == 0.5
    assert limits.entropy[limits.clamp] == pytest.approx(math.log(2))


def test_tables_are_the_logistic_function_and_its_entropy():
    limits = LogOddsRange(max_probability=0.9)
    for k in range(0, 2 * limits.clamp + 1, 97):
        p = 1 / (1 + math.exp(-(k - limits.clamp) / STEPS_PER_NAT))
        assert limits.probability[k] == pytest.approx(p)
        assert limits.entropy[k] == pytest.approx(-p * math.log(p) - (1 - p) * math.log(1 - p))


def test_probability_rises_with_the_log_odds_and_entropy_falls_to_both_sides():
    limits = LogOddsRange(max_probability=0.9999)
    assert (np.diff(limits.probability) > 0).all()
    assert (np.diff(limits.entropy[: limits.clamp + 1]) > 0).all()
    assert limits.entropy == pytest.approx(limits.entropy[::-1])


@pytest.mark.parametrize("value", [0.5, 1.0, -1.0, math.nan])
def test_a_clamp_outside_of_a_half_to_one_is_rejected(value):
    with pytest.raises(
        ValueError, match=r"LogOddsRange\.max_probability must be .* > 0\.5 and < 1"
    ):
        LogOddsRange(max_probability=value)
