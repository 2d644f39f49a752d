"""The pixels of a depth camera."""

import math
import pickle
from dataclasses import replace

import numpy as np
import pytest

from coopmap_env.sensing import DepthCamera


def on_image_plane(camera):
    """Where the beams cross the plane 1 m ahead: (height, width) each of left and up, metres."""
    plane = camera.directions[:, 1:] / camera.directions[:, :1]
    return np.moveaxis(plane.reshape(camera.height, camera.width, 2), -1, 0)


def test_one_pixel_is_on_the_optical_axis():
    assert DepthCamera(width=1, height=1).directions == pytest.approx(np.array([[1.0, 0.0, 0.0]]))


def test_four_pixels_of_a_right_angled_camera_by_hand():
    camera = DepthCamera(math.pi / 2, math.pi / 2, width=2, height=2)
    # pixel centers lie half way between the axis and the edges of the image, at 1 m
    expected = np.array([[1, 0.5, 0.5], [1, -0.5, 0.5], [1, 0.5, -0.5], [1, -0.5, -0.5]])
    assert camera.directions == pytest.approx(expected / math.sqrt(1.5))


def test_the_first_pixel_is_the_top_left_one_and_rows_come_one_after_the_other():
    left, up = on_image_plane(DepthCamera())
    assert left[0, 0] > 0 > left[0, -1]
    assert up[0, 0] > 0 > up[-1, 0]
    assert np.ptp(left, axis=0) == pytest.approx(np.zeros(64), abs=1e-15)
    assert np.ptp(up, axis=1) == pytest.approx(np.zeros(48), abs=1e-15)


@pytest.mark.parametrize("size", [(1, 7), (2, 2), (64, 48), (5, 1)])
def test_pixels_are_even_on_the_image_plane_symmetric_and_fill_the_field_of_view(size):
    camera = DepthCamera(1.2, 0.7, *size)
    left, up = on_image_plane(camera)
    edges = math.tan(0.6), math.tan(0.35)
    for coordinate, n, edge in ((left[0], size[0], edges[0]), (up[:, 0], size[1], edges[1])):
        assert coordinate == pytest.approx(-coordinate[::-1], abs=1e-15)
        assert np.diff(coordinate) == pytest.approx(np.full(n - 1, -2 * edge / n))
        assert coordinate[0] == pytest.approx(edge - edge / n)


def test_directions_are_cached_read_only_unit_vectors():
    camera = DepthCamera()
    assert camera.directions.shape == (camera.n_pixels, 3) == (3072, 3)
    assert np.linalg.norm(camera.directions, axis=1) == pytest.approx(np.ones(3072))
    assert camera.directions is camera.directions
    with pytest.raises(ValueError, match="read-only"):
        camera.directions[0] = 0


def test_cameras_compare_by_their_settings_and_survive_pickling():
    camera = DepthCamera()
    assert len(camera.directions)
    assert camera == DepthCamera() == pickle.loads(pickle.dumps(camera))
    assert hash(camera) == hash(DepthCamera())
    assert replace(camera, width=32).n_pixels == 32 * 48


def test_a_depth_image_of_a_wall_across_the_axis_has_one_depth():
    camera = DepthCamera()
    distances = 3.0 / camera.directions[:, 0]
    assert camera.depth_image(distances) == pytest.approx(np.full((48, 64), 3.0))
    assert np.isinf(camera.depth_image(np.full(3072, np.inf))).all()


def test_a_depth_image_of_another_size_is_rejected():
    with pytest.raises(
        ValueError, match=r"48 x 64 pixels needs distances \(3072,\), got \(48, 64\)"
    ):
        DepthCamera().depth_image(np.ones((48, 64)))


def test_the_depth_of_field_is_the_far_end():
    assert DepthCamera(far=4.5).depth_of_field == 4.5


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("horizontal_field_of_view", 0.0),
        ("horizontal_field_of_view", math.pi),
        ("vertical_field_of_view", -0.1),
        ("vertical_field_of_view", math.nan),
        ("width", 0),
        ("width", 6.5),
        ("height", -3),
    ],
)
def test_a_camera_without_an_image_is_rejected(name, value):
    with pytest.raises(ValueError, match=rf"DepthCamera\.{name} .*{value}"):
        DepthCamera(**{name: value})


@pytest.mark.parametrize(
    ("near", "far"),
    [(6.0, 6.0), (7.0, 6.0), (-0.1, 6.0), (0.3, math.inf), (0.3, math.nan), (math.nan, 6.0)],
)
def test_a_camera_without_a_range_is_rejected(near, far):
    with pytest.raises(ValueError, match=rf"DepthCamera\.(near|far) .*({near}|{far})"):
        DepthCamera(near=near, far=far)
