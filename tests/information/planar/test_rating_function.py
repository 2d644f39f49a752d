"""New information, Eqs. 6 to 8; motion distance, Eq. 5; the rating function, Eq. 9."""

import dataclasses
import math

import numpy as np
import pytest
from plain import views
from plain.random_maps import random_map, set_cells

from coopmap_env.information import (
    PlanarRatingFunction,
    PlanarRatingSettings,
    ViewContext,
    entropy,
    motion_distance,
)
from coopmap_env.mapping import OccupancyMap, VoxelGrid
from coopmap_env.robots import PoseLattice
from coopmap_env.sensing import PlanarCamera

READINGS = pytest.mark.parametrize("interpretation", ["literal", "distance_free"])
CAMERA = PlanarCamera(depth_of_field=20.0)
SIZE = 61
MIDDLE = SIZE // 2
LOOKING = 0
"""Heading along x, of 16: one of those from which the camera sees the most cells, N of Eq. 7."""


def unknown_map():
    return OccupancyMap(VoxelGrid((SIZE, SIZE)))


def rating_of(map_, camera=CAMERA, n_headings=16, **settings):
    lattice = PoseLattice(map_.grid, n_headings)
    return PlanarRatingFunction(
        camera, lattice, PlanarRatingSettings(**settings), map_.log_odds_range
    )


def pose_at(x, y, heading=LOOKING, n_headings=16, ny=SIZE):
    return (x * ny + y) * n_headings + heading


HERE = pose_at(MIDDLE, MIDDLE)


def ni(rating, map_, pose_id=HERE, reserved_mask=None):
    (value,) = rating.new_information(map_, [pose_id], ViewContext(reserved_mask))
    return float(value)


# new information, Eqs. 6 to 8


def test_new_information_of_three_cells_by_hand_eqs_6_to_8():
    """One beam over three cells: the own one, free, and two unknown at 1 and 2 of d_max 2.5."""
    map_ = OccupancyMap(VoxelGrid((9, 9)))
    rating = rating_of(map_, PlanarCamera(1.0, 2.5, 1), 4, n_gray_bins=4)
    set_cells(map_, 4 * 9 + 4, 0.001)
    # gray 0, 1.4, 1.8: bins 0, 2, 3 of 4
    assert rating.fan.max_visible_cells == 3
    pose_id = pose_at(4, 4, 0, 4, 9)
    assert ni(rating, map_, pose_id) == pytest.approx(math.log(3))
    # an occupied neighbour, gray 1 - (1 / 0.999 - 1) / 2, hides the rest: bins 0, 1 and, for what
    # is hidden, 0 or none
    set_cells(map_, 5 * 9 + 4, 0.999)
    assert ni(rating, map_, pose_id) == pytest.approx(entropy([2 / 3, 1 / 3]))
    printed = rating_of(map_, PlanarCamera(1.0, 2.5, 1), 4, n_gray_bins=4, hidden="printed")
    assert ni(printed, map_, pose_id) == pytest.approx(2 / 3 * math.log(3))
    # two bins only: gray 1.4 and 1.8 in one of two bins, 0 in the other
    map_.clear()
    set_cells(map_, 4 * 9 + 4, 0.001)
    coarse = rating_of(map_, PlanarCamera(1.0, 2.5, 1), 4, n_gray_bins=2)
    assert ni(coarse, map_, pose_id) == pytest.approx(entropy([1 / 3, 2 / 3]))


@READINGS
@pytest.mark.parametrize("hidden", ["empty", "printed"])
@pytest.mark.parametrize(
    ("camera", "n_headings"),
    [(PlanarCamera(depth_of_field=7.0), 16), (PlanarCamera(2 * math.pi, 5.5, 90), 3)],
)
def test_new_information_is_the_plain_histogram_s_entropy_eqs_6_to_8(
    camera, n_headings, hidden, interpretation
):
    rng = np.random.default_rng(0)
    for n_gray_bins in (64, 7):
        map_ = random_map(rng, (21, 15), unknown=0.4, occupied=0.05)
        rating = rating_of(
            map_, camera, n_headings,
            interpretation=interpretation, hidden=hidden, n_gray_bins=n_gray_bins,
        )  # fmt: skip
        ids = rng.integers(0, rating.lattice.n_poses, 40)
        found = rating.new_information(map_, ids)
        for pose_id, value in zip(ids.tolist(), found, strict=True):
            plain = views.new_information(
                map_, camera, rating.lattice, pose_id, rating.settings, rating.fan.max_visible_cells
            )
            # a sum of 64 terms below 0.4
            assert value == pytest.approx(plain, abs=1e-12)


