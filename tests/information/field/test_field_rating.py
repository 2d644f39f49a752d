"""The rating function in space, Eqs. 5 to 9, and the search from coarse to fine."""

import math

import numpy as np
import pytest
from plain import dense_views
from plain.random_maps import set_cells
from plain.random_voxel_map import random_poses, random_voxel_map

from coopmap_env.information import (
    FieldRatingFunction,
    FieldRatingSettings,
    ViewContext,
    joint_distance,
)
from coopmap_env.mapping import LogOddsRange, OccupancyMap, VoxelGrid
from coopmap_env.sensing import DepthCamera

SMALL = DepthCamera(far=1.5)
SHAPE = (22, 18, 15)
MIDDLE = [[1.53, 1.52, 1.51]]
ALONG_X = [np.eye(3)]


def empty_map():
    return OccupancyMap(VoxelGrid((32, 31, 31), 0.1))


def rating_of(map_, camera=SMALL, **settings):
    return FieldRatingFunction(
        camera, map_.grid, FieldRatingSettings(**settings), map_.log_odds_range
    )


# new information, Eqs. 6 to 8


@pytest.mark.parametrize(
    ("camera", "interpretation", "hidden"),
    # the second one sees voxels nearer than two, for which the literal Eq. 8a depends on distance
    [
        (SMALL, "literal", "printed"),
        (DepthCamera(near=0.0, far=0.7), "literal", "empty"),
        (SMALL, "distance_free", "empty"),
    ],
)
def test_new_information_is_the_plain_histogram_s_entropy_eqs_6_to_8(
    camera, interpretation, hidden
):
    rng = np.random.default_rng(0)
    for n_gray_bins in (64, 7):
        map_ = random_voxel_map(rng, SHAPE, 6, 3)
        rating = rating_of(
            map_, camera, interpretation=interpretation, hidden=hidden, n_gray_bins=n_gray_bins
        )
        frustum = rating.fine.frustum
        reserved_mask = (rng.random(map_.grid.n_cells) < 0.2).astype(np.uint8)
        R, t = random_poses(rng, map_, 6)
        ni, unknown = rating.new_information(map_, (R, t)), rating.count_unknown_cells(map_, (R, t))
        rest = rating.new_information(map_, (R, t), ViewContext(reserved_mask))
        rest_unknown = rating.count_unknown_cells(map_, (R, t), ViewContext(reserved_mask))
        blocked = map_.sampled & (map_.probability >= 0.5)
        for k in range(6):
            seen, d = dense_views.visible_mask(
                blocked, map_.grid.to_cell_units(t[k]), R[k], frustum
            )
            args = d, rating.settings, rating.max_visible_cells, frustum.far
            # a sum of 64 terms below 0.4
            plain = dense_views.new_information(map_, seen, *args)
            assert ni[k] == pytest.approx(plain, abs=1e-12)
            assert unknown[k] == (seen & (map_.sampled_mask == 0)).sum()
            seen &= reserved_mask == 0
            plain = dense_views.new_information(map_, seen, *args)
            assert rest[k] == pytest.approx(plain, abs=1e-12)
            assert rest_unknown[k] == (seen & (map_.sampled_mask == 0)).sum()


def test_what_is_known_and_empty_tells_nothing_or_as_printed_what_the_count_is_off_eq_7():
    map_ = empty_map()
    map_.mark_free(np.arange(map_.grid.n_cells))
    rating = rating_of(map_, hidden="printed")
    seen = len(rating.visible_cells(map_, (ALONG_X[0], MIDDLE[0])))
    assert seen == pytest.approx(rating.max_visible_cells, rel=0.02)
    assert rating.new_information(map_, (ALONG_X, MIDDLE))[0] < 0.02
    R, t = random_poses(np.random.default_rng(6), map_, 40, any_orientation=True)
    assert rating.new_information(map_, (R, t)).max() > 0.3  # cut off by the border
    assert not rating_of(map_).new_information(map_, (R, t)).any()


@pytest.mark.parametrize("hidden", ["empty", "printed"])
def test_new_information_lies_between_zero_and_the_logarithm_of_the_bins_eq_6(hidden):
    """Also where a view holds a few voxels more than N, which is a volume."""
    map_ = empty_map()
    rating = rating_of(map_, DepthCamera(far=0.8), hidden=hidden, n_gray_bins=2)
    R, t = random_poses(np.random.default_rng(7), map_, 200, any_orientation=True)
    for known in (False, True):
        if known:
            map_.mark_free(np.arange(map_.grid.n_cells))
        values = rating.new_information(map_, (R, t))
        assert 0 <= values.min() <= values.max() <= math.log(2)
    counts = [len(rating.visible_cells(map_, pose)) for pose in zip(R, t, strict=True)]
    assert max(counts) > rating.max_visible_cells


