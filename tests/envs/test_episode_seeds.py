import numpy as np
import pytest

from coopmap_env.envs.step_data import EpisodeSeeds
from coopmap_env.simulation.scenes import world_seed


def words(seed):
    return seed.generate_state(4).tolist()


def test_the_seeds_are_the_children_of_the_worlds_seed_in_a_fixed_order():
    seeds = EpisodeSeeds("validation", 17)
    children = world_seed("validation", 17).spawn(7)
    made = [seeds.scene, seeds.start, seeds.noise, seeds.candidates, seeds.vehicles, seeds.streams]
    expected = [*children[:4], *children[5:]]
    assert list(map(words, made)) == list(map(words, expected))
    assert seeds.next_seed == int(children[4].generate_state(1)[0]) // 2


def test_next_seeds_lead_from_world_to_world_without_a_circle():
    seen, seed = set(), 0
    for _ in range(1000):
        seed = EpisodeSeeds("train", seed).next_seed
        assert 0 <= seed < 2**31
        seen.add(seed)
    assert len(seen) == 1000


@pytest.mark.parametrize("seed", [-1, 0.5, True, "0", np.bool_(False)])
def test_a_seed_that_is_no_index_is_named(seed):
    with pytest.raises(ValueError, match="seed must be an integer of at least 0"):
        EpisodeSeeds("train", seed)
