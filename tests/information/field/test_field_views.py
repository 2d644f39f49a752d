"""Which voxels a camera pose would see on the known map, in space."""

import math

import numpy as np
import pytest
from plain import dense_views
from plain.random_maps import set_cells
from plain.random_voxel_map import random_poses, random_voxel_map, rotation

from coopmap_env.geometry import RigidTransform, traverse
from coopmap_env.information import FieldRatingFunction, ViewContext
from coopmap_env.information.field.views import allocate_view, trace_view
from coopmap_env.mapping import OccupancyMap, VoxelGrid
from coopmap_env.sensing import DepthCamera

SMALL = DepthCamera(far=1.5)
WIDE = DepthCamera(math.radians(110), math.radians(95), near=0.15, far=0.9)
ALONG_X = np.eye(3)


def blocked_cells(map_):
    return map_.sampled & (map_.probability >= 0.5)


def in_cells(map_, translation):
    return map_.grid.to_cell_units(translation)


@pytest.mark.parametrize("camera", [SMALL, WIDE])
@pytest.mark.parametrize("n_bodies", [0, 6])
def test_a_view_is_that_of_the_plain_depth_buffer(camera, n_bodies):
    rng = np.random.default_rng(0)
    for _ in range(2):
        map_ = random_voxel_map(rng, (22, 18, 15), 8, 4, origin=(-1.0, 0.3, -0.2))
        rating = FieldRatingFunction(camera, map_.grid)
        R, t = random_poses(rng, map_, 8, any_orientation=True)
        for k in range(8):
            centers = t[k] + rng.normal(0, 0.5, (n_bodies, 3))
            radii = rng.uniform(0.03, 0.25, n_bodies)
            found = rating.visible_cells(
                map_, (R[k], t[k]), ViewContext(occluder_spheres=(centers, radii))
            )
            occluder_spheres = list(zip(in_cells(map_, centers), radii / 0.1, strict=True))
            seen, _ = dense_views.visible_mask(
                blocked_cells(map_),
                in_cells(map_, t[k]),
                R[k],
                rating.fine.frustum,
                occluder_spheres,
            )
            assert sorted(found.tolist()) == np.flatnonzero(seen).tolist()


def test_a_weighted_view_is_the_sum_over_the_plain_depth_buffer():
    rng = np.random.default_rng(1)
    map_ = random_voxel_map(rng, (22, 18, 15), 8, 4, origin=(-1.0, 0.3, -0.2))
    rating = FieldRatingFunction(SMALL, map_.grid)
    weights = rng.random(map_.grid.n_cells, dtype=np.float32)
    R, t = random_poses(rng, map_, 8, any_orientation=True)
    spheres = t[0] + rng.normal(0, 0.5, (3, 3)), rng.uniform(0.03, 0.25, 3)
    found = rating.visible_weight(map_, (R, t), weights, ViewContext(occluder_spheres=spheres))
    hiding = list(zip(in_cells(map_, spheres[0]), spheres[1] / 0.1, strict=True))
    for k in range(8):
        position, frustum = in_cells(map_, t[k]), rating.fine.frustum
        seen, _ = dense_views.visible_mask(blocked_cells(map_), position, R[k], frustum, hiding)
        assert found[k] == pytest.approx(weights[seen].sum(dtype=float), rel=1e-12)
    assert rating.visible_weight(map_, (R[:0], t[:0]), weights).shape == (0,)


@pytest.mark.parametrize("weights", [np.ones(8, np.float32), np.ones(31**3), 1.0])
def test_weights_of_another_shape_or_type_are_named(weights):
    map_ = empty_map()
    rating = FieldRatingFunction(SMALL, map_.grid)
    with pytest.raises(ValueError, match=r"weights must be float32 of shape \(29791,\), got float"):
        rating.visible_weight(map_, (ALONG_X[None], np.ones((1, 3))), weights)