def test_an_unknown_view_tells_the_entropy_of_its_shells_eq_8b():
    """In space the far shells hold the most voxels: the bins have volumes (r + 1)^3 - r^3."""
    map_ = empty_map()
    rating = rating_of(map_, n_gray_bins=8)
    edges = np.maximum(np.array([0, 0.25, 0.5, 0.75, 1.0]), 0.3 / 1.5)
    q = np.diff(edges**3) / (1 - 0.2**3)
    expected = -(q * np.log(q)).sum()
    # shells of four voxels, rounded to voxels
    assert rating.new_information(map_, (ALONG_X, MIDDLE))[0] == pytest.approx(expected, rel=0.02)


def test_a_wall_in_front_leaves_less_to_tell_and_the_nearer_the_less_eq_7():
    map_ = empty_map()
    rating = rating_of(map_)
    values = [rating.new_information(map_, (ALONG_X, MIDDLE))[0]]
    for x in (28, 25, 22, 19):
        cells = np.arange(map_.grid.n_cells).reshape(map_.grid.shape)[x]
        set_cells(map_, cells.ravel(), 0.99)
        values.append(rating.new_information(map_, (ALONG_X, MIDDLE))[0])
    assert (np.diff(values) < 0).all()


# teams


def test_an_overlap_counts_once_for_the_robot_that_comes_first():
    rng = np.random.default_rng(1)
    map_ = random_voxel_map(rng, SHAPE, 6, 3)
    rating = rating_of(map_)
    R, t = random_poses(rng, map_, 4)
    R[2], t[2] = R[0], t[0]
    d = np.array([0.1, 0.2, 0.3, 0.4])
    occluder_spheres = [(t[[j for j in range(4) if j != k]], np.full(3, 0.1)) for k in range(4)]
    found = rating.rate_team(map_, (R, t), d, occluder_spheres)
    reserved_mask = np.zeros(map_.grid.n_cells, dtype=np.uint8)
    for k in range(4):
        one = R[k : k + 1], t[k : k + 1]
        context = ViewContext(reserved_mask, occluder_spheres[k])
        alone = rating.rate(map_, one, d[k : k + 1], context)
        for name in ("new_information", "distance", "motion_cost", "occupancy", "rating"):
            assert getattr(found, name)[k] == pytest.approx(getattr(alone, name)[0])
        reserved_mask[rating.visible_cells(map_, (R[k], t[k]), context)] = 1
    assert found.new_information[2] == 0
    assert (
        rating.sequential_new_information(map_, (R, t), occluder_spheres) == found.new_information
    ).all()


def test_asking_changes_neither_the_map_nor_the_next_answer():
    rng = np.random.default_rng(2)
    map_ = random_voxel_map(rng, SHAPE, 6, 3)
    rating = rating_of(map_)
    R, t = random_poses(rng, map_, 40)
    log_odds_fixed, sampled = map_.log_odds_fixed.copy(), map_.sampled_mask.copy()
    first = rating.new_information(map_, (R, t))
    team = rating.rate_team(map_, (R[:3], t[:3]), np.zeros(3)).new_information
    with pytest.raises(ValueError, match="radii"):  # the second robot's, after the first view
        rating.sequential_new_information(
            map_, (R[:2], t[:2]), [None, (np.zeros((2, 3)), np.zeros(1))]
        )
    assert (rating.rate_team(map_, (R[:3], t[:3]), np.zeros(3)).new_information == team).all()
    rating.new_information(map_, (R, t), ViewContext(coarse=True))
    assert (rating.new_information(map_, (R[::-1], t[::-1])) == first[::-1]).all()
    assert (map_.log_odds_fixed == log_odds_fixed).all()
    assert (map_.sampled_mask == sampled).all()


# motion distance and the rating, Eqs. 5 and 9


def test_joint_distance_by_hand_eq_5():
    # 3 rad and 4 m with weights 1 and 0.25: sqrt(9 + 4)
    assert joint_distance([[4.0, 5.0]], [1.0, 1.0], [1.0, 0.25]) == pytest.approx([math.sqrt(13)])
    assert joint_distance([1.0, 2.0], [1.0, 2.0], [1.0, 1.0]) == 0
    # a joint does not turn past its limits
    assert joint_distance([math.pi], [-math.pi], [1.0]) == pytest.approx(2 * math.pi)


def test_rating_by_hand_eq_9():
    map_ = empty_map()
    rating = rating_of(map_, K=0.1, exponent=2.0)
    set_cells(map_, int(map_.grid.flat_index([15, 15, 15])), 0.2)
    found = rating.rate(map_, (ALONG_X, MIDDLE), [3.0])
    assert found.distance == pytest.approx([3.0])
    assert found.motion_cost == pytest.approx([0.9])
    # a level is 1 / 1024 nat
    assert found.occupancy == pytest.approx([0.2], rel=1e-3)
    expected = (found.new_information - 0.9) * (1 - found.occupancy)
    assert found.rating == pytest.approx(expected)


