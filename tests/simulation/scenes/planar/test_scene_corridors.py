import hashlib
from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from coopmap_env.simulation.scenes import SPLITS, world_seed
from coopmap_env.simulation.scenes.planar import Corridors
from coopmap_env.simulation.scenes.planar._gallery_plan import (
    cut_bands,
    grow_tree,
    join_dead_ends,
)

GOLDEN = {"train": "c2418b1386ea43f6", "validation": "ad66cf39c0edfeb1", "test": "eeb6b164c7910b57"}
"""SHA-256 of the first world of each split: changing one changes every published result."""

STRAIGHT = Corridors(wander=0.0, dead_ends=1.0, chambers=0.0)
THIN = Corridors(
    shape=(61, 90), corridor=(0.4, 0.4), pitch=0.6, wall=0.2, chambers=0.5, chamber_sides=(0.2, 9.0)
)
"""Corridors of two cells, walls of one."""


def first_world(split, scene):
    return scene.world(np.random.default_rng(world_seed(split, 0)))


def n_joins(joins):
    """How many corridors end at each place."""
    return {place: sum(place in join for join in joins) for place in {p for j in joins for p in j}}


@pytest.mark.parametrize(
    "scene",
    [
        Corridors(),
        Corridors(dead_ends=0.0, corridor=(0.4, 2.8)),
        THIN,
        replace(THIN, pitch=1.3, corridor=(0.4, 0.9)),
        Corridors(shape=(39, 120)),
        STRAIGHT,
    ],
)
def test_every_free_cell_can_be_reached(scene):
    for seed in range(20):
        occupied = scene.world(np.random.default_rng(seed)).occupied
        assert ndimage.label(~occupied)[1] == 1


@pytest.mark.parametrize("scene", [Corridors(), THIN, Corridors(wall=1.0)])
def test_a_wall_surrounds_the_world(scene):
    n = round(scene.wall / scene.resolution)
    for seed in range(5):
        occupied = scene.world(np.random.default_rng(seed)).occupied
        inside = np.zeros_like(occupied)
        inside[n:-n, n:-n] = True
        assert occupied[~inside].all()


def test_only_joined_dead_ends_make_loops():
    corners = np.ones((3, 3))
    for seed in range(10):
        tree = STRAIGHT.world(np.random.default_rng(seed)).occupied
        loops = replace(STRAIGHT, dead_ends=0.0).world(np.random.default_rng(seed)).occupied
        assert ndimage.label(tree, corners)[1] == 1
        assert ndimage.label(loops, corners)[1] > 2


def test_straight_corridors_have_the_requested_widths():
    scene = replace(STRAIGHT, corridor=(0.8, 0.8))  # four cells
    free = ~scene.world(np.random.default_rng(0)).occupied
    squares = ndimage.binary_opening(free, np.ones((4, 4)))
    assert np.count_nonzero(squares) > 0.9 * np.count_nonzero(free)
    assert np.count_nonzero(ndimage.binary_opening(free, np.ones((8, 8)))) == 0


def test_more_chambers_take_up_more_floor():
    fractions = [
        np.mean([~s.world(np.random.default_rng(seed)).occupied for seed in range(5)])
        for s in (Corridors(chambers=0.0), Corridors(chambers=0.3), Corridors(chambers=1.0))
    ]
    assert 0.15 < fractions[0] < fractions[1] < fractions[2] < 0.5


def test_most_of_a_default_world_is_narrow_and_it_has_chambers_and_dead_ends():
    for seed in range(5):
        free = ~Corridors().world(np.random.default_rng(seed)).occupied
        wide = ndimage.binary_opening(free, np.ones((9, 9)))  # 1.8 m, the smallest chamber
        assert 0.01 < np.count_nonzero(wide) / np.count_nonzero(free) < 0.4


def test_bands_fill_a_side_with_walls_in_between():
    for seed in range(20):
        starts, stops = cut_bands(np.random.default_rng(seed), 100, 7, thinnest=5, wall=3)
        assert starts[0] == 3
        assert stops[-1] == 97
        assert (starts[1:] - stops[:-1] == 3).all()
        assert (stops - starts >= 5).all()
        assert np.ptp(stops - starts) >= 2


