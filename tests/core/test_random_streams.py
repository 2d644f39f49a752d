"""Random numbers of kernels: numpy's Philox, word for word; uniform indices; normal numbers."""

import math

import numpy as np
import pytest
from scipy import stats

from coopmap_env.core.kernels import kernel
from coopmap_env.core.random_streams import (
    draw_stream,
    normal_pair,
    random_block,
    stream_state,
    take_blocks,
    uniform_index,
)


@kernel
def fill_words(stream, words):
    for k in range(len(words)):
        words[k, 0], words[k, 1], words[k, 2], words[k, 3] = random_block(stream, k)
    take_blocks(stream, len(words))


@kernel
def fill_normals(words, normals):
    for k in range(len(normals)):
        normals[k, 0], normals[k, 1] = normal_pair(words[k, 0], words[k, 1])


@kernel
def fill_indices(words, n, indices):
    for k in range(len(indices)):
        indices[k] = uniform_index(words[k], n)


def words_of(stream, n):
    words = np.empty((n, 4), dtype=np.uint64)
    fill_words(stream, words)
    return words


def test_the_words_are_those_of_numpys_philox():
    seed = np.random.SeedSequence(3)
    expected = np.random.Philox(seed).random_raw(4 * 1000).reshape(-1, 4)
    np.testing.assert_array_equal(words_of(stream_state(seed), 1000), expected)


@pytest.mark.parametrize("taken", [0, 1, 7, 2**40])
def test_a_stream_goes_on_where_it_was(taken):
    stream = draw_stream(np.random.default_rng(5))
    key = int(stream[0]) | int(stream[1]) << 64
    take_blocks(stream, taken)
    words_of(stream, 10)
    expected = np.random.Philox(key=key, counter=taken + 10).random_raw(4 * 5).reshape(-1, 4)
    np.testing.assert_array_equal(words_of(stream, 5), expected)


def test_a_block_does_not_depend_on_the_others():
    stream = draw_stream(np.random.default_rng(1))
    expected = random_block(stream, 3)
    words_of(stream, 2)
    assert random_block(stream, 1) == expected


def test_streams_of_different_seeds_differ():
    parents = np.random.SeedSequence(0).spawn(3)
    states = {tuple(stream_state(seed).tolist()) for seed in parents}
    assert len(states) == 3


def test_normal_numbers_by_hand():
    # u = 1 - 0.5 = 0.5 and an angle of a quarter turn: sqrt(2 ln 2) along y
    half, quarter = np.uint64(1 << 63), np.uint64(1 << 62)
    x, y = normal_pair(half, quarter)
    assert x == pytest.approx(0.0, abs=1e-15)
    assert y == pytest.approx(math.sqrt(2.0 * math.log(2.0)), rel=1e-15)
    assert normal_pair(np.uint64(0), np.uint64(0)) == (0.0, 0.0)
    assert math.isfinite(sum(normal_pair(np.uint64(2**64 - 1), np.uint64(2**64 - 1))))


def test_normal_numbers_are_normal_and_independent():
    n = 200_000
    normals = np.empty((n, 2))
    fill_normals(words_of(stream_state(np.random.SeedSequence(11)), n), normals)
    for column in normals.T:
        assert stats.kstest(column, "norm").pvalue > 1e-3
    # correlations of values and of squares, standard deviation 1 / sqrt(n) each
    assert abs(np.corrcoef(normals.T)[0, 1]) < 4 / math.sqrt(n)
    assert abs(np.corrcoef(normals.T**2)[0, 1]) < 4 / math.sqrt(n)


def test_indices_are_uniform():
    words = words_of(stream_state(np.random.SeedSequence(2)), 25_000).ravel()
    for n in (1, 3, 16, 1000):
        indices = np.empty(len(words), dtype=np.int64)
        fill_indices(words, n, indices)
        counts = np.bincount(indices, minlength=n)
        assert len(counts) == n
        assert n == 1 or stats.chisquare(counts).pvalue > 1e-3


def test_indices_by_hand():
    indices = np.empty(3, dtype=np.int64)
    fill_indices(np.array([0, 1 << 63, 2**64 - 1], dtype=np.uint64), 10, indices)
    assert indices.tolist() == [0, 5, 9]
