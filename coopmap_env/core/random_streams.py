"""Random numbers inside of kernels: Philox 4x64-10, the counter-based generator that numpy has too.

A block of four 64-bit words is a function of a key and a counter (Salmon, Moraes, Dror & Shaw 2011,
"Parallel random numbers: as easy as 1, 2, 3"). So the numbers of a beam do not depend on how many
others were drawn: kernels draw only what they need, for many worlds, in any order. The words are
those of ``numpy.random.Philox(key=key)``.

The state of a stream is a row of three words: the key's two, and how many blocks were taken.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.elementary import log, sin_cos
from coopmap_env.core.kernels import borrowing_kernel, inlined_kernel, kernel
from coopmap_env.core.words import high_product

STATE_WORDS = 3
"""Words of the state of a stream."""
KEY_WORDS = 2
"""The first of them, which a seed sequence generates; the rest begins at 0."""
_BLOCKS_TAKEN = KEY_WORDS  # its index: it follows the key
_ROUNDS = 10
_MULTIPLIERS = np.uint64(0xD2E7470EE14C6C93), np.uint64(0xCA5A826395121157)
_KEY_STEPS = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBB67AE8584CAA73B)
_ONE = np.uint64(1)
_FRACTION_SHIFT = np.uint64(11)
_FRACTION = 2.0**-53
_HALF_SHIFT = np.uint64(32)
_LOW_HALF = np.uint64(0xFFFFFFFF)

Words = tuple[np.uint64, np.uint64, np.uint64, np.uint64]
"""A block."""


def stream_state(seed: np.random.SeedSequence) -> NDArray[np.uint64]:
    """State (3,) of a new stream; its words are those of ``numpy.random.Philox(seed)``."""
    return np.array([*seed.generate_state(KEY_WORDS, np.uint64), 0], dtype=np.uint64)


def draw_stream(rng: np.random.Generator) -> NDArray[np.uint64]:
    """State (3,) of a new stream whose key is drawn from a Generator."""
    return np.array([*rng.integers(2**64, size=KEY_WORDS, dtype=np.uint64), 0], dtype=np.uint64)


@borrowing_kernel
def random_block(stream: NDArray[np.uint64], number: int) -> Words:
    """The four words of a block of a stream: the `number`-th of those that were not taken yet."""
    key0, key1 = stream[0], stream[1]
    x0 = stream[_BLOCKS_TAKEN] + np.uint64(number) + _ONE
    x1 = x2 = x3 = np.uint64(0)
    for _ in range(_ROUNDS):
        high0, low0 = high_product(_MULTIPLIERS[0], x0), _MULTIPLIERS[0] * x0
        high1, low1 = high_product(_MULTIPLIERS[1], x2), _MULTIPLIERS[1] * x2
        x0, x1, x2, x3 = high1 ^ x1 ^ key0, low1, high0 ^ x3 ^ key1, low0
        key0 += _KEY_STEPS[0]
        key1 += _KEY_STEPS[1]
    return x0, x1, x2, x3


@inlined_kernel
def take_blocks(stream: NDArray[np.uint64], n: int) -> None:
    """Go on by n blocks."""
    stream[_BLOCKS_TAKEN] += np.uint64(n)


@inlined_kernel
def uniform_index(word: np.uint64, n: int) -> int:
    """A number in 0 ... n - 1 from a word, n < 2**32; biased by less than n / 2**32.

    The upper half of the product of n and the word's upper half (Lemire 2019, "Fast random integer
    generation in an interval"), without its rejection step: the bias is out of reach of any test.
    """
    return int(((word >> _HALF_SHIFT) * np.uint64(n)) >> _HALF_SHIFT)


@inlined_kernel
def uniform_number(word: np.uint64) -> float:
    """A number in [0, 1) from the upper 53 bits of a word."""
    return float(word >> _FRACTION_SHIFT) * _FRACTION


@borrowing_kernel
def draw_index(stream: NDArray[np.uint64], n: int) -> int:
    """A number in 0 ... n - 1, from a block of its own; see `uniform_index`."""
    index = uniform_index(random_block(stream, 0)[0], n)
    take_blocks(stream, 1)
    return index


@kernel
def normal_pair(first: np.uint64, second: np.uint64) -> tuple[float, float]:
    """Two independent standard normal numbers from two words, by the method of Box & Muller."""
    u = 1.0 - uniform_number(first)  # in (0, 1]: its logarithm is finite
    sine, cosine = sin_cos(2.0 * math.pi * uniform_number(second))
    length = math.sqrt(-2.0 * log(u))
    return length * cosine, length * sine
