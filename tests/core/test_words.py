"""Operations on words against Python's integers."""

import numpy as np
import pytest

from coopmap_env.core.kernels import kernel
from coopmap_env.core.words import count_bits, high_product, lowest_bit


@kernel
def operations(a, b):
    return high_product(a, b), count_bits(a), lowest_bit(a)


@pytest.mark.parametrize(
    ("a", "b"),
    [
        *[(0, 5), (1, 2**64 - 1), (2**63, 2), (2**64 - 1, 2**64 - 1)],
        *np.random.default_rng(0).integers(2**64, size=(50, 2), dtype=np.uint64).tolist(),
    ],
)
def test_words_equal_pythons_integers(a, b):
    lowest = (a & -a).bit_length() - 1 if a else 64
    expected = (a * b >> 64, a.bit_count(), lowest)
    assert operations(np.uint64(a), np.uint64(b)) == expected
