import numpy as np
import pytest

from coopmap_env.simulation.scenes.planar import Obstacles
from coopmap_env.simulation.scenes.planar._blocks import scatter_blocks

SQUARE = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
"""Normals of a square's edges."""


def scatter(occupied, missing, centers, half_sides):
    """Scatter squares."""
    half_sides = np.array(half_sides)
    slopes = SQUARE / half_sides[:, None, None]
    return scatter_blocks(occupied, missing, np.array(centers), np.sqrt(2) * half_sides, slopes)


def plain_strew_blocks(occupied, missing, centers, slopes):
    """Rate all cells by the gauge of each block; occupy the lowest, of equals the first."""
    cells = np.stack(np.indices(occupied.shape), axis=-1).reshape(-1, 2) + 0.5
    for center, edges in zip(centers, slopes, strict=True):
        gauge = np.maximum((cells - center) @ edges.T, 0.0).max(axis=1)
        gauge[occupied.ravel()] = np.inf
        order = np.argsort(gauge, kind="stable")[: min(missing, np.count_nonzero(gauge <= 1.0))]
        occupied.ravel()[order] = True
        missing -= len(order)
    return missing


def test_a_square_occupies_the_cells_whose_centers_it_holds():
    occupied = np.zeros((8, 10), dtype=bool)
    assert scatter(occupied, 20, [(3.0, 5.0)], [1.6]) == 4
    expected = np.zeros_like(occupied)
    expected[1:5, 3:7] = True  # centers 1.5 to 4.5 and 3.5 to 6.5
    np.testing.assert_array_equal(occupied, expected)


def test_a_block_that_would_overshoot_shrinks_about_its_center():
    occupied = np.zeros((9, 9), dtype=bool)
    assert scatter(occupied, 9, [(4.5, 4.5)], [3.6]) == 0
    expected = np.zeros_like(occupied)
    expected[3:6, 3:6] = True
    np.testing.assert_array_equal(occupied, expected)


def test_of_cells_on_the_same_edge_the_first_are_taken():
    occupied = np.zeros((9, 9), dtype=bool)
    assert scatter(occupied, 2, [(4.5, 4.5)], [3.6]) == 0
    np.testing.assert_array_equal(np.argwhere(occupied), [[3, 3], [4, 4]])


def test_occupied_cells_count_once_and_later_blocks_go_unused():
    occupied = np.zeros((9, 9), dtype=bool)
    assert scatter(occupied, 18, [(3.0, 3.0), (3.0, 3.0), (5.0, 3.0)], [1.6, 1.6, 1.6]) == 0
    assert np.count_nonzero(occupied) == 18
    assert scatter(occupied, 0, [(7.0, 7.0)], [1.6]) == 0
    assert np.count_nonzero(occupied) == 18


@pytest.mark.parametrize("missing", [1, 50, 300, 1500, 10_000])
@pytest.mark.parametrize("polygon_fraction", [0.0, 1.0])
def test_the_kernel_scatters_as_the_plain_gauge_of_all_cells(polygon_fraction, missing):
    scene = Obstacles(shape=(60, 45), polygon_fraction=polygon_fraction)
    for seed in range(10):
        centers, reaches, slopes = scene._random_blocks(np.random.default_rng(seed), 20)
        expected, occupied = np.zeros((2, 60, 45), dtype=bool)
        still = plain_strew_blocks(expected, missing, centers, slopes)
        assert scatter_blocks(occupied, missing, centers, reaches, slopes) == still
        np.testing.assert_array_equal(occupied, expected)
