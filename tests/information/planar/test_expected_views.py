"""How many new cells a view is expected to show."""

import math

import numpy as np
import pytest
from plain.random_maps import random_map, set_cells

from coopmap_env.geometry import traverse
from coopmap_env.information import PlanarExpectedViews, PlanarRatingFunction, PlanarRatingSettings
from coopmap_env.information._mutual_information import MIN_REACH_PROBABILITY
from coopmap_env.information.near_surface import HAZARDS
from coopmap_env.mapping import OccupancyMap, VoxelGrid
from coopmap_env.robots import PoseLattice
from coopmap_env.sensing import PlanarCamera

FAR = HAZARDS[-1]


def views_of(map_, camera, n_headings=1):
    lattice = PoseLattice(map_.grid, n_headings)
    return PlanarExpectedViews(
        PlanarRatingFunction(camera, lattice, PlanarRatingSettings(), map_.log_odds_range)
    )


def row(*probabilities):
    """A map of one row along x with these probabilities; None is never sampled."""
    map_ = OccupancyMap(VoxelGrid((len(probabilities), 1)))
    for cell, p in enumerate(probabilities):
        if p is not None:
            set_cells(map_, cell, p)
    return map_


def one_beam(map_, length=9.0):
    views = views_of(map_, PlanarCamera(1.0, length, 1))
    (count,) = views.count(views.cells(map_), [0])
    return float(count)


def test_a_beam_into_the_unknown_by_hand():
    passing = 1 - FAR
    expected = 0.99 * (1 + passing + passing**2)  # the free cell lets 0.99 of the beams pass
    # a level of log-odds is 1 / 1024 nat
    assert one_beam(row(0.01, None, None, None)) == pytest.approx(expected, rel=1e-4)


def test_surfaces_are_expected_to_go_on():
    # beyond the depth of field of three cells, a wall: the unknown cells are 2 and 1 from it
    near = one_beam(row(0.01, None, None, 0.99), length=2.6)
    assert near == pytest.approx(0.99 * (1 + (1 - HAZARDS[1])), rel=1e-4)
    assert near < one_beam(row(0.01, None, None, 0.01), length=2.6)


def test_what_lies_behind_an_occupied_cell_adds_next_to_nothing():
    assert one_beam(row(0.01, 0.999, None, None)) < 0.0021


def brute_hazard(map_, cell):
    """By comparing with every occupied cell."""
    sampled, occupied = map_.sampled, map_.probability >= 0.5
    steps = [
        max(abs(i - cell[0]), abs(j - cell[1])) for i, j in np.argwhere(sampled & occupied).tolist()
    ]
    return HAZARDS[min([*steps, len(HAZARDS)]) - 1]


def plain_view(map_, camera, pose):
    """Probability that each cell is reached, by the luckiest of the beams."""
    x, y, heading = pose
    reached = {}
    for bearing in camera.bearings + heading:
        chance, direction = 1.0, [math.cos(bearing), math.sin(bearing)]
        for cell in traverse([x, y], direction, camera.depth_of_field, map_.grid.shape).cells:
            cell = tuple(cell.tolist())
            reached[cell] = max(reached.get(cell, 0.0), chance)
            p = map_.probability[cell] if map_.sampled[cell] else brute_hazard(map_, cell)
            chance *= 1 - p
            if chance < MIN_REACH_PROBABILITY:
                break
    return reached


@pytest.mark.parametrize(
    ("camera", "n_headings"),
    [(PlanarCamera(depth_of_field=6.0), 16), (PlanarCamera(2 * math.pi, 4.5, 70), 3)],
)
def test_a_view_is_the_plain_sum_with_each_cell_once_by_its_luckiest_beam(camera, n_headings):
    rng = np.random.default_rng(0)
    map_ = random_map(rng, (17, 13), unknown=0.4, occupied=0.02)
    views = views_of(map_, camera, n_headings)
    reserved_mask = (rng.random(map_.grid.n_cells) < 0.2).astype(np.uint8)
    every, rest = views.cells(map_), views.cells(map_, reserved_mask)
    ids = rng.integers(0, views.rating.lattice.n_poses, 12)
    counts, rest_counts = views.count(every, ids), views.count(rest, ids)
    for k, pose_id in enumerate(ids.tolist()):
        reached = plain_view(map_, camera, views.rating.lattice.pose(pose_id))
        new = {i * 13 + j: v for (i, j), v in reached.items() if not map_.sampled[i, j]}
        # single precision
        assert counts[k] == pytest.approx(sum(new.values()), rel=1e-4, abs=1e-5)
        left = sum(v for cell, v in new.items() if not reserved_mask[cell])
        assert rest_counts[k] == pytest.approx(left, rel=1e-4, abs=1e-5)
        seen, probability = views.view(every, pose_id)
        assert dict(zip(seen.tolist(), probability.tolist(), strict=True)) == pytest.approx(
            new, rel=1e-4, abs=1e-6
        )


def test_a_view_that_is_taken_lowers_what_is_new_and_opens_what_may_be_free():
    map_ = row(0.01, None, None, None, None)
    views = views_of(map_, PlanarCamera(1.0, 3.2, 1))
    cells = views.cells(map_)
    future = cells.copy()
    views.take(future, 0, 0.5)
    reached = 0.5 * 0.99 * (1 - FAR) ** np.arange(3)
    np.testing.assert_allclose(future.weight, [0, *(1 - reached), 1], rtol=1e-4)
    np.testing.assert_allclose(future.free, [1, *(reached * (1 - FAR)), 0], rtol=1e-4)
    np.testing.assert_array_equal(cells.weight, [0, 1, 1, 1, 1])
    np.testing.assert_array_equal(cells.free, [1, 0, 0, 0, 0])
    assert views.count(future, [0])[0] < views.count(cells, [0])[0]


def test_reserved_cells_are_not_new_but_may_end_beams():
    map_ = row(0.01, None, None)
    views = views_of(map_, PlanarCamera(1.0, 9.0, 1))
    cells = views.cells(map_, np.array([0, 1, 0], dtype=np.uint8))
    assert views.count(cells, [0])[0] == pytest.approx(0.99 * (1 - FAR), rel=1e-4)


def test_predictions_of_unknown_cells_replace_the_hazards():
    map_ = row(0.01, None, None, None, 0.99)
    views = views_of(map_, PlanarCamera(1.0, 9.0, 1))
    predicted = np.array([0.9, 0.25, 0.5, 0.0, 0.0], dtype=np.float32)  # of known cells: not used
    cells = views.cells(map_, unknown_occupancy=predicted)
    by_hand = 0.99 * (1 + 0.75 + 0.75 * 0.5)
    assert views.count(cells, [0])[0] == pytest.approx(by_hand, rel=1e-4)
    np.testing.assert_allclose(cells.passing, [0.99, 0.75, 0.5, 1.0, 0.01], atol=1e-3)


@pytest.mark.parametrize(
    ("predicted", "message"),
    [
        (np.zeros(4, np.float32), r"one value for each of 5 cells, got an array of shape \(4,\)"),
        (np.full(5, np.nan, np.float32), "probabilities from 0 to 1, got nan to nan"),
        (np.full(5, 1.5, np.float32), r"probabilities from 0 to 1, got 1\.5 to 1\.5"),
    ],
)
def test_predictions_that_are_no_probabilities_are_refused(predicted, message):
    map_ = row(0.01, None, None, None, 0.99)
    views = views_of(map_, PlanarCamera(1.0, 9.0, 1))
    with pytest.raises(ValueError, match=rf"^unknown_occupancy must .*{message}"):
        views.cells(map_, unknown_occupancy=predicted)
