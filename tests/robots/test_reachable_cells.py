"""Constraints i and ii: what is known to be free, and what is reached through it."""

from collections import deque

import numpy as np
import pytest
from plain.random_maps import random_map, set_cells
from scipy import ndimage

from coopmap_env.mapping import OccupancyMap, VoxelGrid, to_log_odds_fixed
from coopmap_env.robots import ReachableCells, free_mask

SHAPES = [(12, 9), (1, 20), (15, 1), (8, 30)]


def map_of(*rows):
    """Map from text: '.' free, '#' occupied, '?' unknown; each text is a row along y."""
    map_ = OccupancyMap(VoxelGrid((len(rows), len(rows[0]))))
    text = np.array([list(row) for row in rows]).ravel()
    set_cells(map_, np.flatnonzero(text == "."), 0.01)
    set_cells(map_, np.flatnonzero(text == "#"), 0.99)
    return map_


def plain_steps(free, start):
    """Breadth-first search with a queue of index pairs: 1 + steps, 0 where there is no path."""
    steps = np.zeros(free.shape, dtype=int)
    steps[start] = 1
    queue = deque([start])
    while queue:
        x, y = queue.popleft()
        for i, j in ((x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)):
            inside = 0 <= i < free.shape[0] and 0 <= j < free.shape[1]
            if inside and free[i, j] and not steps[i, j]:
                steps[i, j] = steps[x, y] + 1
                queue.append((i, j))
    return steps


def runs_through_corners(delta):
    """Whether the segment between two cell centers meets corners: both odd, in lowest terms."""
    dx, dy = np.abs(delta) // np.gcd(*delta)
    return dx % 2 == dy % 2


def test_free_is_sampled_and_less_than_five_per_cent_occupied():
    map_ = OccupancyMap(VoxelGrid((1, 5)))
    map_.log_odds_fixed[:] = [
        -9999,
        to_log_odds_fixed(0.05),
        to_log_odds_fixed(0.05) - 1,
        to_log_odds_fixed(0.9),
        -9999,
    ]
    map_.sampled_mask[:] = [1, 1, 1, 1, 0]
    assert free_mask(map_).tolist() == [True, False, True, False, False]
    assert [ReachableCells.search(map_, k).steps[k - 1] > 0 for k in range(1, 5)] == [
        True,
        False,
        True,
        False,
    ]


def test_steps_count_from_one_at_the_start():
    map_ = map_of("..#", "?..", "#..")
    reach = ReachableCells.search(map_, 0)
    assert reach.steps.reshape(3, 3).tolist() == [[1, 2, 0], [0, 3, 4], [0, 4, 5]]
    assert reach.cells.tolist() == [0, 1, 4, 7, 5, 8]


def test_a_path_does_not_squeeze_between_two_corners():
    assert ReachableCells.search(map_of(".#", "#."), 0).cells.tolist() == [0]


def test_a_path_never_leads_through_the_unknown():
    assert ReachableCells.search(map_of("..?..", "..?.."), 0).cells.tolist() == [0, 5, 1, 6]


def test_rows_do_not_touch_around_the_border():
    assert ReachableCells.search(map_of("..", "#.", ".#"), 3).cells.tolist() == [3, 1, 0]


def test_a_camera_may_start_where_the_map_is_not_free():
    reach = ReachableCells.search(map_of("?#.", "..."), 0)
    assert sorted(reach.cells.tolist()) == [0, 2, 3, 4, 5]


@pytest.mark.parametrize("start", [-1, 6])
def test_a_search_from_outside_the_map_is_refused(start):
    with pytest.raises(ValueError, match="outside the map of 2 x 3 cells"):
        ReachableCells.search(map_of("...", "..."), start)


@pytest.mark.parametrize("shape", SHAPES)
def test_what_is_reached_is_the_connected_region_of_the_start(shape):
    rng = np.random.default_rng(0)
    for _ in range(30):
        map_ = random_map(rng, shape, unknown=0.15, occupied=0.1)
        free = free_mask(map_).reshape(shape)
        labels, _ = ndimage.label(free)
        for start in rng.choice(np.flatnonzero(free), 3):
            reach = ReachableCells.search(map_, int(start))
            same = labels.ravel() == labels.ravel()[start]
            assert (reach.steps > 0).tolist() == same.tolist()
            assert sorted(reach.cells.tolist()) == np.flatnonzero(same).tolist()


@pytest.mark.parametrize("shape", SHAPES)
def test_steps_are_those_of_a_plain_breadth_first_search_nearest_first(shape):
    rng = np.random.default_rng(1)
    for _ in range(30):
        map_ = random_map(rng, shape, unknown=0.15, occupied=0.1)
        start = int(rng.integers(map_.grid.n_cells))
        reach = ReachableCells.search(map_, start)
        free = free_mask(map_).reshape(shape)
        index = tuple(int(i) for i in np.unravel_index(start, shape))
        assert (reach.steps.reshape(shape) == plain_steps(free, index)).all()
        assert (np.diff(reach.steps[reach.cells]) >= 0).all()
        assert reach.cells[0] == start
