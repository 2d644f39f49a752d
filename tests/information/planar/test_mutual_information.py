"""Mutual information between a map and the beams of a pose."""

import math

import numpy as np
import pytest
from plain.random_maps import random_map, set_cells

from coopmap_env.geometry import traverse
from coopmap_env.information import (
    PlanarMutualInformation,
    PlanarRatingFunction,
    PlanarRatingSettings,
    ViewContext,
    entropy,
)
from coopmap_env.information._mutual_information import MIN_REACH_PROBABILITY
from coopmap_env.mapping import OccupancyMap, VoxelGrid
from coopmap_env.robots import PoseLattice
from coopmap_env.sensing import PlanarCamera


def information_of(map_, camera, n_headings):
    lattice = PoseLattice(map_.grid, n_headings)
    return PlanarMutualInformation(
        PlanarRatingFunction(camera, lattice, PlanarRatingSettings(), map_.log_odds_range)
    )


def row(*probabilities):
    """A map of one row along x with these probabilities."""
    map_ = OccupancyMap(VoxelGrid((len(probabilities), 1)))
    for cell, p in enumerate(probabilities):
        set_cells(map_, cell, p)
    return map_


def one_beam(map_, length):
    (value,) = information_of(map_, PlanarCamera(1.0, length, 1), 1).mutual_information(map_, [0])
    return float(value)


def test_a_beam_through_unknown_cells_by_hand():
    # own cell for certain, then with chances 1/2 and 1/4: (1 + 1/2 + 1/4) ln 2
    assert one_beam(OccupancyMap(VoxelGrid((3, 1))), 9.0) == pytest.approx(1.75 * math.log(2))


def test_the_information_of_a_beam_is_the_entropy_of_the_first_occupied_cell():
    """What is read without noise is a cell or none; the chain rule gives one term for each."""
    p = [0.1, 0.3, 0.6, 0.2]
    reading, passed = [], 1.0
    for q in p:
        reading.append(passed * q)
        passed *= 1 - q
    # a level is 1 / 1024 nat
    assert one_beam(row(*p), 9.0) == pytest.approx(entropy([*reading, passed]), rel=1e-3)


def test_what_lies_behind_an_occupied_cell_adds_next_to_nothing():
    near, far = one_beam(row(0.01, 0.999), 9.0), one_beam(row(0.01, 0.999, 0.5, 0.5), 9.0)
    assert far - near < 2 * 0.001 * math.log(2)


def test_the_depth_of_field_ends_the_beam():
    assert one_beam(OccupancyMap(VoxelGrid((9, 1))), 0.9) == pytest.approx(1.5 * math.log(2))


@pytest.mark.parametrize(
    ("camera", "n_headings"),
    [(PlanarCamera(depth_of_field=7.0), 16), (PlanarCamera(2 * math.pi, 5.5, 90), 3)],
)
def test_a_view_is_the_plain_sum_with_each_cell_once_by_its_luckiest_beam(camera, n_headings):
    rng = np.random.default_rng(0)
    map_ = random_map(rng, (17, 13), unknown=0.4, occupied=0.1)
    information = information_of(map_, camera, n_headings)
    lattice = PoseLattice(map_.grid, n_headings)
    p = map_.probability
    reserved_mask = (rng.random(map_.grid.n_cells) < 0.2).astype(np.uint8)
    ids = rng.integers(0, lattice.n_poses, 30)
    free = information.mutual_information(map_, ids)
    rest_only = information.mutual_information(map_, ids, ViewContext(reserved_mask))
    for k, pose_id in enumerate(ids.tolist()):
        x, y, heading = lattice.pose(pose_id)
        reached = {}
        for bearing in camera.bearings + heading:
            chance = 1.0
            direction = [math.cos(bearing), math.sin(bearing)]
            for cell in traverse([x, y], direction, camera.depth_of_field, p.shape).cells.tolist():
                cell = tuple(cell)
                reached[cell] = max(reached.get(cell, 0.0), chance)
                chance *= 1 - p[cell]
                if chance < MIN_REACH_PROBABILITY:
                    break
        terms = {cell: v * entropy([p[cell], 1 - p[cell]]) for cell, v in reached.items()}
        # a sum of some hundred terms below ln 2
        assert free[k] == pytest.approx(sum(terms.values()), abs=1e-9)
        rest = sum(t for (i, j), t in terms.items() if not reserved_mask[i * 13 + j])
        assert rest_only[k] == pytest.approx(rest, abs=1e-9)


def test_asking_twice_gives_the_same_answer():
    map_ = random_map(np.random.default_rng(1), (17, 13))
    information = information_of(map_, PlanarCamera(depth_of_field=7.0), 8)
    ids = np.arange(0, 17 * 13 * 8, 5)
    first = information.mutual_information(map_, ids)
    assert (information.mutual_information(map_, ids[::-1]) == first[::-1]).all()