@READINGS
def test_what_is_known_and_empty_tells_nothing_eq_7(interpretation):
    map_ = unknown_map()
    map_.mark_free(np.arange(map_.grid.n_cells))
    assert ni(rating_of(map_, interpretation=interpretation), map_) == 0


def test_as_printed_a_heading_that_sees_fewer_cells_keeps_a_trace_of_nothing_eq_7():
    """N is one constant of the camera, so a full view of f < N empty cells has NI = -f/N ln f/N."""
    map_ = unknown_map()
    map_.mark_free(np.arange(map_.grid.n_cells))
    rating = rating_of(map_, hidden="printed")
    values = rating.new_information(map_, HERE + np.arange(16))
    counts = np.diff(rating.fan.start)
    assert values == pytest.approx([entropy([f / counts.max()]) for f in counts])
    assert values.max() < 0.03


def test_as_printed_empty_cells_cut_off_by_the_border_seem_to_tell_something_eq_7():
    """A fault of Eq. 7 as printed: half a view of empty cells is worth up to 1/e nats."""
    map_ = unknown_map()
    map_.mark_free(np.arange(map_.grid.n_cells))
    rating = rating_of(map_, hidden="printed")
    values = [ni(rating, map_, pose_at(x, MIDDLE)) for x in range(MIDDLE, SIZE)]
    assert values[0] == 0
    assert 0.3 < max(values) <= 1 / math.e
    poses = np.arange(rating.lattice.n_poses)
    assert not rating_of(map_).new_information(map_, poses).any()


@READINGS
def test_more_unknown_voxels_tell_more_eq_8b(interpretation):
    """From a known view on, cell by cell, until nine in ten are unknown.

    Beyond that the known cells are the rarer event, and NI falls a little again: it is the
    entropy of a histogram, not a count.
    """
    map_ = unknown_map()
    rating = rating_of(map_, interpretation=interpretation)
    visible = rating.visible_cells(map_, HERE)
    for seed in range(5):
        order = np.random.default_rng(seed).permutation(visible)
        values = []
        for known in np.arange(0, len(order) + 1, 12):
            map_.clear()
            map_.mark_free(order[:known])
            values.append(ni(rating, map_))
        tenth = len(order) // 10 // 12 + 1
        assert (np.diff(values[tenth:]) < 0).all()
        # at least a third of the NI of an unknown view, for each third that is unknown
        assert values[0] > 0.97 * max(values)


def test_the_further_the_known_cells_reach_the_less_a_view_tells_eq_8b():
    map_ = unknown_map()
    rating = rating_of(map_)
    visible = rating.visible_cells(map_, HERE)
    values = []
    for known in np.arange(0, len(visible) + 1, 12):
        map_.clear()
        map_.mark_free(visible[:known])
        values.append(ni(rating, map_))
    assert (np.diff(values) < 0).all()


@READINGS
@pytest.mark.parametrize(("hidden", "known"), [("empty", 6), ("printed", 0)])
def test_an_occluder_in_front_leaves_less_to_tell_and_the_nearer_the_less_eq_7(
    hidden, known, interpretation
):
    """Up to the last metres before the depth of field.

    There it hides next to nothing, and is an event of its own that raises the entropy a little. So
    are empty cells of a view that has had next to none: the first `known` cells are known.
    """
    map_ = unknown_map()
    rating = rating_of(map_, interpretation=interpretation, hidden=hidden)
    x, y = np.divmod(np.arange(SIZE * SIZE), SIZE)
    (around,) = np.nonzero(np.hypot(x - MIDDLE, y - MIDDLE) < known)
    map_.mark_free(around)
    free_view = ni(rating, map_)
    single, wall = [], []
    for d in range(max(known, 1), 14):
        for values, width in ((single, 0), (wall, 25)):
            map_.clear()
            map_.mark_free(around)
            row = np.arange(MIDDLE - width, MIDDLE + width + 1)
            set_cells(map_, (MIDDLE + d) * SIZE + row, 0.99)
            values.append(ni(rating, map_))
    assert max(single) < free_view
    assert (np.diff(single) > 0).all()
    assert (np.diff(wall) > 0).all()
    assert wall[0] < 0.2


