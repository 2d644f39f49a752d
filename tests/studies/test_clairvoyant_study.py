"""The parts of the gap to the bound, by hand, and the table of the command."""

import numpy as np
import pytest

from coopmap_env.studies.clairvoyant import split_gap
from coopmap_env.studies.clairvoyant.__main__ import main


def test_by_hand_the_parts_of_the_gap_add_up_to_the_bound():
    gap = split_gap(100, 1100, 1000, 900, 600)
    assert gap == (0.5, pytest.approx(0.3), pytest.approx(0.1), pytest.approx(0.1))
    two = split_gap([0, 10], [10, 20], [8, 20], [6, 15], [6, 10])
    np.testing.assert_allclose(two.efficiency, [0.6, 0.0])
    np.testing.assert_allclose(two.search, [0.0, 0.5])
    np.testing.assert_allclose(two.knowledge, [0.2, 0.5])
    np.testing.assert_allclose(two.information, [0.2, 0.0])
    np.testing.assert_allclose(np.sum(two, axis=0), 1.0)


def test_a_bound_that_allows_nothing_has_no_parts():
    with pytest.raises(ValueError, match="above its start"):
        split_gap([1, 2], [3, 2], [1, 2], [1, 2], [1, 2])


def test_the_command_prints_a_row_for_each_policy(capsys):
    scene = '{"name": "obstacles", "shape": [24, 24], "side_min": 2, "side_max": 6}'
    options = ["--scans=2", "--worlds=2", "--reach=5", "--n-scans=2", "--n-tried=2", "--rounds=1"]
    main([scene, *options])
    rows = capsys.readouterr().out.splitlines()
    assert rows[0] == (
        "| policy | shown, % | efficiency | of area | search | knowledge | information | ms |"
    )
    assert [row.split(" | ")[0].strip("| ") for row in rows[2:]] == [
        "random",
        "rating, m = 100",
        "coverage, sequential, m = 300",
        "frontier",
        "clairvoyant, greedy",
        "clairvoyant, look-ahead",
    ]
    main([scene, *options, "--candidates=8"])
    assert len(capsys.readouterr().out.splitlines()) == len(rows)
