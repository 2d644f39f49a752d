"""Sine, exponential and the like, with the same last bit on every processor.

The C library chooses its functions by the processor (with or without fused multiply-add) and
changes them between versions, and numpy brings functions of its own for AVX-512: their results
differ in the last bit. These are made of additions, multiplications and divisions in a fixed order,
which IEEE 754 defines to the last bit and the compiler of the kernels does not fuse.

Wherever a number reaches an observation, a reward or a pose, the code calls these instead of
`math` and numpy. Where it only decides a comparison or is rounded to an integer, a last bit does
not matter, and the C library may serve.

Method and coefficients: fdlibm, but for `erf`. Errors are below 0.9 units in the last
place (`atan2`, `acos`: 2).

    Copyright (C) 1993 by Sun Microsystems, Inc. All rights reserved.
    Developed at SunPro, a Sun Microsystems, Inc. business.
    Permission to use, copy, modify, and distribute this software is freely granted, provided that
    this notice is preserved.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.kernels import inlined_kernel, kernel

MAX_REDUCED_ANGLE = 1e6
"""Radians: quarter turns up to here are subtracted without error. Of larger angles, which no pose
has, the C library's sine is taken."""
TWO_OVER_PI = 6.36619772367581382433e-01
# pi / 2 in three parts: the first two have 33 bits each, so that their multiples are exact
PIO2_1, PIO2_2, PIO2_3 = (
    1.57079632673412561417e00, 6.07710050630396597660e-11, 2.02226624879595063154e-21,
)  # fmt: skip
LN2_HIGH, LN2_LOW, INVERSE_LN2 = (
    6.93147180369123816490e-01, 1.90821492927058770002e-10, 1.44269504088896338700e00,
)  # fmt: skip
PI_LOW = 1.2246467991473531772e-16
"""What `math.pi` lacks of pi."""


@kernel
def sin_cos(angle: float) -> tuple[float, float]:
    """Sine and cosine of an angle, radians."""
    if not abs(angle) < MAX_REDUCED_ANGLE:
        return math.sin(angle), math.cos(angle)
    if abs(angle) < 1e-8:
        return angle, 1.0
    quarters = np.rint(angle * TWO_OVER_PI)
    high = angle - quarters * PIO2_1
    step = quarters * PIO2_2
    near = high - step
    rest = quarters * PIO2_3 - ((high - near) - step)
    x = near - rest
    tail = (near - x) - rest
    z = x * x
    r = 8.33333333332248946124e-03 + z * (
        -1.98412698298579493134e-04
        + z * (
            2.75573137070700676789e-06
            + z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10)
        )
    )  # fmt: skip
    v = z * x
    sine = x - ((z * (0.5 * tail - v * r) - tail) - v * -1.66666666666666324348e-01)
    r = z * (
        4.16666666666666019037e-02
        + z * (-1.38888888888741095749e-03 + z * 2.48015872894767294178e-05)
    ) + (z * z) * (z * z) * (
        -2.75573143513906633035e-07
        + z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11)
    )
    half = 0.5 * z
    w = 1.0 - half
    cosine = w + (((1.0 - w) - half) + (z * r - x * tail))
    quadrant = int(quarters) & 3
    if quadrant == 0:
        return sine, cosine
    if quadrant == 1:
        return cosine, -sine
    if quadrant == 2:
        return -sine, -cosine
    return -cosine, sine


@inlined_kernel
def inlined_exp(x: float) -> float:
    """`exp` of a number between -708 and 709, without branches or calls.

    A loop over it, in a kernel without checks of divisions, uses vector registers. So it does over
    `inlined_erf`. Elsewhere, so much code in place of a call makes the code around it slower.
    """
    k = np.rint(x * INVERSE_LN2)
    high, low = x - k * LN2_HIGH, k * LN2_LOW
    r = high - low
    t = r * r
    c = r - t * (
        1.66666666666666019037e-01
        + t * (
            -2.77777777770155933842e-03
            + t * (
                6.61375632143793436117e-05
                + t * (-1.65339022054652515390e-06 + t * 4.13813679705723846039e-08)
            )
        )
    )  # fmt: skip
    power_of_2 = np.int64((np.int64(np.int32(k)) + 1023) << 52).view(np.float64)
    return (1.0 - ((low - (r * c) / (2.0 - c)) - high)) * power_of_2