def information_with_fraction_at(p, interpretation, fraction=0.5, nearest=0.0):
    """NI of a view in which a fraction of the cells has probability p and the rest is empty."""
    map_ = unknown_map()
    map_.mark_free(np.arange(map_.grid.n_cells))
    rating = rating_of(map_, interpretation=interpretation)
    visible = rating.visible_cells(map_, HERE)
    x, y = np.divmod(visible, SIZE)
    d = np.hypot(x - MIDDLE, y - MIDDLE)
    chosen = visible[(d >= nearest) & (np.random.default_rng(0).random(len(visible)) < fraction)]
    set_cells(map_, chosen, p)
    return ni(rating, map_)


def test_free_cells_near_one_half_count_for_more_than_certain_ones_eq_8a():
    certain, doubtful = (information_with_fraction_at(p, "distance_free") for p in (0.01, 0.45))
    assert certain == 0
    assert doubtful > 0.6


def test_the_literal_reading_sees_doubt_within_two_voxels_only_eq_8a():
    assert information_with_fraction_at(0.45, "literal", fraction=1.0) > 0
    assert information_with_fraction_at(0.45, "literal", fraction=1.0, nearest=2.0) == 0
    assert information_with_fraction_at(0.45, "distance_free", fraction=1.0, nearest=2.0) > 0


@pytest.mark.parametrize("sides", [(0.01, 0.11, 0.39, 0.49), (0.89, 0.99, 0.51, 0.61)])
def test_voxels_spread_near_one_half_tell_more_than_spread_near_0_or_1_eq_8a(sides):
    """The histogram does not depend on where its events lie, only how many there are.

    So equal doubts of all cells are as good as none; but the same spread of p fills more bins near
    one half, where gray levels are the finest. Occupied cells stand on an arc, none behind another.
    """
    near_certain, near_half = sides[:2], sides[2:]
    values = []
    for low, high in (near_certain, near_half):
        map_ = unknown_map()
        map_.mark_free(np.arange(map_.grid.n_cells))
        rating = rating_of(map_, interpretation="distance_free")
        visible = rating.visible_cells(map_, HERE)
        x, y = np.divmod(visible, SIZE)
        arc = visible[np.abs(x - MIDDLE) + np.abs(y - MIDDLE) == 14]
        for cell, p in zip(arc, np.linspace(low, high, len(arc)), strict=True):
            set_cells(map_, cell, p)
        values.append(ni(rating, map_))
    assert values[1] > values[0] + 0.02


def test_every_voxel_counts_once_however_many_beams_cross_it_eq_7():
    map_ = OccupancyMap(VoxelGrid((SIZE, SIZE)))
    few, many = (
        rating_of(map_, PlanarCamera(math.radians(60), 8.0, n_beams=n), n_headings=4)
        for n in (64, 640)
    )
    # ten times the beams cross no more than the few cells that fell between two at the rim
    assert (
        few.fan.max_visible_cells <= many.fan.max_visible_cells < 1.25 * few.fan.max_visible_cells
    )
    here = pose_at(MIDDLE, MIDDLE, 0, 4)
    assert ni(few, map_, here) == pytest.approx(ni(many, map_, here), rel=0.05)
    visible = few.visible_cells(map_, here)
    assert len(set(visible.tolist())) == len(visible) == few.count_unknown_cells(map_, [here])[0]


@pytest.mark.parametrize("n_beams", [64, 65])  # one word of bits, and two
def test_unknown_cells_are_those_in_view_that_were_never_sampled(n_beams):
    rng = np.random.default_rng(1)
    map_ = random_map(rng, (21, 15))
    rating = rating_of(map_, PlanarCamera(depth_of_field=7.0, n_beams=n_beams))
    reserved_mask = (rng.random(map_.grid.n_cells) < 0.3).astype(np.uint8)
    ids = rng.integers(0, rating.lattice.n_poses, 60)
    free, reserved = (
        rating.count_unknown_cells(map_, ids),
        rating.count_unknown_cells(map_, ids, ViewContext(reserved_mask)),
    )
    for k, pose_id in enumerate(ids.tolist()):
        visible = rating.visible_cells(map_, pose_id)
        unknown = map_.sampled_mask[visible] == 0
        assert free[k] == unknown.sum()
        assert reserved[k] == (unknown & (reserved_mask[visible] == 0)).sum()


