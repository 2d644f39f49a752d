import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from coopmap_env.geometry import traverse
from coopmap_env.information.field.frustum import Frustum
from coopmap_env.information.field.point_visibility import first_visible_point
from coopmap_env.mapping import OccupancyMap, VoxelGrid
from coopmap_env.sensing import DepthCamera

GRID = VoxelGrid((30, 28, 12), 0.1, (-1.5, -1.4, 0.0))
CAMERA = DepthCamera(near=0.2, far=2.0)
FRUSTUM = Frustum.from_camera(CAMERA, GRID.resolution)


def drawn_map(rng, density):
    map_ = OccupancyMap(GRID)
    map_.log_odds_fixed[:] = rng.choice(
        [-3000, 0, 2500], GRID.n_cells, p=[1 - density, density / 2, density / 2]
    )
    map_.sampled_mask[:] = rng.random(GRID.n_cells) < 0.7
    return map_


def plain_sees(map_, point, R, t):
    """The definition: a ray, cell by cell."""
    d = point - t
    x, y, z = R.T @ d
    h, v = CAMERA.horizontal_field_of_view / 2, CAMERA.vertical_field_of_view / 2
    if x <= 0 or abs(y) > np.tan(h) * x or abs(z) > np.tan(v) * x:
        return False
    if not CAMERA.near <= np.linalg.norm(d) <= CAMERA.far:
        return False
    start, end = GRID.to_cell_units(t), GRID.to_cell_units(point)
    cells = traverse(start, end - start, float(np.linalg.norm(end - start)), GRID.shape).cells
    blocked = map_.sampled & (map_.log_odds_fixed.reshape(GRID.shape) >= 0)
    between = [tuple(c) for c in cells[1:] if tuple(c) != tuple(np.floor(end).astype(int))]
    return not any(blocked[c] for c in between)


@pytest.mark.parametrize("density", [0.0, 0.05, 0.3])
def test_the_first_point_that_any_pose_sees_equals_asking_one_by_one(density):
    rng = np.random.default_rng(int(100 * density))
    map_ = drawn_map(rng, density)
    for _ in range(20):
        k, n = 6, 15
        low = np.array(GRID.origin)
        size = np.array(GRID.shape) * GRID.resolution
        points, t = low + size * rng.random((n, 3)), low + size * rng.random((k, 3))
        R = Rotation.random(k, rng=rng).as_matrix()
        expected = [[plain_sees(map_, p, R[i], t[i]) for i in range(k)] for p in points]
        first, sees_point = first_visible_point(map_, points, (R, t), FRUSTUM)
        any_sees = np.any(expected, axis=1)
        if not any_sees.any():
            assert first == n
            assert not sees_point.any()
        else:
            assert first == np.argmax(any_sees)
            np.testing.assert_array_equal(sees_point, expected[first])


def test_a_camera_outside_the_grid_sees_nothing():
    map_ = OccupancyMap(GRID)
    first, sees_point = first_visible_point(
        map_, np.array([[0.0, 0.0, 0.5]]), (np.eye(3)[None], np.array([[-1.6, 0.0, 0.5]])), FRUSTUM
    )
    assert first == 1
    assert not sees_point.any()
