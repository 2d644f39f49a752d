"""Which cells a pose sees: the prepared fan equals tracing every beam."""

import itertools
import math

import numpy as np
import pytest
from plain.random_maps import random_map, set_cells
from plain.views import visible_cells

from coopmap_env.geometry import traverse
from coopmap_env.information import PlanarRatingFunction, PlanarRatingSettings
from coopmap_env.mapping import OccupancyMap, VoxelGrid
from coopmap_env.robots import PoseLattice
from coopmap_env.sensing import BeamFan, PlanarCamera

CAMERAS = [
    pytest.param(PlanarCamera(depth_of_field=9.0), 16, id="default beams"),
    pytest.param(PlanarCamera(math.radians(90), 7.3, 64), 8, id="one full word"),
    pytest.param(PlanarCamera(math.radians(100), 8.0, 65), 4, id="one beam too many"),
    pytest.param(PlanarCamera(2 * math.pi, 6.0, 200), 3, id="all around"),
    pytest.param(PlanarCamera(1.0, 7.0, 1), 7, id="one beam"),
    pytest.param(PlanarCamera(1.0, 0.3, 4), 2, id="not beyond its own cell"),
]


def rating_of(map_, camera, n_headings):
    lattice = PoseLattice(map_.grid, n_headings)
    return PlanarRatingFunction(camera, lattice, PlanarRatingSettings(), map_.log_odds_range)


def seen(rating, map_, pose_id):
    cells = rating.visible_cells(map_, pose_id)
    assert len(set(cells.tolist())) == len(cells)
    return {tuple(int(i) for i in np.unravel_index(cell, map_.grid.shape)) for cell in cells}


def pose_at(map_, x, y, heading, n_headings):
    return (x * map_.grid.shape[1] + y) * n_headings + heading


def test_one_beam_sees_the_row_ahead_up_to_and_with_the_first_occupied_cell():
    map_ = OccupancyMap(VoxelGrid((10, 3)))
    rating = rating_of(map_, PlanarCamera(1.0, 6.0, 1), 4)
    ahead = pose_at(map_, 1, 1, 0, 4)
    # the depth of field of 6 ends in the middle of cell 7
    assert seen(rating, map_, ahead) == {(x, 1) for x in range(1, 8)}
    set_cells(map_, 5 * 3 + 1, 0.5)
    assert seen(rating, map_, ahead) == {(x, 1) for x in range(1, 6)}


def test_unknown_and_free_cells_let_beams_pass():
    map_ = OccupancyMap(VoxelGrid((10, 3)))
    rating = rating_of(map_, PlanarCamera(1.0, 6.0, 1), 4)
    set_cells(map_, 3 * 3 + 1, 0.49)
    assert len(seen(rating, map_, pose_at(map_, 1, 1, 0, 4))) == 7


def test_a_beam_ends_at_the_border():
    map_ = OccupancyMap(VoxelGrid((10, 3)))
    rating = rating_of(map_, PlanarCamera(1.0, 6.0, 1), 4)
    assert seen(rating, map_, pose_at(map_, 1, 1, 2, 4)) == {(1, 1), (0, 1)}


def test_a_camera_within_an_occupied_cell_sees_that_cell_only():
    map_ = OccupancyMap(VoxelGrid((10, 3)))
    rating = rating_of(map_, PlanarCamera(1.0, 6.0, 8), 4)
    set_cells(map_, 4, 0.9)
    assert seen(rating, map_, pose_at(map_, 1, 1, 0, 4)) == {(1, 1)}


@pytest.mark.parametrize(("camera", "n_headings"), CAMERAS)
def test_a_view_is_what_walking_every_beam_finds(camera, n_headings):
    rng = np.random.default_rng(0)
    for shape in ((17, 13), (3, 30)):
        map_ = random_map(rng, shape, unknown=0.4, occupied=0.1)
        rating = rating_of(map_, camera, n_headings)
        corners = [(0, 0), (0, shape[1] - 1), (shape[0] - 1, 0), (shape[0] - 1, shape[1] - 1)]
        for x, y in [*corners, *rng.integers(0, shape, (4, 2)).tolist()]:
            for heading in range(n_headings):
                pose_id = pose_at(map_, x, y, heading, n_headings)
                plain = visible_cells(map_, camera, rating.lattice, pose_id)
                assert seen(rating, map_, pose_id) == plain