def test_the_number_of_unknown_voxels_is_that_of_dense_rays_and_so_is_the_best_pose():
    """Rays that pass four to a voxel at the far end; the camera and grid are the default ones."""
    for seed in range(2):
        rng = np.random.default_rng(seed)
        map_ = random_voxel_map(rng, (128, 128, 40), 25, (5, 14)[seed])
        rating = FieldRatingFunction(DepthCamera(), map_.grid)
        frustum = rating.fine.frustum
        R, t = random_poses(rng, map_, 60)
        found = rating.count_unknown_cells(map_, (R, t))
        unknown = map_.sampled_mask == 0
        blocked, positions = blocked_cells(map_), in_cells(map_, t)
        dense = [
            unknown[dense_views.voxels_hit_by_rays(blocked, positions[k], R[k], frustum)].sum()
            for k in range(60)
        ]
        assert np.corrcoef(found, dense)[0, 1] > 0.99
        assert np.argmax(found) == np.argmax(dense)


def wall(map_, at, p=0.99):
    """Voxels with x = at, known to be occupied."""
    cells = np.arange(map_.grid.n_cells).reshape(map_.grid.shape)[at]
    set_cells(map_, cells.ravel(), p)


def view_of(map_, translation=(1.53, 1.52, 1.51), camera=SMALL, **kwargs):
    rating = FieldRatingFunction(camera, map_.grid)
    cells = rating.visible_cells(map_, (ALONG_X, translation), ViewContext(**kwargs))
    return np.stack(np.unravel_index(cells, map_.grid.shape), axis=-1)


def empty_map():
    return OccupancyMap(VoxelGrid((31, 31, 31), 0.1))


def test_a_wall_is_seen_and_hides_what_is_behind():
    map_ = empty_map()
    whole = view_of(map_)
    wall(map_, 22)
    seen = view_of(map_)
    assert seen[:, 0].max() == 22
    # in front of the wall, nothing is missing
    assert (seen == whole[whole[:, 0] <= 22]).all()


def test_unknown_voxels_and_those_below_one_half_let_the_view_pass():
    map_ = empty_map()
    whole = view_of(map_)
    wall(map_, 22, 0.49)
    assert (view_of(map_) == whole).all()
    wall(map_, 22, 0.5)
    assert view_of(map_)[:, 0].max() == 22


def test_a_wall_in_the_blind_zone_hides_everything():
    map_ = empty_map()
    wall(map_, 17)
    assert len(view_of(map_)) == 0


def test_the_voxel_that_holds_the_camera_hides_nothing():
    map_ = empty_map()
    whole = view_of(map_)
    set_cells(map_, int(map_.grid.flat_index([15, 15, 15])), 0.99)
    assert (view_of(map_) == whole).all()


def test_a_teammate_hides_its_shadow_and_nothing_else():
    map_ = empty_map()
    whole = view_of(map_)
    # a ball of 0.3 m, 0.7 m ahead on the axis: its shadow is a cone of asin(3 / 7)
    occluder_spheres = [[2.23, 1.52, 1.51]], [0.3]
    seen = {tuple(c) for c in view_of(map_, occluder_spheres=occluder_spheres).tolist()}
    camera = np.array([15.3, 15.2, 15.1])
    relative = whole + 0.5 - camera
    angle = np.arctan2(np.hypot(relative[:, 1], relative[:, 2]), relative[:, 0])
    depth = np.linalg.norm(relative, axis=1)
    # a pixel more or less at the rim, and a voxel at the surface
    shadow = (angle < math.asin(3 / 7) - 0.05) & (depth > 8)
    light = (angle > math.asin(3 / 7) + 0.05) | (depth < 4)
    assert shadow.sum() > 100
    assert not seen & {tuple(c) for c in whole[shadow].tolist()}
    assert {tuple(c) for c in whole[light].tolist()} <= seen


@pytest.mark.parametrize(
    ("center", "radius"),
    [([0.9, 1.52, 1.51], 0.3), ([1.53, 1.52, 1.51], 0.5), ([3.6, 1.5, 1.5], 0.2)],
)
def test_bodies_behind_around_or_beyond_the_view_hide_nothing(center, radius):
    map_ = empty_map()
    assert len(view_of(map_, occluder_spheres=([center], [radius]))) == len(view_of(map_))


def test_a_camera_outside_the_grid_sees_nothing():
    map_ = empty_map()
    for translation in ([-0.01, 1.5, 1.5], [1.5, 1.5, 3.1]):
        assert len(view_of(map_, translation)) == 0


