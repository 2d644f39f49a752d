from itertools import pairwise

import numpy as np
import pytest

from coopmap_env.envs.step_data import EpisodeSeeds, SeedDraws
from coopmap_env.simulation.scenes import world_seed


def words(seed):
    return seed.generate_state(4).tolist()


def test_the_seeds_are_the_children_of_the_worlds_seed_in_a_fixed_order():
    seeds = EpisodeSeeds("validation", 17)
    made = [
        seeds.scene, seeds.start, seeds.noise, seeds.candidates, seeds.seeds, seeds.vehicles,
        seeds.streams,
    ]  # fmt: skip
    assert list(map(words, made)) == list(map(words, world_seed("validation", 17).spawn(7)))


def worlds_of(draws, *seeds):
    """Seeds of the worlds of episodes that begin one after the other."""
    found = []
    for seed in seeds:
        drawn = draws.seeds_of("train", seed)
        if seed is not None:
            draws.follow(drawn)
        found.append(words(drawn.scene))
    return found


def test_the_seed_that_was_given_decides_those_that_are_drawn():
    found = worlds_of(SeedDraws(), 5, None, None)
    assert worlds_of(SeedDraws(), None, 5, None, None)[1:] == found
    assert worlds_of(SeedDraws(), 6, None)[1] != found[1]
    assert found[0] == words(EpisodeSeeds("train", 5).scene)


def test_no_circle_of_worlds_is_met_however_many_are_drawn():
    # A seed that depended on the last one alone would repeat after some 50,000 worlds.
    draws = SeedDraws()
    draws.follow(draws.seeds_of("train", 0))
    drawn = [draws.seeds_of("train", None).index for _ in range(200_000)]
    pairs = set(pairwise(drawn))
    assert len(pairs) == len(drawn) - 1


def test_an_episode_that_did_not_begin_changes_nothing():
    draws, other = SeedDraws(), SeedDraws()
    worlds_of(draws, 3)
    worlds_of(other, 3)
    with pytest.raises(ValueError, match="-1"):
        draws.seeds_of("train", -1)
    draws.seeds_of("train", 4)
    assert worlds_of(draws, None) == worlds_of(other, None)


@pytest.mark.parametrize("seed", [-1, 0.5, True, "0", np.bool_(False)])
def test_a_seed_that_is_no_index_is_named(seed):
    with pytest.raises(ValueError, match="seed must be an integer of at least 0"):
        EpisodeSeeds("train", seed)
