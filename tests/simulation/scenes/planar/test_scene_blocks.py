import numpy as np
import pytest

from coopmap_env.core.pcg64 import SEED_WORDS
from coopmap_env.simulation.scenes.planar import Obstacles
from coopmap_env.simulation.scenes.planar._blocks import (
    MAX_EDGES,
    BlockDraws,
    allocate_rows,
    occupy_block,
    scatter_blocks,
    shape_block,
)

SQUARE = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
"""Normals of a square's edges."""


def scatter(occupied, missing, centers, half_sides):
    """Scatter squares; return how many cells are missing then."""
    rows = allocate_rows(len(occupied))
    for center, half_side in zip(centers, half_sides, strict=True):
        reach = np.sqrt(2) * half_side
        missing -= occupy_block(occupied, missing, center, reach, SQUARE / half_side, rows)
    return missing


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
    draws, law, slopes = BlockDraws.empty(20), scene._block_law, np.empty((20, MAX_EDGES, 2))
    for seed in range(10):
        draws.draw(np.random.default_rng(seed))
        for block in range(20):
            shape_block(block, draws, law, slopes[block])
        expected, occupied = np.zeros((2, 60, 45), dtype=bool)
        still = plain_strew_blocks(expected, missing, draws.centers * scene.shape, slopes)
        assert scatter_blocks(occupied, missing, draws, law) == still
        np.testing.assert_array_equal(occupied, expected)


def test_edges_along_the_axes_hold_the_rows_between_them():
    # Edges along x alone have no lowest or highest y: beyond them a row is empty.
    slopes = np.array([[0.0, -1 / 2.6], [1 / 1.6, 0.0], [-1 / 1.6, 0.0], [0.0, 1 / 2.6]])
    for order in ([0, 1, 2, 3], [1, 2, 0, 3], [3, 0, 2, 1]):
        occupied = np.zeros((9, 9), dtype=bool)
        rows = allocate_rows(9)
        assert occupy_block(occupied, 99, (4.5, 4.5), 4.0, slopes[order], rows) == 3 * 5
        assert occupied[3:6, 2:7].all()


@pytest.mark.parametrize(
    "scene",
    [
        Obstacles(),
        Obstacles(shape=(61, 34), side_max=9.0),
        Obstacles(side_max=4.0, occupied_fraction=0.3),  # more blocks than are drawn at once
        Obstacles(occupied_fraction=0.0),
        Obstacles(occupied_fraction=0.5, polygon_fraction=1.0),
    ],
)
def test_many_worlds_are_those_that_generators_make(scene):
    sequences = np.random.SeedSequence(8).spawn(12)
    seeds = np.array([own.generate_state(SEED_WORDS, np.uint64) for own in sequences])
    which = np.random.default_rng(0).permutation(15)[:12]
    occupied = np.ones((15, scene.shape[0] * scene.shape[1]), dtype=bool)
    scene.write_worlds(which, seeds, occupied)
    for number, own in zip(which, sequences, strict=True):
        world = scene.world(np.random.default_rng(own))
        np.testing.assert_array_equal(occupied[number], world.occupied.ravel())
    assert np.delete(occupied, which, axis=0).all()