def plain_distances(map_, position, R, frustum):
    """Distance to the first occluder along the ray of each pixel, on its way from cell to cell."""
    blocked, distances = blocked_cells(map_), []
    for pixel in np.ndindex(*frustum.pixels):
        path = traverse(
            position, dense_views.ray(*pixel, R, frustum)[0], frustum.far, blocked.shape
        )
        stops = np.flatnonzero(blocked[tuple(path.cells[1:].T)])
        distances.append(path.entries[1:][stops[0]] if len(stops) else math.inf)
    return distances


@pytest.mark.parametrize("camera", [SMALL, WIDE])
def test_each_pixel_sees_as_far_as_the_first_occluder_that_its_ray_enters(camera):
    """Random voxels; the last cameras look along an axis, from a face of their voxel."""
    rng = np.random.default_rng(4)
    n_met = 0
    for k in range(15):
        map_ = OccupancyMap(VoxelGrid((13, 11, 9), 0.1))
        n = (3, 40, 300)[k % 3]
        set_cells(map_, rng.choice(map_.grid.n_cells, n, replace=False), 0.9)
        tables = FieldRatingFunction(camera, map_.grid).fine
        position, R = rng.uniform(1, 8, 3), rotation(*rng.uniform(-np.pi, np.pi, 3))
        if k >= 9:
            position[k % 3], R = round(position[k % 3]), rotation(k * np.pi / 2, 0, 0).round()
        pose, view = RigidTransform(R, position), allocate_view(tables.camera)
        trace_view(map_.viewed(), pose, tables.to_cell_spheres(None), tables.camera, view)
        expected = plain_distances(map_, position, R, tables.frustum)
        np.testing.assert_allclose(view.depth.distances, expected, rtol=0, atol=1e-12)
        n_met += np.isfinite(expected).sum()
    assert n_met > 1000


@pytest.mark.parametrize("occluders", ["none", "a few", "many"])
def test_many_poses_see_what_each_sees_alone(occluders):
    """One after the other, in the same buffers."""
    rng = np.random.default_rng(0)
    map_ = random_voxel_map(rng, (22, 18, 15), 8, 4)
    if occluders != "many":
        map_.log_odds_fixed[map_.sampled_mask == 1] = -map_.log_odds_range.clamp
    if occluders == "a few":
        cells = np.arange(map_.grid.n_cells).reshape(map_.grid.shape)
        set_cells(map_, cells[9:12, 7:11, 6:8].ravel(), 0.9)
    rating = FieldRatingFunction(WIDE, map_.grid)
    R, t = random_poses(rng, map_, 40, any_orientation=True)
    R[:4] = [rotation(yaw, 0, 0).round() for yaw in (0, np.pi / 2, np.pi, -np.pi / 2)]
    ni, unknown = rating.new_information_and_unknown(map_, (R, t))
    alone = [
        rating.new_information_and_unknown(map_, (R[k : k + 1], t[k : k + 1])) for k in range(40)
    ]
    assert ni.tolist() == [float(one[0]) for one, _ in alone]
    assert unknown.tolist() == [int(one[0]) for _, one in alone]
    assert len(set(unknown.tolist())) > 10


def test_a_view_looks_the_same_wherever_the_world_lies_and_however_large_its_voxels_are():
    rng = np.random.default_rng(1)
    unit = random_voxel_map(rng, (22, 18, 15), 8, 4, resolution=1.0)
    R, t = random_poses(rng, unit, 10)
    small = OccupancyMap(VoxelGrid((22, 18, 15), 0.05, (-7.3, 11.9, 0.4)))
    small.log_odds_fixed[:], small.sampled_mask[:] = unit.log_odds_fixed, unit.sampled_mask
    one = FieldRatingFunction(DepthCamera(near=3.0, far=15.0), unit.grid)
    two = FieldRatingFunction(DepthCamera(near=0.15, far=0.75), small.grid)
    for k in range(10):
        other = two.visible_cells(small, (R[k], t[k] * 0.05 + small.grid.origin))
        assert (one.visible_cells(unit, (R[k], t[k])) == other).all()