@pytest.mark.parametrize("hidden", ["empty", "printed"])
@pytest.mark.parametrize("n_beams", [64, 65])  # one word of bits, and two
def test_claimed_cells_do_not_count_but_stop_no_beam(n_beams, hidden):
    rng = np.random.default_rng(2)
    map_ = random_map(rng, (21, 15), unknown=0.5, occupied=0.05)
    camera = PlanarCamera(depth_of_field=7.0, n_beams=n_beams)
    rating = rating_of(map_, camera, hidden=hidden)
    reserved_mask = (rng.random(map_.grid.n_cells) < 0.3).astype(np.uint8)
    cells = {divmod(int(cell), 15) for cell in np.flatnonzero(reserved_mask)}
    ids = rng.integers(0, rating.lattice.n_poses, 30)
    for pose_id, value in zip(
        ids, rating.new_information(map_, ids, ViewContext(reserved_mask)), strict=True
    ):
        plain = views.new_information(
            map_,
            camera,
            rating.lattice,
            int(pose_id),
            rating.settings,
            rating.fan.max_visible_cells,
            cells,
        )
        assert value == pytest.approx(plain, abs=1e-12)
    everything = np.ones(map_.grid.n_cells, dtype=np.uint8)
    assert not rating.new_information(map_, ids, ViewContext(everything)).any()


def test_asking_changes_neither_the_map_nor_the_next_answer():
    map_ = random_map(np.random.default_rng(3), (21, 15))
    rating = rating_of(map_, PlanarCamera(depth_of_field=7.0))
    before = map_.log_odds_fixed.copy(), map_.sampled_mask.copy()
    ids = np.arange(0, rating.lattice.n_poses, 7)
    first = rating.new_information(map_, ids)
    rating.rate_team(map_, ids[:3], rating.distance(ids[:3], ids[3:6]))
    assert (rating.new_information(map_, ids) == first).all()
    assert (map_.log_odds_fixed == before[0]).all()
    assert (map_.sampled_mask == before[1]).all()


# motion distance, Eq. 5


def test_motion_distance_by_hand_eq_5():
    # 3 and 4 m, and a quarter turn: sqrt(2 * 25 + 0.5 * (pi / 2)^2)
    d = motion_distance([4.0, 6.0, math.pi / 2], [1.0, 2.0, 0.0], 2.0, 0.5)
    assert d == pytest.approx(math.sqrt(50 + math.pi**2 / 8))
    assert motion_distance([4.0, 6.0, 1.0], [1.0, 2.0, 0.0], 1.0, 0.0) == pytest.approx(5)


def test_motion_distance_turns_the_short_way_eq_5():
    # from 170 to -170 degrees is 20 degrees
    d = motion_distance([0, 0, math.radians(-170)], [0, 0, math.radians(170)], 1.0, 1.0)
    assert d == pytest.approx(math.radians(20))


def test_motion_distance_is_symmetric_and_zero_at_rest_eq_5():
    a, b = np.random.default_rng(4).uniform(-9, 9, (2, 50, 3))
    forth, back = motion_distance(a, b, 1.3, 0.7), motion_distance(b, a, 1.3, 0.7)
    assert forth == pytest.approx(back)
    assert not motion_distance(a, a, 1.3, 0.7).any()
    assert (forth <= np.sqrt(1.3 * ((a - b)[:, :2] ** 2).sum(axis=1) + 0.7 * math.pi**2)).all()


# the rating function, Eq. 9