def test_a_camera_outside_the_grid_is_worth_nothing_eq_9():
    map_ = empty_map()
    found = rating_of(map_).rate(map_, (ALONG_X, [[1.5, 1.5, 3.2]]), [0.5])
    assert found.occupancy == 1
    assert found.rating == 0
    assert found.new_information == 0


# from coarse to fine


def test_views_of_the_pooled_map_agree_with_those_of_the_map():
    rng = np.random.default_rng(4)
    map_ = random_voxel_map(rng, (128, 128, 40), 25, 10)
    rating = rating_of(map_, DepthCamera())
    R, t = random_poses(rng, map_, 100)
    for score in (rating.new_information, rating.count_unknown_cells):
        fine, coarse = score(map_, (R, t)), score(map_, (R, t), ViewContext(coarse=True))
        assert np.corrcoef(fine, coarse)[0, 1] > 0.97
        assert coarse.mean() == pytest.approx(fine.mean(), rel=0.15)
    assert rating.coarse.frustum.pixels == (12, 9)


def test_the_best_thirty_on_the_pooled_map_hold_the_best_ten_on_the_map():
    rng = np.random.default_rng(5)
    map_ = random_voxel_map(rng, (128, 128, 40), 25, 10)
    rating = rating_of(map_, DepthCamera())
    R, t = random_poses(rng, map_, 200)
    d = rng.uniform(0, 2, 200)
    every = rating.rate(map_, (R, t), d).rating
    rough = rating.rate(map_, (R, t), d, ViewContext(coarse=True)).rating
    best, short = np.argsort(-every), np.argsort(-rough)[:30]
    assert best[0] in short
    assert len(set(best[:10]) & set(short)) >= 9


# what is refused


def test_maps_of_another_kind_are_refused():
    rating = rating_of(empty_map())
    other = OccupancyMap(VoxelGrid((32, 31, 31), 0.2))
    with pytest.raises(ValueError, match=r"0\.2"):
        rating.new_information(other, (ALONG_X, MIDDLE))
    clamped = OccupancyMap(empty_map().grid, log_odds_range=LogOddsRange(0.9))
    with pytest.raises(ValueError, match="clamp 2250"):
        rating.new_information(clamped, (ALONG_X, MIDDLE))
    with pytest.raises(ValueError, match=r"0\.2"):
        rating.occupancy(other, MIDDLE)
    with pytest.raises(ValueError, match="3-D grid"):
        FieldRatingFunction(SMALL, VoxelGrid((9, 9)))


def test_arguments_that_do_not_fit_are_refused():
    map_ = empty_map()
    rating = rating_of(map_)
    with pytest.raises(ValueError, match=r"\(3, 3\) and \(1, 3\)"):
        rating.new_information(map_, (np.eye(3), MIDDLE))
    with pytest.raises(ValueError, match="not finite"):
        rating.new_information(map_, (ALONG_X, [[1.0, math.nan, 1.0]]))
    with pytest.raises(ValueError, match="reserved_mask must be uint8"):
        rating.new_information(map_, (ALONG_X, MIDDLE), ViewContext(np.zeros(5, dtype=np.uint8)))
    with pytest.raises(ValueError, match=r"occluder_spheres .* \(2, 3\) and \(3,\)"):
        rating.new_information(
            map_,
            (ALONG_X, MIDDLE),
            ViewContext(occluder_spheres=(np.zeros((2, 3)), np.ones(3))),
        )
    with pytest.raises(ValueError, match=r"1 poses need as many values .* \(2,\)"):
        rating.rate_from_new_information(map_, (ALONG_X, MIDDLE), 0.0, np.zeros(2))
    with pytest.raises(ValueError, match=r"translations have the shape .* \(3,\)"):
        rating.occupancy(map_, MIDDLE[0])
    with pytest.raises(ValueError, match="one entry for each of 1 poses, got 2"):
        rating.sequential_new_information(map_, (ALONG_X, MIDDLE), [None, None])
    with pytest.raises(ValueError, match="occluder_spheres have a value that is not finite"):
        rating.new_information(
            map_, (ALONG_X, MIDDLE), ViewContext(occluder_spheres=([[0, 0, math.inf]], [1.0]))
        )


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("K", -1.0),
        ("exponent", math.nan),
        ("n_gray_bins", 1),
        ("interpretation", "odd"),
        ("hidden", "odd"),
    ],
)
def test_constants_out_of_range_are_refused(name, value):
    with pytest.raises(ValueError, match=rf"FieldRatingSettings\.{name} .*{value}"):
        FieldRatingSettings(**{name: value})