@kernel
def exp(x: float) -> float:
    """The exponential of a number."""
    if not -708.0 < x < 709.0:  # subnormal, infinite or NaN
        return math.exp(x)
    return inlined_exp(x)


@inlined_kernel
def inlined_erf(x: float) -> float:
    """`erf`, without branches or calls; see `inlined_exp`.

    W. J. Cody 1969, "Rational Chebyshev approximations for the error function". Two of its three
    intervals are enough, as what the third one serves, the relative error of 1 - erf, does not
    matter here.
    """
    a = abs(x)
    y = min(a, 6.0)
    is_near = a <= 0.46875
    s = y * y
    near_numerator = 3.20937758913846947e03 + s * (
        3.77485237685302021e02
        + s * (1.13864154151050156e02 + s * (3.16112374387056560e00 + s * 1.85777706184603153e-01))
    )
    near_denominator = 2.84423683343917062e03 + s * (
        1.28261652607737228e03 + s * (2.44024637934444173e02 + s * (2.36012909523441209e01 + s))
    )
    far_numerator = 1.23033935479799725e03 + y * (
        2.05107837782607147e03
        + y * (
            1.71204761263407058e03
            + y * (
                8.81952221241769090e02
                + y * (
                    2.98635138197400131e02
                    + y * (
                        6.61191906371416295e01
                        + y * (
                            8.88314979438837594e00
                            + y * (5.64188496988670089e-01 + y * 2.15311535474403846e-08)
                        )
                    )
                )
            )
        )
    )  # fmt: skip
    far_denominator = 1.23033935480374942e03 + y * (
        3.43936767414372164e03
        + y * (
            4.36261909014324716e03
            + y * (
                3.29079923573345963e03
                + y * (
                    1.62138957456669019e03
                    + y * (
                        5.37181101862009858e02
                        + y * (1.17693950891312499e02 + y * (1.57449261107098347e01 + y))
                    )
                )
            )
        )
    )  # fmt: skip
    numerator = near_numerator if is_near else far_numerator
    ratio = numerator / (near_denominator if is_near else far_denominator)
    return x * ratio if is_near else math.copysign(1.0 - inlined_exp(-s) * ratio, x)


@kernel
def erf(x: float) -> float:
    """The error function of a number, not NaN; errors are below 3e-16."""
    return inlined_erf(x)


@kernel
def log(x: float) -> float:
    """The natural logarithm; -inf of 0, NaN of a negative number."""
    if not 0.0 < x < math.inf:
        return -math.inf if x == 0.0 else (x if x > 0.0 else math.nan)
    mantissa, exponent = math.frexp(x)
    if mantissa < 0.70710678118654752440:
        mantissa, exponent = 2.0 * mantissa, exponent - 1
    f, k = mantissa - 1.0, float(exponent)
    s = f / (2.0 + f)
    z = s * s
    w = z * z
    even = w * (
        3.999999999940941908e-01 + w * (2.222219843214978396e-01 + w * 1.531383769920937332e-01)
    )
    odd = z * (
        6.666666666666735130e-01
        + w * (
            2.857142874366239149e-01
            + w * (1.818357216161805012e-01 + w * 1.479819860511658591e-01)
        )
    )  # fmt: skip
    half_square = 0.5 * f * f
    return k * LN2_HIGH - ((half_square - (s * (half_square + (even + odd)) + k * LN2_LOW)) - f)


@kernel
def power(x: float, exponent: float) -> float:
    """``x**exponent`` of x >= 0. Exact exponents 0, 1 and 2; else exp(exponent * log(x))."""
    if exponent == 2.0:
        return x * x
    if exponent == 1.0:
        return x
    if exponent == 0.0:
        return 1.0
    return exp(exponent * log(x))


