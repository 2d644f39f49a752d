import hashlib
from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from coopmap_env.simulation.scenes import SPLITS, Obstacles, largest_free_region, world_seed

GOLDEN = {"train": "9f4de10a318306c1", "validation": "0584acba41c875ff", "test": "5133bd0eeab89656"}
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


@pytest.mark.parametrize("share", [0.0, 0.01, 0.12, 0.3, 0.5])
def test_the_occupied_share_is_met_to_the_cell(share):
    scene = Obstacles(shape=(100, 50), occupied_share=share)
    for seed in range(5):
        world = scene.world(np.random.default_rng(seed))
        assert np.count_nonzero(world.occupied) == round(share * 5000)


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


def test_a_lone_rectangle_has_the_area_of_its_sides():
    scene = Obstacles(shape=(101, 101), polygon_share=0.0, side_min=20.0, side_max=20.0)
    turns, distances = scene._random_block(np.random.default_rng(0))
    np.testing.assert_allclose(distances, 10.0)
    np.testing.assert_allclose(np.diff(turns), 0.25)
    areas = []
    for seed in range(20):
        occupied = np.zeros((101, 101), dtype=bool)
        new = scene._strew_block(np.random.default_rng(seed), occupied, at_most=10**6)
        assert new == np.count_nonzero(occupied)
        inside = not (occupied[[0, -1]].any() or occupied[:, [0, -1]].any())
        areas += [new] if inside else []
    # 400 cells but for those along its edges that fall to one side by chance.
    np.testing.assert_allclose(areas, 400, rtol=0.03)


def test_a_block_is_convex_and_never_cut_by_its_patch():
    scene = Obstacles(shape=(80, 80), polygon_share=1.0, side_min=16.0, side_max=16.0)
    for seed in range(30):
        rng = np.random.default_rng(seed)
        turns, distances = scene._random_block(rng)
        centre = np.array(rng.random(2) * 80)
        cells = np.stack(np.meshgrid(*[np.arange(80) + 0.5] * 2, indexing="ij"), axis=-1)
        normals = np.stack([np.cos(2 * np.pi * turns), np.sin(2 * np.pi * turns)])
        expected = ((cells - centre) @ normals <= distances).all(axis=-1)
        occupied = np.zeros((80, 80), dtype=bool)
        scene._strew_block(np.random.default_rng(seed), occupied, at_most=10**6)
        # A cell centre within rounding of an edge may fall to either side.
        assert np.count_nonzero(occupied != expected) <= 1


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
        ({"shape": (200, 4)}, r"8 x 8 cells, not \(200, 4\)"),
        ({"resolution": -1.0}, "above 0 m, not -1.0"),
        ({"occupied_share": 0.51}, r"\[0, 0.5\], not 0.51"),
        ({"occupied_share": float("nan")}, "nan"),
        ({"side_min": 30.0}, "1.0, 30.0, 20.0"),
        ({"side_min": 0.5}, "1.0, 0.5, 20.0"),
        ({"side_max": float("inf")}, "inf"),
        ({"polygon_share": 1.5}, r"\[0, 1\], not 1.5"),
    ],
)
def test_a_wrong_setting_is_named_with_its_value(change, message):
    with pytest.raises(ValueError, match=message):
        replace(Obstacles(), **change)
