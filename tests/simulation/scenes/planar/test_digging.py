import numpy as np
import pytest

from coopmap_env.simulation.scenes.planar._digging import Blocks, boxes, dig, strips


def plain_dig(shape, blocks):
    """Look at the middle of each cell: inside of all edges of a block."""
    middles = np.stack(np.indices(shape), axis=-1) + 0.5
    dug = np.zeros(shape, dtype=bool)
    for part in blocks:
        for center, slopes in zip(part.centers, part.slopes, strict=True):
            dug |= ((middles - center) @ slopes.T <= 1.0).all(axis=-1)
    return dug


def test_a_strip_along_an_axis_covers_its_rectangle():
    starts, ends = np.array([[2.0, 5.0]]), np.array([[9.0, 5.0]])
    dug = dig((12, 10), [strips(starts, ends, np.array([1.6]))])
    expected = np.zeros((12, 10), dtype=bool)
    expected[2:9, 3:7] = True  # middles at 0.5 and 1.5 cells from the line
    np.testing.assert_array_equal(dug, expected)


@pytest.mark.parametrize(("corner_gauge", "n_corners"), [(2.0, 0), (1.4, 2)])
def test_a_box_has_its_sides_and_cut_corners(corner_gauge, n_corners):
    dug = dig((12, 12), [boxes(np.array([[6.0, 6.0]]), np.array([[3.0, 4.0]]), corner_gauge)])
    expected = np.zeros((12, 12), dtype=bool)
    expected[3:9, 2:10] = True
    assert not (dug & ~expected).any()
    assert np.count_nonzero(expected & ~dug) == 4 * n_corners


def test_blocks_are_dug_as_by_the_plain_check_of_each_cell():
    rng = np.random.default_rng(0)
    for _ in range(20):
        shape = tuple(rng.integers(8, 40, 2).tolist())
        points = rng.uniform(-5.0, 45.0, (3, 6, 2))
        blocks = [
            strips(points[0], points[1], rng.uniform(0.5, 4.0, 6)),
            boxes(points[2], rng.uniform(0.5, 6.0, (6, 2)), 1.6),
        ]
        np.testing.assert_array_equal(dig(shape, blocks), plain_dig(shape, blocks))


def test_reaches_contain_the_corners_of_blocks():
    strip = strips(np.array([[0.0, 0.0]]), np.array([[3.0, 4.0]]), np.array([2.0]))
    assert isinstance(strip, Blocks)
    assert strip.reaches[0] == 4.5  # half of 5, and 2
    assert boxes(np.zeros((1, 2)), np.array([[3.0, 4.0]]), 1.4).reaches[0] == 7.0
