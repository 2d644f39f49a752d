import numpy as np
import pytest
from plain.triangle_camera import box, look_at_pose, ray_distances

from coopmap_env.localization._depth_rendering import DepthImage, min_neighbour_range, render_depth
from coopmap_env.sensing import DepthCamera


def rendered(triangles, pose, camera):
    image = DepthImage.empty(camera.n_pixels)
    render_depth(triangles, pose.inverse().arrays, camera.intrinsics, image)
    return image


@pytest.mark.parametrize("seed", range(4))
def test_depths_equal_those_of_rays_against_each_triangle(seed):
    rng = np.random.default_rng(seed)
    triangles = np.concatenate(
        [box(rng.uniform(0.1, 1.0, 3), rng.uniform(-1, 1, 3), rng.uniform(0, 6)) for _ in range(5)]
    )
    camera = DepthCamera(width=32, height=24)
    pose = look_at_pose(4.0 * about_the_middle(rng), rng.uniform(-0.5, 0.5, 3))
    depth, triangle_index = rendered(triangles, pose, camera)
    plain = ray_distances(pose.translation, camera.directions @ pose.rotation.T, triangles)
    plain *= camera.directions[:, 0]
    np.testing.assert_array_equal(np.isfinite(plain), triangle_index >= 0)
    np.testing.assert_allclose(depth[triangle_index >= 0], plain[triangle_index >= 0], rtol=1e-9)


def about_the_middle(rng):
    direction = rng.standard_normal(3) * [1, 1, 0.3]
    return direction / np.linalg.norm(direction)


def test_what_lies_behind_the_camera_is_not_seen():
    camera = DepthCamera(width=8, height=6)
    _, triangle_index = rendered(
        box((1, 1, 1), (-3, 0, 0)), look_at_pose((0, 0, 0), (1, 0, 0)), camera
    )
    assert (triangle_index == -1).all()


def test_the_least_range_around_a_pixel_is_0_at_the_border():
    ranges = np.arange(20.0) + 1.0
    out = np.empty(20)
    min_neighbour_range(ranges, 5, 4, out)
    np.testing.assert_array_equal(
        out.reshape(4, 5), [[0, 0, 0, 0, 0], [0, 1, 2, 3, 0], [0, 6, 7, 8, 0], [0, 0, 0, 0, 0]]
    )
