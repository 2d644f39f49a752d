import hashlib
from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from coopmap_env.simulation.scenes import SPLITS, world_seed
from coopmap_env.simulation.scenes.planar import Obstacles, largest_free_region
from coopmap_env.simulation.scenes.planar._blocks import MAX_EDGES, BlockDraws, shape_block

GOLDEN = {"train": "4d9736c9b5a83c61", "validation": "a7b0eaed2ab289e6", "test": "600d87ddf41d96e2"}
"""SHA-256 of the first world of each split: changing one changes every published result."""


def first_world(split, scene):
    return scene.world(np.random.default_rng(world_seed(split, 0)))


def test_a_world_carries_the_fields_of_its_scene():
    scene = Obstacles(shape=(40, 60), resolution=0.5, origin=(-1.0, 2.0), side_max=8.0)
    world = first_world("train", scene)
    assert world.shape == scene.shape == (40, 60)
    assert world.resolution == scene.resolution == 0.5
    assert world.origin == scene.origin == (-1.0, 2.0)
    assert world.name == scene.name == "obstacles"


@pytest.mark.parametrize("fraction", [0.0, 0.01, 0.12, 0.3, 0.5])
def test_the_occupied_fraction_is_exact_to_the_cell(fraction):
    scene = Obstacles(shape=(100, 50), occupied_fraction=fraction)
    for seed in range(5):
        world = scene.world(np.random.default_rng(seed))
        assert np.count_nonzero(world.occupied) == round(fraction * 5000)


def test_the_default_world_is_mostly_one_free_region_with_many_obstacles():
    for seed in range(10):
        occupied = Obstacles().world(np.random.default_rng(seed)).occupied
        assert largest_free_region(occupied).sum() > 0.99 * np.count_nonzero(~occupied)
        assert ndimage.label(occupied)[1] > 15


def test_obstacles_may_reach_the_border_but_no_wall_surrounds_the_world():
    borders = []
    for seed in range(10):
        occupied = Obstacles().world(np.random.default_rng(seed)).occupied
        borders.append(
            np.concatenate([occupied[0], occupied[-1], occupied[:, 0], occupied[:, -1]]).mean()
        )
    assert 0.0 < np.mean(borders) < 0.3


def test_obstacles_are_as_likely_in_each_quarter_of_the_world():
    scene = Obstacles(shape=(60, 60), side_max=10.0)
    worlds = [scene.world(np.random.default_rng(seed)).occupied for seed in range(100)]
    quarters = np.mean(worlds, axis=0).reshape(2, 30, 2, 30).mean(axis=(1, 3))
    # About 14 blocks a world, 350 a quarter: three standard errors are about a sixth.
    np.testing.assert_allclose(quarters, 0.12, rtol=0.2)


def random_blocks(scene, n):
    """Normals (k, 2) and distances (k,) of the edges of n blocks in cells, and their reaches."""
    draws, slopes = BlockDraws.empty(n), np.empty((MAX_EDGES, 2))
    draws.draw(np.random.default_rng(0))
    for block in range(n):
        reach = shape_block(block, draws, scene._block_law, slopes)
        steepness = np.hypot(*slopes.T)
        is_edge = steepness > 0.0
        assert (np.diff(is_edge.astype(int)) <= 0).all()  # those that are missing come last
        steepness = steepness[is_edge]
        yield slopes[is_edge] / steepness[:, None], 1.0 / steepness, reach


def gaps_between(normals):
    """Angles from each normal to the next, in full turns."""
    turns = np.arctan2(normals[:, 1], normals[:, 0]) / (2 * np.pi)
    return np.diff(turns, append=turns[0]) % 1.0


def test_a_rectangle_has_two_pairs_of_parallel_edges():
    scene = Obstacles(polygon_fraction=0.0)
    for normals, distances, _ in random_blocks(scene, 50):
        np.testing.assert_allclose(gaps_between(normals), [0.25] * 4)
        np.testing.assert_allclose(distances[:2], distances[2:], rtol=1e-14)
        assert (2 * distances >= scene.side_min * (1 - 1e-14)).all()
        assert (2 * distances <= scene.side_max * (1 + 1e-14)).all()


def test_polygons_have_3_to_6_edges_around_them():
    numbers = set()
    for normals, _, _ in random_blocks(Obstacles(polygon_fraction=1.0), 200):
        numbers.add(len(normals))
        gaps = gaps_between(normals)
        assert gaps.sum() == pytest.approx(1.0)
        assert (gaps > 0.0).all()
        assert (gaps < 0.5).all()
    assert numbers == {3, 4, 5, 6}


def test_the_polygon_fraction_is_the_fraction_of_polygons():
    blocks = random_blocks(Obstacles(polygon_fraction=0.4), 2000)
    is_rectangle = [
        len(normals) == 4 and np.allclose(gaps_between(normals), 0.25) for normals, _, _ in blocks
    ]
    # Three standard errors of a fraction of 0.4 among 2000.
    assert 1.0 - np.mean(is_rectangle) == pytest.approx(0.4, abs=0.033)


def test_no_corner_of_a_block_lies_beyond_its_reach():
    for normals, distances, reach in random_blocks(Obstacles(), 200):
        for k in range(len(distances)):
            pair = [k - 1, k]
            corner = np.linalg.solve(normals[pair], distances[pair])
            assert np.hypot(*corner) <= reach


def test_a_crowded_world_takes_more_blocks_than_are_drawn_at_once():
    scene = Obstacles(side_max=4.0, occupied_fraction=0.3)
    occupied = scene.world(np.random.default_rng(0)).occupied
    assert np.count_nonzero(occupied) == 12_000  # 750 blocks of 4 x 4 cells at least


def test_the_same_generator_state_makes_the_same_world():
    a, b = (Obstacles().world(np.random.default_rng(5)).occupied for _ in range(2))
    other = Obstacles().world(np.random.default_rng(6)).occupied
    np.testing.assert_array_equal(a, b)
    assert (a != other).any()


@pytest.mark.parametrize("split", SPLITS)
def test_the_first_world_of_each_split_is_frozen(split):
    packed = np.packbits(first_world(split, Obstacles()).occupied)
    assert hashlib.sha256(packed.tobytes()).hexdigest()[:16] == GOLDEN[split]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"shape": (200, 4)}, r"Obstacles.shape must be .*>= 8.*, got \(200, 4\)"),
        ({"resolution": -1.0}, "Obstacles.resolution must be a finite number > 0, got -1.0"),
        ({"occupied_fraction": 0.51}, "Obstacles.occupied_fraction must be .* <= 0.5, got 0.51"),
        ({"occupied_fraction": float("nan")}, "nan"),
        ({"side_min": 30.0}, "1.0, 30.0, 20.0"),
        ({"side_min": 0.5}, "1.0, 0.5, 20.0"),
        ({"side_max": float("inf")}, "inf"),
        ({"side_max": 1e20}, r"Obstacles.side_max must be .* to 1e\+12, got 1e\+20"),
        ({"polygon_fraction": 1.5}, "Obstacles.polygon_fraction must be .* <= 1, got 1.5"),
    ],
)
def test_a_wrong_setting_is_named_with_its_value(change, message):
    with pytest.raises(ValueError, match=message):
        replace(Obstacles(), **change)
