"""The visible surface, compared with a ray to every point from every camera."""

import math

import numpy as np
import pytest
from plain import triangles as rays
from plain import true_surfaces as plain

from coopmap_env.evaluation.metrics import _visible_surface as visible_surface
from coopmap_env.geometry import Pose
from coopmap_env.mapping import OccupancyMap
from coopmap_env.robots import Vehicle
from coopmap_env.sensing import DepthCamera
from coopmap_env.simulation.depth import TracedMesh
from coopmap_env.simulation.scenes.field import FIELD_GRID

pytest.importorskip("embreex")
CAMERA = DepthCamera(width=4, height=3, near=0.5, far=3.0)
WALL = np.array([[[2.0, -3, -3], [2, 3, -3], [2, 0, 5]]])


def seen_from(poses, points, triangles, camera=CAMERA):
    seen = np.zeros(len(points), dtype=bool)
    visible_surface.mark_visible_points(
        np.array([pose.rotation for pose in poses]),
        np.array([pose.translation for pose in poses]),
        camera, TracedMesh(triangles), np.array(points, dtype=float), seen,
    )  # fmt: skip
    return seen


@pytest.mark.parametrize(
    ("point", "seen"),
    [
        ((2.0, 0, 0), True),  # on the wall, not hidden by it
        ((2.1, 0, 0), False),  # behind it
        ((0.4, 0, 0), False),  # nearer than near
        ((0.6, 0, 0), True),
        ((-1.0, 0, 0), False),  # behind the camera
        ((1.5, 0.86, 0), True),  # 29.8 degrees to the left
        ((1.5, 0.88, 0), False),  # 30.4 degrees
        ((1.5, 0, 0.61), True),  # 22.1 degrees up
        ((1.5, 0, -0.63), False),  # 22.8 degrees down
    ],
)
def test_a_point_is_seen_in_the_image_in_range_and_before_the_wall(point, seen):
    assert seen_from([Pose(np.zeros(3), np.eye(3))], [point], WALL)[0] == seen


def test_far_bounds_the_distance_not_the_depth():
    empty = WALL + 50
    ahead, aside = (2.95, 0, 0), (2.95, 1.0, 0)
    found = seen_from([Pose(np.zeros(3), np.eye(3))], [ahead, aside], empty)
    np.testing.assert_array_equal(found, [True, False])


def random_rotation(rng):
    Q, R = np.linalg.qr(rng.normal(size=(3, 3)))
    Q = Q * np.sign(np.diag(R))
    return Q if np.linalg.det(Q) > 0 else -Q


def test_visible_points_agree_with_rays_to_every_point():
    rng = np.random.default_rng(0)
    boxes = [rays.box(rng.uniform(-1, 1, 3), rng.uniform(0.1, 0.4, 3)) for _ in range(6)]
    triangles = np.concatenate(boxes)
    a, b, c = np.moveaxis(triangles[rng.integers(len(triangles), size=300)], 1, 0)
    u, v = rng.random((2, 300, 1))
    points = c + np.sqrt(u) * (a + v * (b - a) - c)
    poses = [Pose(rng.uniform(-2, 2, 3), random_rotation(rng)) for _ in range(12)]
    camera = DepthCamera(math.radians(70), math.radians(50), near=0.3, far=2.5)
    found = seen_from(poses, points, triangles, camera)
    expected = [any(plain.is_visible(T, camera, triangles, p) for T in poses) for p in points]
    assert 0.1 < np.mean(expected) < 0.9
    np.testing.assert_array_equal(found, expected)


def test_points_stay_seen_and_order_of_poses_does_not_matter():
    rng = np.random.default_rng(1)
    poses = [Pose(rng.uniform(-1, 1, 3), random_rotation(rng)) for _ in range(8)]
    points = rng.uniform(-2, 2, (200, 3))
    forth, back = seen_from(poses, points, WALL), seen_from(poses[::-1], points, WALL)
    np.testing.assert_array_equal(forth, back)
    assert (forth >= seen_from(poses[:3], points, WALL)).all()


@pytest.fixture(scope="module")
def vehicle():
    pytest.importorskip("trimesh")
    return Vehicle.from_mount("mast", Pose(np.zeros(3), np.eye(3)))


@pytest.fixture(scope="module")
def free_map(vehicle):
    map_ = OccupancyMap(FIELD_GRID)
    map_.mark_free(np.arange(FIELD_GRID.n_cells))
    return map_


def test_poses_are_within_limits_and_as_many_as_asked_for(vehicle, free_map):
    poses = visible_surface.sample_collision_free_poses(
        vehicle, free_map, np.random.default_rng(0), 50
    )
    assert poses.shape == (50, 5)
    assert (poses >= vehicle.chain.lower).all()
    assert (poses <= vehicle.chain.upper).all()
    again = visible_surface.sample_collision_free_poses(
        vehicle, free_map, np.random.default_rng(0), 50
    )
    np.testing.assert_array_equal(poses, again)
    with pytest.raises(ValueError, match="n_poses must be at least 1, got 0"):
        visible_surface.sample_collision_free_poses(vehicle, free_map, np.random.default_rng(0), 0)


def test_no_pose_reaches_into_an_obstacle(vehicle, free_map):
    known, grid = free_map.copy(), free_map.grid
    index = np.stack(np.unravel_index(np.arange(grid.n_cells), grid.shape), axis=-1)
    left = grid.center(index)[:, 1] > 0.3
    known.mark_occupied(np.flatnonzero(left))
    poses = visible_surface.sample_collision_free_poses(
        vehicle, known, np.random.default_rng(0), 50
    )
    moving = vehicle.body.sphere_body_index > 0
    centers, radii = vehicle.spheres(poses)
    assert len(poses) == 50
    assert (centers[:, moving, 1] + radii[moving] < 0.3 + grid.resolution).all()


def test_a_buried_mount_has_no_pose(vehicle, free_map):
    known = OccupancyMap(free_map.grid)
    assert visible_surface.sample_collision_free_poses(
        vehicle, known, np.random.default_rng(0), 5
    ).shape == (0, 5)
