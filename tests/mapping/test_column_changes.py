import numpy as np
from plain.random_scans import random_scan

from coopmap_env.mapping import OccupancyMap, VoxelGrid
from coopmap_env.mapping.column_changes import ColumnChanges


def test_by_hand_each_column_has_the_number_of_its_last_change():
    changes = ColumnChanges((2, 3, 4))
    assert changes.count == 0
    changes.add(np.array([0, 3, 23]))  # columns 0, 0 and 5
    changes.add(np.array([20]))  # column 5
    assert changes.count == 2
    np.testing.assert_array_equal(changes.last_change, [1, 0, 0, 0, 0, 2])
    changes.add_all()
    np.testing.assert_array_equal(changes.last_change, [3] * 6)


def test_all_columns_that_differ_are_marked():
    """After scans few others are; who marks cells has all columns marked."""
    rng = np.random.default_rng(0)
    grid = VoxelGrid((12, 10, 6), 0.1, (0.0, 0.0, 0.0))
    map_ = OccupancyMap(grid)
    changes = map_.changes
    assert map_.changes is changes
    for change in [
        *(lambda: map_.integrate([random_scan(rng, grid, 4) for _ in range(2)]) for _ in range(6)),
        lambda: map_.mark_occupied(rng.choice(grid.n_cells, 5)),
    ]:
        before, count = map_.log_odds_fixed.copy(), changes.count
        change()
        differs = (map_.log_odds_fixed != before).reshape(120, 6).any(axis=1)
        marked = changes.last_change > count
        assert marked[differs].all()
        assert 0 < differs.sum() < 100
        assert marked.sum() < 100 or marked.all()
    assert marked.all()