@kernel
def _atan(x: float) -> float:
    """Arcus tangent of x >= 0."""
    high, low = 0.0, 0.0
    if x < 0.4375:
        t = x
    elif x < 0.6875:
        high, low = 4.63647609000806093515e-01, 2.26987774529616870924e-17
        t = (2.0 * x - 1.0) / (2.0 + x)
    elif x < 1.1875:
        high, low = 7.85398163397448278999e-01, 3.06161699786838301793e-17
        t = (x - 1.0) / (x + 1.0)
    elif x < 2.4375:
        high, low = 9.82793723247329054082e-01, 1.39033110312309984516e-17
        t = (x - 1.5) / (1.0 + 1.5 * x)
    else:
        high, low = 1.57079632679489655800e00, 6.12323399573676603587e-17
        t = -1.0 / x
    z = t * t
    w = z * z
    odd = z * (
        3.33333333333329318027e-01
        + w * (
            1.42857142725034663711e-01
            + w * (
                9.09088713343650656196e-02
                + w * (
                    6.66107313738753120669e-02
                    + w * (4.97687799461593236017e-02 + w * 1.62858201153657823623e-02)
                )
            )
        )
    )  # fmt: skip
    even = w * (
        -1.99999999998764832476e-01
        + w * (
            -1.11111104054623557880e-01
            + w * (
                -7.69187620504482999495e-02
                + w * (-5.83357013379057348645e-02 + w * -3.65315727442169155270e-02)
            )
        )
    )  # fmt: skip
    return high - ((t * (odd + even) - low) - t)


@kernel
def atan2(y: float, x: float) -> float:
    """Angle of the vector (x, y) from +x to +y, radians, in [-pi, pi]."""
    ax, ay = abs(x), abs(y)
    if not (ax < math.inf and ay < math.inf):
        return math.atan2(y, x)
    if ay * 1e-300 > ax or (ax == 0.0 and ay > 0.0):
        return math.copysign(0.5 * math.pi, y)
    angle = _atan(ay / ax) if ay > 0.0 else 0.0
    if math.copysign(1.0, x) < 0.0:
        angle = math.pi - (angle - PI_LOW)
    return math.copysign(angle, y)


@kernel
def acos(x: float) -> float:
    """Arcus cosine of x in [-1, 1], radians."""
    return atan2(math.sqrt((1.0 - x) * (1.0 + x)), x)


@kernel
def tan(angle: float) -> float:
    """Tangent of an angle, radians."""
    sine, cosine = sin_cos(angle)
    return sine / cosine


@kernel
def _sin_cos_of_all(angles: NDArray[np.float64], out: NDArray[np.float64]) -> None:
    for k in range(len(angles)):
        out[0, k], out[1, k] = sin_cos(angles[k])


@kernel
def _exp_of_all(x: NDArray[np.float64], out: NDArray[np.float64]) -> None:
    for k in range(len(x)):
        out[k] = exp(x[k])


@kernel
def _log_of_all(x: NDArray[np.float64], out: NDArray[np.float64]) -> None:
    for k in range(len(x)):
        out[k] = log(x[k])


@kernel
def _power_of_all(x: NDArray[np.float64], exponent: float, out: NDArray[np.float64]) -> None:
    for k in range(len(x)):
        out[k] = power(x[k], exponent)


def sin_cos_array(angles: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """`sin_cos` of an array of any shape: sines and cosines."""
    a = np.asarray(angles, dtype=np.float64)
    out = np.empty((2, a.size))
    _sin_cos_of_all(a.ravel(), out)
    return out[0].reshape(a.shape), out[1].reshape(a.shape)


def exp_array(x: ArrayLike) -> NDArray[np.float64]:
    """`exp` of an array of any shape."""
    return _of_all(_exp_of_all, x)


def log_array(x: ArrayLike) -> NDArray[np.float64]:
    """`log` of an array of any shape."""
    return _of_all(_log_of_all, x)


def power_array(x: ArrayLike, exponent: float) -> NDArray[np.float64]:
    """`power` of an array of any shape."""
    return _of_all(_power_of_all, x, float(exponent))


def _of_all(function: Callable[..., None], x: ArrayLike, *options: float) -> NDArray[np.float64]:
    a = np.asarray(x, dtype=np.float64)
    out = np.empty(a.size)
    function(a.ravel(), *options, out)
    return out.reshape(a.shape)
