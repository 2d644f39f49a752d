"""Elementary functions: accurate, and of IEEE operations only."""

import math

import numpy as np
import pytest

from coopmap_env.core.elementary import (
    acos,
    atan2,
    erf,
    exp,
    exp_array,
    log,
    log_array,
    power,
    power_array,
    sin_cos,
    sin_cos_array,
    tan,
)
from coopmap_env.core.kernels import kernel

RNG = np.random.default_rng(0)
ANGLES = np.concatenate(
    [RNG.uniform(-7, 7, 300), RNG.uniform(-1e6, 1e6, 300), np.arange(-40, 41) * math.pi / 2]
)


def units_in_the_last_place(found, exact):
    """Error of a number in units of the last place of the exact one, an extended one of numpy."""
    return abs((np.longdouble(found) - exact) / np.longdouble(math.ulp(float(exact))))


@pytest.mark.parametrize(
    ("function", "exact", "arguments", "limit"),
    [
        (lambda x: sin_cos(x)[0], np.sin, ANGLES, 0.9),
        (lambda x: sin_cos(x)[1], np.cos, ANGLES, 0.9),
        (tan, np.tan, RNG.uniform(-1.5, 1.5, 300), 2.0),
        (exp, np.exp, RNG.uniform(-700, 700, 300), 0.9),
        (log, np.log, np.exp(RNG.uniform(-700, 700, 300)), 0.9),
        (log, np.log, RNG.uniform(0.5, 2.0, 300), 0.9),
        (acos, np.arccos, RNG.uniform(-1, 1, 300), 2.0),
    ],
)
def test_errors_are_of_the_order_of_one_unit_in_the_last_place(function, exact, arguments, limit):
    for x in arguments.tolist():
        assert units_in_the_last_place(function(x), exact(np.longdouble(x))) < limit, x


def test_atan2_errs_by_less_than_two_units_in_all_quadrants():
    for y, x in RNG.normal(size=(300, 2)).tolist():
        exact = np.arctan2(np.longdouble(y), np.longdouble(x))
        assert units_in_the_last_place(atan2(y, x), exact) < 2.0


@kernel
def erf_of_all(x, out):
    for k in range(len(x)):
        out[k] = erf(x[k])


def test_the_error_function_errs_by_less_than_3e_16():
    steps = np.arange(-7, 7, 1e-3)
    x = np.concatenate([steps, 1e-4 * steps, [0.46875, -0.46875, 6.0, 1e-300, 1e300, math.inf]])
    found = np.empty_like(x)
    erf_of_all(x, found)
    exact = np.array([math.erf(value) for value in x.tolist()])
    np.testing.assert_allclose(found, exact, rtol=5e-16, atol=0)
    assert (found[abs(x) >= 6] == np.sign(x[abs(x) >= 6])).all()


SPECIAL = (0.0, -0.0, 1.0, -1.0, math.inf, -math.inf, 1e308, 5e-324, -5e-324)


@pytest.mark.parametrize("y", SPECIAL)
@pytest.mark.parametrize("x", SPECIAL)
def test_atan2_knows_signed_zeros_and_infinities(y, x):
    assert (atan2(y, x), math.copysign(1.0, atan2(y, x))) == (
        math.atan2(y, x), math.copysign(1.0, math.atan2(y, x)),
    )  # fmt: skip


def test_special_values_of_the_others():
    assert sin_cos(0.0) == (0.0, 1.0)
    assert sin_cos(math.pi / 2) == (1.0, math.cos(math.pi / 2))
    assert sin_cos(math.pi) == (math.sin(math.pi), -1.0)
    assert math.copysign(1.0, sin_cos(-0.0)[0]) == -1.0
    assert (exp(0.0), exp(-math.inf), exp(1000.0)) == (1.0, 0.0, math.inf)
    assert (log(1.0), log(0.0), log(math.inf)) == (0.0, -math.inf, math.inf)
    assert math.isnan(log(-1.0))
    assert math.isnan(log(math.nan))
    assert math.isnan(sin_cos(math.nan)[0])
    assert math.isnan(exp(math.nan))


def test_exact_powers_are_products():
    for x in RNG.uniform(0, 20, 100).tolist():
        assert (power(x, 2.0), power(x, 1.0), power(x, 0.0)) == (x * x, x, 1.0)
        assert power(x, 1.5) == pytest.approx(x**1.5, rel=1e-14)
    assert (power(0.0, 1.5), power(0.0, 0.5)) == (0.0, 0.0)


def test_arrays_of_any_shape_equal_the_numbers_one_by_one():
    x = RNG.uniform(0.1, 3, (3, 1, 4))
    sines, cosines = sin_cos_array(x)
    assert sines.shape == cosines.shape == x.shape
    assert [*zip(sines.ravel(), cosines.ravel(), strict=True)] == [*map(sin_cos, x.ravel())]
    np.testing.assert_array_equal(exp_array(x).ravel(), [*map(exp, x.ravel())])
    np.testing.assert_array_equal(log_array(x).ravel(), [*map(log, x.ravel())])
    np.testing.assert_array_equal(
        power_array(x, 2).ravel(), [power(value, 2.0) for value in x.ravel()]
    )
    assert exp_array(1.0).shape == ()
    assert exp_array(np.zeros((0, 3))).shape == (0, 3)