def test_bands_without_spare_cells_are_as_thin_as_allowed():
    starts, stops = cut_bands(np.random.default_rng(0), 1 + 3 * 4, 3, thinnest=3, wall=1)
    assert starts.tolist() == [1, 5, 9]
    assert stops.tolist() == [4, 8, 12]


def test_the_tree_joins_all_places_to_neighbours_without_loops():
    for seed in range(20):
        joins = grow_tree(np.random.default_rng(seed), (6, 9))
        assert len(joins) == 6 * 9 - 1
        group = {(x, y): (x, y) for x in range(6) for y in range(9)}
        for a, b in joins:
            assert abs(a[0] - b[0]) + abs(a[1] - b[1]) == 1
            assert group[a] != group[b]
            group = {k: group[a] if v == group[b] else v for k, v in group.items()}
        assert len(set(group.values())) == 1


def test_dead_ends_stay_or_are_joined_to_a_neighbour():
    for seed in range(20):
        rng = np.random.default_rng(seed)
        joins = grow_tree(rng, (6, 9))
        dead_ends = [place for place, n in n_joins(joins).items() if n == 1]
        assert len(dead_ends) >= 5
        assert join_dead_ends(rng, joins, (6, 9), 1.0) == []
        added = join_dead_ends(rng, joins, (6, 9), 0.0)
        assert all(join[0] in dead_ends for join in added)
        assert not {frozenset(join) for join in added} & {frozenset(join) for join in joins}
        assert min(n_joins(joins + added).values()) == 2
        some = join_dead_ends(rng, joins, (6, 9), 0.5)
        assert 0 < len(some) < len(added) or len(dead_ends) < 10


def test_a_world_carries_the_fields_of_its_scene():
    scene = Corridors(shape=(60, 44), resolution=0.25, origin=(-1.0, 2.0))
    world = first_world("train", scene)
    assert world.shape == scene.shape == (60, 44)
    assert (world.resolution, world.origin, world.name) == (0.25, (-1.0, 2.0), "corridors")


def test_the_same_generator_state_makes_the_same_world():
    a, b = (Corridors().world(np.random.default_rng(5)).occupied for _ in range(2))
    other = Corridors().world(np.random.default_rng(6)).occupied
    np.testing.assert_array_equal(a, b)
    assert (a != other).any()


@pytest.mark.parametrize("split", SPLITS)
def test_the_first_world_of_each_split_is_frozen(split):
    packed = np.packbits(first_world(split, Corridors()).occupied)
    assert hashlib.sha256(packed.tobytes()).hexdigest()[:16] == GOLDEN[split]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"shape": (4, 200)}, r"Corridors.shape must be .*>= 8.*, got \(4, 200\)"),
        ({"shape": (38, 200)}, r"2 x 2 places every 3.6 m at 0.2 m per cell, not \(38, 200\)"),
        ({"resolution": 0.0}, "Corridors.resolution must be a finite number > 0, got 0.0"),
        ({"wall": 0.0}, "Corridors.wall must be a finite number > 0, got 0.0"),
        ({"corridor": (0.3, 1.0)}, r"two cells wide \(0.4 m\), not \(0.3, 1.0\) m"),
        ({"corridor": (1.5, 1.0)}, r"Corridors.corridor must ascend, not \(1.5, 1.0\)"),
        ({"corridor": (1.0, float("inf"))}, r"Corridors.corridor must be .*inf"),
        ({"pitch": 2.0}, r"the widest corridor and a wall \(2.2 m\), not 2.0 m"),
        ({"pitch": float("nan")}, "Corridors.pitch must be a finite number > 0, got nan"),
        ({"wander": 1.5}, "Corridors.wander must be .*>= 0 and <= 1, got 1.5"),
        ({"dead_ends": -0.1}, "Corridors.dead_ends must be .*>= 0 and <= 1, got -0.1"),
        ({"chambers": 2.0}, "Corridors.chambers must be .*>= 0 and <= 1, got 2.0"),
        ({"chamber_sides": (3.0, 2.0)}, r"chamber_sides must ascend, not \(3.0, 2.0\)"),
    ],
)
def test_a_wrong_setting_is_named_with_its_value(change, message):
    with pytest.raises(ValueError, match=message):
        replace(Corridors(), **change)
