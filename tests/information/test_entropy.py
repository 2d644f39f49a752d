"""Shannon's entropy, Eq. 6."""

import math

import numpy as np
import pytest

from coopmap_env.information import entropy
from coopmap_env.information.entropy import entropy_terms


def test_a_fair_coin_holds_ln_two_nats_eq_6():
    assert entropy([0.5, 0.5]) == pytest.approx(math.log(2))


def test_a_half_and_two_quarters_hold_one_and_a_half_ln_two_eq_6():
    assert entropy([0.5, 0.25, 0.25]) == pytest.approx(1.5 * math.log(2))


def test_certainty_holds_nothing_eq_6():
    assert entropy([0.0, 1.0, 0.0]) == 0


def test_events_of_no_probability_change_nothing_eq_6():
    q = np.random.default_rng(0).dirichlet(np.ones(5))
    assert entropy([*q, 0.0, 0.0]) == pytest.approx(entropy(q))


@pytest.mark.parametrize("n", [2, 7, 64])
def test_entropy_is_largest_if_all_events_are_equally_likely_eq_6(n):
    rng = np.random.default_rng(n)
    assert entropy(np.full(n, 1 / n)) == pytest.approx(math.log(n))
    for q in rng.dirichlet(np.ones(n), 200):
        assert 0 <= entropy(q) < math.log(n)


def test_joint_entropy_is_that_of_one_and_what_the_other_adds_eq_6():
    """H(AB) = H(A) + H_A(B), H_A(B) being the mean entropy of B once A is known."""
    rng = np.random.default_rng(1)
    for _ in range(50):
        joint = rng.dirichlet(np.ones(12)).reshape(3, 4)
        a = joint.sum(axis=1)
        added = sum(p * entropy(row / p) for p, row in zip(a, joint, strict=True))
        assert entropy(joint) == pytest.approx(entropy(a) + added)
        # what is known of A never adds to B
        assert added <= entropy(joint.sum(axis=0)) + 1e-12


def test_missing_events_are_left_out_of_the_sum_eq_7():
    assert entropy([0.25, 0.25]) == pytest.approx(math.log(2))
    assert entropy([0.25]) == pytest.approx(0.25 * math.log(4))


@pytest.mark.parametrize("q", [[-0.1, 1.1], [1.5], [math.nan, 0.5]])
def test_what_is_no_probability_is_refused(q):
    with pytest.raises(ValueError, match=r"must lie in \[0, 1\]"):
        entropy(q)


def test_the_table_holds_the_term_of_every_count():
    table = entropy_terms(10)
    assert len(table) == 11
    for f in range(11):
        assert table[f] == pytest.approx(entropy([f / 10]))
