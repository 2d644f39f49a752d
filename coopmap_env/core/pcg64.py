"""Random numbers of numpy's default Generator inside of kernels: PCG XSL RR 128/64, word for word.

A scene draws its worlds from a Generator. A kernel that makes many worlds draws the same numbers
from the same seeds without one (O'Neill 2014, "PCG: a family of simple fast space-efficient
statistically good algorithms for random number generation"; numpy's ``PCG64``).

The state is a row of four words: the upper and lower half of the state, and of the increment.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import borrowing_kernel
from coopmap_env.core.random_streams import uniform_number
from coopmap_env.core.words import high_product

SEED_WORDS = 4
"""Words of a seed sequence that seed a generator."""
_FACTOR_HIGH, _FACTOR_LOW = np.uint64(0x2360ED051FC65DA4), np.uint64(0x4385DF649FCCF645)
_ONE = np.uint64(1)
_LAST = np.uint64(63)
_ROTATION_SHIFT = np.uint64(58)
_QUARTER_SHIFTS = np.uint64(30), np.uint64(62)


@borrowing_kernel
def _advance(state: NDArray[np.uint64]) -> None:
    """State times the factor, plus the increment; 128 bits."""
    high, low = state[0], state[1]
    high = high_product(low, _FACTOR_LOW) + high * _FACTOR_LOW + low * _FACTOR_HIGH
    low = low * _FACTOR_LOW
    total = low + state[3]
    state[0] = high + state[2] + np.uint64(total < low)
    state[1] = total


@borrowing_kernel
def seed_generator(seed: NDArray[np.uint64], state: NDArray[np.uint64]) -> None:
    """Write the state (4,) of ``PCG64(sequence)`` that generates the words of this seed (4,)."""
    state[2] = (seed[2] << _ONE) | (seed[3] >> _LAST)
    state[3] = (seed[3] << _ONE) | _ONE
    low = state[3] + seed[1]
    state[0] = state[2] + seed[0] + np.uint64(low < seed[1])
    state[1] = low
    _advance(state)


@borrowing_kernel
def next_word(state: NDArray[np.uint64]) -> np.uint64:
    """The next 64 bits."""
    _advance(state)
    word, turn = state[0] ^ state[1], state[0] >> _ROTATION_SHIFT
    return (word >> turn) | (word << ((~turn + _ONE) & _LAST))


@borrowing_kernel
def fill_uniform(state: NDArray[np.uint64], out: NDArray[np.float64]) -> None:
    """``Generator.random(n)``: numbers in [0, 1)."""
    for k in range(len(out)):
        out[k] = uniform_number(next_word(state))


@borrowing_kernel
def fill_quarters(state: NDArray[np.uint64], out: NDArray[np.int64]) -> None:
    """``Generator.integers(4, size=n)`` for an even n.

    Each half of a word gives its two upper bits; the lower half comes first.
    """
    for k in range(0, len(out), 2):
        word = next_word(state)
        out[k] = (word >> _QUARTER_SHIFTS[0]) & np.uint64(3)
        out[k + 1] = word >> _QUARTER_SHIFTS[1]