def test_a_view_along_diagonals_is_what_walking_every_beam_finds_away_from_the_border():
    """At the border a beam through a corner touches, with no length, what lies beside it or not."""
    rng = np.random.default_rng(2)
    camera = PlanarCamera(math.radians(90), 6.0, 5)
    for _ in range(10):
        map_ = random_map(rng, (19, 19), unknown=0.4, occupied=0.1)
        rating = rating_of(map_, camera, 8)
        for x, y in rng.integers(7, 12, (4, 2)).tolist():
            for heading in range(8):
                pose_id = pose_at(map_, x, y, heading, 8)
                plain = visible_cells(map_, camera, rating.lattice, pose_id)
                assert seen(rating, map_, pose_id) == plain


def test_a_view_does_not_depend_on_where_the_world_lies_or_how_large_its_cells_are():
    rng = np.random.default_rng(1)
    unit = random_map(rng, (15, 15))
    rng = np.random.default_rng(1)
    scaled = random_map(rng, (15, 15), resolution=0.05, origin=(-7.3, 11.9))
    camera, small = PlanarCamera(depth_of_field=8.0), PlanarCamera(depth_of_field=0.4)
    one, two = rating_of(unit, camera, 16), rating_of(scaled, small, 16)
    for pose_id in rng.integers(0, 15 * 15 * 16, 100):
        assert seen(one, unit, pose_id) == seen(two, scaled, pose_id)


def test_cells_of_a_view_come_nearest_first():
    map_ = OccupancyMap(VoxelGrid((20, 20)))
    rating = rating_of(map_, PlanarCamera(depth_of_field=9.0), 8)
    cells = rating.visible_cells(map_, pose_at(map_, 10, 10, 3, 8))
    steps = np.square(np.stack(np.unravel_index(cells, (20, 20))).T - 10).sum(axis=1)
    assert (np.diff(steps) >= 0).all()


def test_no_cell_that_lies_wholly_in_the_default_view_is_missed():
    camera, n_headings = PlanarCamera(), 16
    fan = BeamFan.from_camera(camera, 1.0, n_headings)
    index = np.stack(np.meshgrid(*[np.arange(-27, 28)] * 2, indexing="ij"), axis=-1).reshape(-1, 2)
    corners = index[:, None] + np.array([[-0.5, -0.5], [-0.5, 0.5], [0.5, -0.5], [0.5, 0.5]])
    far = np.hypot(*corners.transpose(2, 0, 1))
    for h in range(n_headings):
        bearing = np.arctan2(corners[..., 1], corners[..., 0]) - h * 2 * np.pi / n_headings
        off = np.abs(np.angle(np.exp(1j * bearing)))
        inside = ((off < camera.field_of_view / 2) & (far < camera.depth_of_field)).all(axis=1)
        listed = set(map(tuple, fan.offsets[fan.start[h] : fan.start[h + 1]].tolist()))
        assert inside.sum() > 150
        assert set(map(tuple, index[inside].tolist())) <= listed


def test_the_fan_knows_its_constants():
    camera = PlanarCamera(math.radians(90), 10.0, 70)
    fan = BeamFan.from_camera(camera, 0.5, 8)
    assert fan.n_headings == 8
    assert fan.depth == 20
    assert len(fan.all_beams) == 2
    assert [int(word).bit_count() for word in fan.all_beams] == [64, 6]
    assert fan.max_offset == 20
    assert fan.max_visible_cells == max(np.diff(fan.start))
    assert fan.distance == pytest.approx(np.linalg.norm(fan.offsets.astype(float), axis=1))


def test_every_beam_of_the_fan_crosses_its_cells_and_no_other():
    camera, n_headings = PlanarCamera(math.radians(200), 6.0, 70), 3
    fan = BeamFan.from_camera(camera, 1.0, n_headings)
    for h in range(n_headings):
        for beam, bearing in enumerate(camera.bearings):
            word, bit = divmod(beam, 64)
            words = fan.beams[word, fan.start[h] : fan.start[h + 1]]
            own = words >> np.uint64(bit) & np.uint64(1)
            offsets = fan.offsets[fan.start[h] : fan.start[h + 1]][own == 1]
            angle = bearing + h * 2 * np.pi / n_headings
            ray = traverse([10.5, 10.5], [np.cos(angle), np.sin(angle)], 6.0, (21, 21))
            assert sorted(map(tuple, offsets.tolist())) == sorted(
                map(tuple, (ray.cells - 10).tolist())
            )


def test_four_quarter_turns_see_the_same_cells_turned():
    map_ = OccupancyMap(VoxelGrid((31, 31)))
    rating = rating_of(map_, PlanarCamera(math.radians(70), 9.0, 33), 4)
    views = [
        np.array(sorted(seen(rating, map_, pose_at(map_, 15, 15, h, 4)))) - 15 for h in range(4)
    ]
    R = np.array([[0, -1], [1, 0]])
    for view, turned in itertools.pairwise(views):
        assert sorted((view @ R.T).tolist()) == sorted(turned.tolist())
