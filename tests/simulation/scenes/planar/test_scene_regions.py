import numpy as np
import pytest
from scipy import ndimage

from coopmap_env.simulation.scenes.planar import Rooms, largest_free_region


def free(*shape):
    return np.zeros(shape, dtype=bool)


def plain_largest_free_region(occupied):
    """Label regions in C order, as scipy does; the first of the largest ones."""
    labels, n = ndimage.label(~occupied)
    return (labels == 1 + np.argmax(np.bincount(labels.ravel())[1:])) & (n > 0) & ~occupied


def test_regions_that_touch_at_a_corner_are_apart():
    occupied = np.array([[0, 0, 1], [1, 1, 0], [1, 1, 0]], dtype=bool)
    expected = np.array([[1, 1, 0], [0, 0, 0], [0, 0, 0]], dtype=bool)
    # Two regions of two cells each: the first in C order is taken.
    np.testing.assert_array_equal(largest_free_region(occupied), expected)


def test_the_largest_free_region_wins_wherever_it_lies():
    occupied = np.array([[0, 1, 0], [1, 1, 0], [0, 0, 0]], dtype=bool)
    expected = ~occupied
    expected[0, 0] = False
    np.testing.assert_array_equal(largest_free_region(occupied), expected)


def test_a_full_grid_has_no_free_region():
    assert not largest_free_region(~free(3, 4)).any()


@pytest.mark.parametrize("fraction", [0.0, 0.1, 0.3, 0.4, 0.5, 0.7, 0.95])
def test_the_region_is_that_of_a_plain_labelling(fraction):
    rng = np.random.default_rng(0)
    for _ in range(200):  # small grids have many ties
        occupied = rng.random(rng.integers(1, 14, size=2)) < fraction
        if not occupied.all():
            expected = plain_largest_free_region(occupied)
            np.testing.assert_array_equal(largest_free_region(occupied), expected)
    occupied = rng.random((150, 190)) < fraction
    np.testing.assert_array_equal(
        largest_free_region(occupied), plain_largest_free_region(occupied)
    )


def test_runs_that_meet_late_are_one_region():
    comb = free(9, 21)
    comb[:-1, 1::2] = True  # teeth apart but for the last row
    np.testing.assert_array_equal(largest_free_region(comb), ~comb)
    np.testing.assert_array_equal(largest_free_region(comb[::-1]), ~comb[::-1])


def test_a_read_only_world_and_a_transposed_one_are_taken_as_they_are():
    occupied = Rooms().world(np.random.default_rng(0)).occupied
    region = largest_free_region(occupied)
    np.testing.assert_array_equal(region, ~occupied)
    np.testing.assert_array_equal(largest_free_region(occupied.T), region.T)
