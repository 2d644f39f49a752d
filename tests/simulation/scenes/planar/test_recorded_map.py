import numpy as np
import pytest

from coopmap_env.simulation.scenes.planar import max_pool


def test_a_block_is_occupied_if_any_of_its_cells_is():
    occupied = np.array([[0, 0, 0, 1], [0, 0, 0, 0]], dtype=bool)
    np.testing.assert_array_equal(max_pool(occupied, 2), [[False, True]])


def test_blocks_cut_by_the_border_count_by_the_cells_that_they_have():
    occupied = np.zeros((5, 4), dtype=bool)
    assert not max_pool(occupied, 3).any()
    occupied[4, 3] = True
    np.testing.assert_array_equal(max_pool(occupied, 3), [[False, False], [False, True]])


def test_pooling_by_1_changes_nothing():
    occupied = np.random.default_rng(0).random((5, 7)) < 0.5
    np.testing.assert_array_equal(max_pool(occupied, 1), occupied)


@pytest.mark.parametrize("factor", [0, -3, 2.0, None, False])
def test_a_factor_that_is_no_integer_is_named(factor):
    with pytest.raises(ValueError, match=f"pool must be an integer >= 1, got {factor!r}"):
        max_pool(np.zeros((4, 4), dtype=bool), factor)