def test_rating_by_hand_eq_9():
    """3 m ahead and 4 m aside of a quarter turn, at a place with P = 0.2."""
    map_ = unknown_map()
    rating = rating_of(map_, K=0.02, exponent=2.0, alpha_position=1.0, alpha_heading=4.0)
    goal = pose_at(MIDDLE + 3, MIDDLE + 4, 4)
    set_cells(map_, goal // 16, 0.2)
    found = rating.rate(map_, [goal], rating.distance([goal], HERE))
    d = math.sqrt(25 + math.pi**2)
    assert found.distance == pytest.approx([d])
    # a level is 1 / 1024 nat
    assert found.occupancy == pytest.approx([0.2], rel=1e-3)
    assert found.rating == pytest.approx(
        (found.new_information - 0.02 * (25 + math.pi**2)) * (1 - found.occupancy)
    )
    assert found.motion_cost == pytest.approx([0.02 * d * d])


def test_to_stay_costs_nothing_eq_9():
    map_ = unknown_map()
    found = rating_of(map_, K=5.0, alpha_heading=1.0).rate(map_, [HERE], [0.0])
    assert found.distance == 0
    assert found.rating == pytest.approx(found.new_information / 2)


@READINGS
@pytest.mark.parametrize("resolution", [1.0, 0.25])
def test_ratings_are_the_plain_formulas_eqs_5_and_9(interpretation, resolution):
    rng = np.random.default_rng(5)
    map_ = random_map(rng, (21, 15), unknown=0.4, resolution=resolution, origin=(-3.0, 8.0))
    camera = PlanarCamera(depth_of_field=7.0 * resolution)
    rating = rating_of(
        map_,
        camera,
        K=0.3,
        exponent=1.5,
        alpha_position=0.8,
        alpha_heading=0.6,
        interpretation=interpretation,
    )
    s, lattice = rating.settings, rating.lattice
    ids = rng.integers(0, lattice.n_poses, 80)
    current = int(rng.integers(lattice.n_poses))
    reserved_mask = (rng.random(map_.grid.n_cells) < 0.1).astype(np.uint8)
    found = rating.rate(map_, ids, rating.distance(ids, current), ViewContext(reserved_mask))
    d = motion_distance(lattice.poses(ids), lattice.poses(current), 0.8, 0.6)
    p = map_.probability.ravel()[ids // 16]
    assert found.new_information == pytest.approx(
        rating.new_information(map_, ids, ViewContext(reserved_mask))
    )
    assert found.distance == pytest.approx(d)
    assert found.occupancy == pytest.approx(p)
    assert found.rating == pytest.approx((found.new_information - s.K * d**s.exponent) * (1 - p))


def test_the_rating_falls_with_the_way_and_with_the_danger_eq_9():
    map_ = unknown_map()
    rating = rating_of(map_, K=0.05)
    # every view of an unknown world is the same
    goals = [pose_at(MIDDLE + step, MIDDLE) for step in range(6)]
    ratings = rating.rate(map_, goals, rating.distance(goals, HERE)).rating
    assert np.diff(ratings) == pytest.approx(np.full(5, -0.05 / 2))
    danger = []
    for p in (0.01, 0.1, 0.4):
        map_.clear()
        set_cells(map_, goals[3] // 16, p)
        danger.append(
            float(rating.rate(map_, goals[3:4], rating.distance(goals[3:4], HERE)).rating[0])
        )
    assert danger[0] > danger[1] > danger[2]


def test_a_team_counts_what_it_sees_together_once():
    """Each robot is rated without the cells that the robots before it see."""
    rng = np.random.default_rng(6)
    map_ = random_map(rng, (21, 15), unknown=0.6, occupied=0.03)
    rating = rating_of(map_, PlanarCamera(depth_of_field=7.0), K=0.2)
    for _ in range(20):
        ids = rng.integers(0, rating.lattice.n_poses, 3)
        current = rng.integers(0, rating.lattice.n_poses, 3)
        found = rating.rate_team(map_, ids, rating.distance(ids, current))
        reserved_mask = np.zeros(map_.grid.n_cells, dtype=np.uint8)
        for k in range(3):
            alone = rating.rate(
                map_,
                ids[k : k + 1],
                rating.distance(ids[k : k + 1], int(current[k])),
                ViewContext(reserved_mask),
            )
            for name in ("new_information", "distance", "occupancy", "rating"):
                assert getattr(found, name)[k] == pytest.approx(getattr(alone, name)[0])
            reserved_mask[rating.visible_cells(map_, int(ids[k]))] = 1


def test_two_robots_at_one_pose_are_worth_one():
    map_ = unknown_map()
    rating = rating_of(map_)
    together = rating.rate_team(map_, [HERE, HERE], [0.0, 0.0])
    assert together.new_information == pytest.approx([ni(rating, map_), 0.0])


@pytest.mark.parametrize("name", ["K", "exponent", "alpha_position", "alpha_heading"])
@pytest.mark.parametrize("value", [-0.1, math.nan, math.inf])
def test_constants_that_are_negative_or_not_finite_are_refused(name, value):
    with pytest.raises(ValueError, match=rf"PlanarRatingSettings\.{name} .* {value}"):
        dataclasses.replace(PlanarRatingSettings(), **{name: value})


@pytest.mark.parametrize(
    ("name", "value"),
    [("n_gray_bins", 1), ("n_gray_bins", 257), ("interpretation", "odd"), ("hidden", "odd")],
)
def test_bins_and_readings_that_do_not_exist_are_refused(name, value):
    with pytest.raises(ValueError, match=rf"PlanarRatingSettings\.{name} .*{value}"):
        PlanarRatingSettings(**{name: value})
