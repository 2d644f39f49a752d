import numpy as np
import pytest
from plain.looking import aimed, box, distances

from coopmap_env.localization.depth_rendering import expect, nearest_around, pinhole
from coopmap_env.sensing import DepthCamera


def expected(triangles, pose, camera):
    depth, seen = np.empty(camera.n_pixels), np.empty(camera.n_pixels, dtype=np.int64)
    inverse = pose.inverse()
    expect(triangles, inverse.rotation.copy(), inverse.translation, pinhole(camera), depth, seen)
    return depth, seen


@pytest.mark.parametrize("seed", range(4))
def test_depths_equal_those_of_rays_against_each_triangle(seed):
    rng = np.random.default_rng(seed)
    triangles = np.concatenate(
        [box(rng.uniform(0.1, 1.0, 3), rng.uniform(-1, 1, 3), rng.uniform(0, 6)) for _ in range(5)]
    )
    camera = DepthCamera(width=32, height=24)
    pose = aimed(4.0 * about_the_middle(rng), rng.uniform(-0.5, 0.5, 3))
    depth, seen = expected(triangles, pose, camera)
    plain = distances(pose.translation, camera.directions @ pose.rotation.T, triangles)
    plain *= camera.directions[:, 0]
    np.testing.assert_array_equal(np.isfinite(plain), seen >= 0)
    np.testing.assert_allclose(depth[seen >= 0], plain[seen >= 0], rtol=1e-9)


def about_the_middle(rng):
    direction = rng.standard_normal(3) * [1, 1, 0.3]
    return direction / np.linalg.norm(direction)


def test_what_lies_behind_the_camera_is_not_seen():
    camera = DepthCamera(width=8, height=6)
    _, seen = expected(box((1, 1, 1), (-3, 0, 0)), aimed((0, 0, 0), (1, 0, 0)), camera)
    assert (seen == -1).all()


def test_the_least_range_around_a_pixel_is_0_at_the_border():
    ranges = np.arange(20.0) + 1.0
    out = np.empty(20)
    nearest_around(ranges, 5, 4, out)
    np.testing.assert_array_equal(
        out.reshape(4, 5), [[0, 0, 0, 0, 0], [0, 1, 2, 3, 0], [0, 6, 7, 8, 0], [0, 0, 0, 0, 0]]
    )
