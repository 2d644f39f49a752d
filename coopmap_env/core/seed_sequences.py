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
def _hashed(value: np.uint32, factor: np.uint32) -> np.uint32:
    """A word after the exclusive or with the hash's constant, times the next constant."""
    value = np.uint32(value * factor)
    return np.uint32(value ^ (value >> _HALF))


@borrowing_kernel
def _mixed(x: np.uint32, y: np.uint32) -> np.uint32:
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
            value = np.uint32(words[first + k] ^ constant)
            constant = np.uint32(constant * _HASH_FACTOR)
            pool[k] = _hashed(value, constant)
        for k in range(_POOL_WORDS):
            for other in range(_POOL_WORDS):
                if k != other:
                    value = np.uint32(pool[k] ^ constant)
                    constant = np.uint32(constant * _HASH_FACTOR)
                    pool[other] = _mixed(pool[other], _hashed(value, constant))
        for k in range(_POOL_WORDS, n_own + len(spawn_key)):
            word = words[first + k] if k < n_own else spawn_key[k - n_own]
            for other in range(_POOL_WORDS):
                value = np.uint32(word ^ constant)
                constant = np.uint32(constant * _HASH_FACTOR)
                pool[other] = _mixed(pool[other], _hashed(value, constant))
        constant = _SPREAD_START
        for k in range(states.shape[1]):
            halves = np.uint64(0)
            for half in range(2):
                value = np.uint32(pool[(2 * k + half) % _POOL_WORDS] ^ constant)
                constant = np.uint32(constant * _SPREAD_FACTOR)
                halves |= np.uint64(_hashed(value, constant)) << np.uint64(32 * half)
            states[row, k] = halves
        first = ends[row]
