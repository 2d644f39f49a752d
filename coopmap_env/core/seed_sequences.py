"""Seeds inside of kernels: the hash of numpy's SeedSequence, word for word.

A SeedSequence takes microseconds to make and to ask; a reset of many worlds needs two of each. The
hash mixes the words of a seed and of a spawn key into a pool of four, and spreads the pool over as
many words as are asked for (O'Neill 2015, "Developing a seed_seq alternative"; numpy documents it
as stable).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import borrowing_kernel, kernel

_POOL_WORDS = 4
_HASH_START, _HASH_FACTOR = np.uint32(0x43B0D7E5), np.uint32(0x931E8875)
_SPREAD_START, _SPREAD_FACTOR = np.uint32(0x8B51F9DD), np.uint32(0x58F38DED)
_MIX_LEFT, _MIX_RIGHT = np.uint32(0xCA01F9DD), np.uint32(0x4973F715)
_HALF = np.uint32(16)
_BYTES = 4
"""Of a word of the hash."""


def seed_states(
    entropies: Sequence[int], spawn_key: Sequence[int], n_words: int
) -> NDArray[np.uint64]:
    """What seed sequences generate: ``SeedSequence(e, spawn_key=spawn_key)`` for each entropy e.

    Parameters
    ----------
    entropies : sequence of int
        k numbers of at least 0, as large as one likes.
    spawn_key : sequence of int
        Numbers below 2**32; at least one.
    n_words : int
        How many words of 64 bits each gives.

    Returns
    -------
    (k, n_words) uint64 array
        Rows are those of ``generate_state(n_words, numpy.uint64)``.
    """
    n_bytes = [_BYTES * max(_POOL_WORDS, -(-e.bit_length() // (8 * _BYTES))) for e in entropies]
    parts = [e.to_bytes(n, "little") for e, n in zip(entropies, n_bytes, strict=True)]
    words = np.frombuffer(b"".join(parts), dtype=np.uint32)
    ends = np.cumsum(n_bytes, dtype=np.int64) // _BYTES
    states = np.empty((len(n_bytes), n_words), dtype=np.uint64)
    write_states(words, ends, np.array(spawn_key, dtype=np.uint32), states)
    return states


@borrowing_kernel
def _hash_word(
    word: np.uint32, constant: np.uint32, factor: np.uint32
) -> tuple[np.uint32, np.uint32]:
    """The hash of a word, and the constant for the next one: the product with the factor."""
    value, constant = np.uint32(word ^ constant), np.uint32(constant * factor)
    value = np.uint32(value * constant)
    return np.uint32(value ^ (value >> _HALF)), constant


@borrowing_kernel
def _mix_into(x: np.uint32, y: np.uint32) -> np.uint32:
    """Mix the hash of a word into one of the pool."""
    value = np.uint32(np.uint32(_MIX_LEFT * x) - np.uint32(_MIX_RIGHT * y))
    return np.uint32(value ^ (value >> _HALF))


@kernel
def write_states(
    words: NDArray[np.uint32],
    ends: NDArray[np.int64],
    spawn_key: NDArray[np.uint32],
    states: NDArray[np.uint64],
) -> None:
    """Write the states (k, n) of seed sequences.

    The words of one entropy follow those of the other, least significant first, at least four of
    each; `ends` (k,) says where they end.
    """
    pool = np.empty(_POOL_WORDS, dtype=np.uint32)
    first = 0
    for row in range(len(ends)):
        n_own = ends[row] - first
        constant = _HASH_START
        for k in range(_POOL_WORDS):
            pool[k], constant = _hash_word(words[first + k], constant, _HASH_FACTOR)
        for k in range(_POOL_WORDS):
            for other in range(_POOL_WORDS):
                if k != other:
                    hashed, constant = _hash_word(pool[k], constant, _HASH_FACTOR)
                    pool[other] = _mix_into(pool[other], hashed)
        for k in range(_POOL_WORDS, n_own + len(spawn_key)):
            word = words[first + k] if k < n_own else spawn_key[k - n_own]
            for other in range(_POOL_WORDS):
                hashed, constant = _hash_word(word, constant, _HASH_FACTOR)
                pool[other] = _mix_into(pool[other], hashed)
        constant = _SPREAD_START
        for k in range(states.shape[1]):
            halves = np.uint64(0)
            for half in range(2):
                word = pool[(2 * k + half) % _POOL_WORDS]
                hashed, constant = _hash_word(word, constant, _SPREAD_FACTOR)
                halves |= np.uint64(hashed) << np.uint64(32 * half)
            states[row, k] = halves
        first = ends[row]
