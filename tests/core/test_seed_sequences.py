"""Seeds in kernels: what numpy's SeedSequence generates."""

import numpy as np
import pytest

from coopmap_env.core.seed_sequences import seed_states

ENTROPIES = [0, 1, 2**31, 2**32 - 1, 2**32, 2**64 + 5, 2**128 - 1, 2**128, 2**300 + 7]


@pytest.mark.parametrize("spawn_key", [(0,), (2**32 - 1,), (0x5CE2E, 2, 6), (1, 2, 3, 4, 5, 6)])
@pytest.mark.parametrize("n_words", [1, 2, 4, 6, 9])
def test_states_are_those_of_numpy(spawn_key, n_words):
    expected = [
        np.random.SeedSequence(entropy, spawn_key=spawn_key).generate_state(n_words, np.uint64)
        for entropy in ENTROPIES
    ]
    np.testing.assert_array_equal(seed_states(ENTROPIES, spawn_key, n_words), expected)


def test_states_of_many_seeds_are_those_of_each():
    seeds = np.random.default_rng(0).integers(2**62, size=500).tolist()
    together = seed_states(seeds, (7, 8), 4)
    for seed, row in zip(seeds, together, strict=True):
        np.testing.assert_array_equal(seed_states([seed], (7, 8), 4), [row])
    assert seed_states([], (7, 8), 4).shape == (0, 4)
