import itertools

import numpy as np
import pytest

from coopmap_env.simulation.scenes import SPLITS, world_seed

GOLDEN = [2662188533, 436224622, 1169763260]
"""First words of seed 7 of each split."""


def first_words(split, seed):
    return tuple(world_seed(split, seed).generate_state(4).tolist())


def test_the_splits_are_frozen():
    assert SPLITS == ("train", "validation", "test")
    assert [first_words(split, 7)[0] for split in SPLITS] == GOLDEN


def test_no_two_worlds_share_a_stream():
    seeds = [*range(50), 2**32, 2**64, 2**128, 2**160]
    words = {first_words(split, seed) for split, seed in itertools.product(SPLITS, seeds)}
    assert len(words) == len(SPLITS) * len(seeds)


def test_the_same_world_has_the_same_stream_each_time():
    assert first_words("test", 3) == first_words("test", np.int64(3))


def test_children_of_a_plain_seed_are_not_the_streams_of_splits():
    children = np.random.SeedSequence(7).spawn(len(SPLITS))
    plain = {tuple(child.generate_state(4).tolist()) for child in children}
    assert plain.isdisjoint(first_words(split, 7) for split in SPLITS)


def test_children_of_worlds_are_unrelated_across_splits():
    children = [child for split in SPLITS for child in world_seed(split, 7).spawn(3)]
    assert len({tuple(child.generate_state(4).tolist()) for child in children}) == 9


def test_an_unknown_split_is_named_with_the_choices():
    with pytest.raises(ValueError, match="train, validation, test, not 'dev'"):
        world_seed("dev", 0)


@pytest.mark.parametrize("seed", [-1, 1.0, "1", None, True, np.True_])
def test_a_seed_that_is_no_integer_is_named(seed):
    with pytest.raises(ValueError, match=f"integer of at least 0, not {seed!r}"):
        world_seed("train", seed)
