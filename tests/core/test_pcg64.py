"""Random numbers of numpy's default Generator in kernels: the same from the same seeds."""

import numpy as np
import pytest

from coopmap_env.core.kernels import kernel
from coopmap_env.core.pcg64 import (
    SEED_WORDS,
    fill_quarters,
    fill_uniform,
    next_word,
    seed_generator,
)


@kernel
def fill_in_turns(seed, words, uniform, quarters, later):
    state = np.empty(4, np.uint64)
    seed_generator(seed, state)
    for k in range(len(words)):
        words[k] = next_word(state)
    fill_uniform(state, uniform)
    fill_quarters(state, quarters)
    fill_uniform(state, later)


@pytest.mark.parametrize("seed", [0, 1, 2, 12345, 2**200])
def test_numbers_are_those_of_numpy(seed):
    sequence = np.random.SeedSequence(seed)
    rng = np.random.default_rng(sequence)
    words, uniform, later = np.empty(1000, np.uint64), np.empty(999), np.empty(1001)
    quarters = np.empty(2000, np.int64)
    fill_in_turns(sequence.generate_state(SEED_WORDS, np.uint64), words, uniform, quarters, later)
    np.testing.assert_array_equal(words, rng.bit_generator.random_raw(1000))
    np.testing.assert_array_equal(uniform, rng.random(999))
    np.testing.assert_array_equal(quarters, rng.integers(4, size=2000))
    np.testing.assert_array_equal(later, rng.random(1001))


def test_all_bits_of_the_seed_count():
    # carries from the lower half into the upper one, in the seed and in the increment
    for seed in np.random.default_rng(3).integers(2**64, size=(300, 4), dtype=np.uint64):
        seed |= np.uint64(1 << 63)
        words = np.empty(3, np.uint64)
        high, low, stream_high, stream_low = map(int, seed)
        mask, factor = 2**128 - 1, 0x2360ED051FC65DA44385DF649FCCF645
        increment = ((stream_high << 64 | stream_low) << 1 | 1) & mask
        state = ((increment + (high << 64 | low)) * factor + increment) & mask
        fill_in_turns(seed, words, np.empty(0), np.empty(0, np.int64), np.empty(0))
        bits = np.random.PCG64()
        bits.state = bits.state | {"state": {"state": state, "inc": increment}}
        np.testing.assert_array_equal(words, bits.random_raw(3))
