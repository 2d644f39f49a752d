import math
from dataclasses import replace

import numpy as np
import pytest
from plain import regions as plain

from coopmap_env.localization.correction.tracking import TrackingSettings, track_fiducials
from coopmap_env.sensing import DepthCamera, PointCloud, RangeNoise

CAMERA = DepthCamera(width=40, height=30, far=10.0)
NOISE = RangeNoise()
WALL = 4.0
BOX = (3.0, (-0.4, 0.2), (-0.3, 0.5))
"""Depth of a face, and from where to where it goes along y and z."""


def image(boxes=(BOX,), wall=WALL, camera=CAMERA):
    """A cloud of a wall across the optical axis and faces before it; which face a pixel sees."""
    tangents = camera.directions[:, 1:] / camera.directions[:, :1]
    depths, seen = np.full(camera.n_pixels, wall), np.full(camera.n_pixels, -1)
    for n, (depth, y, z) in enumerate(boxes):
        at = depth * tangents
        inside = (at[:, 0] >= y[0]) & (at[:, 0] <= y[1]) & (at[:, 1] >= z[0]) & (at[:, 1] <= z[1])
        inside &= depth < depths
        depths[inside], seen[inside] = depth, n
    points = np.column_stack([depths, depths[:, None] * tangents])
    return PointCloud(points, np.ones(camera.n_pixels, dtype=bool)), seen


def find(cloud, predictions, radii, sigma=0.02, settings=None, camera=CAMERA):
    predictions = np.atleast_2d(predictions)
    radii = np.broadcast_to(radii, len(predictions))
    return track_fiducials(
        cloud, camera, NOISE, predictions, radii, np.full(len(radii), sigma), settings
    )


def test_a_region_is_the_part_of_a_face_that_is_in_the_ball():
    cloud, seen = image()
    tracks = find(cloud, (3.0, 0.0, 0.1), 0.3)
    seed = np.linalg.norm(cloud.points - (3.0, 0.0, 0.1), axis=1).argmin()
    ball = np.linalg.norm(cloud.points - cloud.points[seed], axis=1) <= 0.3
    np.testing.assert_array_equal(tracks.labels == 0, (seen == 0) & ball)
    assert (tracks.labels[~ball] == -1).all()
    assert tracks.found.tolist() == [True]
    assert tracks.counts.tolist() == [((seen == 0) & ball).sum()]


def test_a_whole_face_has_its_middle_as_image_point_and_its_depth_as_scale():
    tracks = find(image([(3.0, (-0.3, 0.3), (-0.4, 0.4))])[0], (3.02, 0.05, -0.03), 0.7)
    np.testing.assert_allclose(tracks.image_points, [[0.0, 0.0]], atol=1e-12)
    np.testing.assert_allclose(tracks.depths, [3.0])
    np.testing.assert_allclose(tracks.points, [[3.0, 0.0, 0.0]], atol=1e-12)


def test_scale_times_image_point_is_the_mean_point_of_the_region():
    cloud, _ = image()
    tracks = find(cloud, [(3.0, 0.1, 0.3), (4.0, 1.0, 0.5)], 0.25)
    assert tracks.found.all()
    rays = np.column_stack([np.ones(2), tracks.image_points])
    np.testing.assert_allclose(tracks.depths[:, None] * rays, tracks.points)
    for i in range(2):
        inside = cloud.points[tracks.labels == i]
        np.testing.assert_allclose(tracks.points[i], inside.mean(axis=0))
        np.testing.assert_allclose(tracks.scatters[i], np.cov(inside.T, bias=True), atol=1e-12)


def test_a_face_across_the_optical_axis_spreads_along_itself_only():
    spread = find(image(boxes=())[0], (WALL, 0.0, 0.0), 1.0).scatters[0]
    assert spread[0, 0] < 1e-12
    # a disc of radius r has r^2 / 4 along both of its axes
    np.testing.assert_allclose(np.diag(spread)[1:], 1.0**2 / 4, rtol=0.1)


@pytest.mark.parametrize(("gap", "steps_over"), [(0.18, True), (0.25, False)])
def test_a_step_in_depth_stops_the_growth(gap, steps_over):
    # at 3 m a pixel is 3 tan(30 deg) / 20 = 0.087 m wide, which allows 0.087 tan(45 deg), and
    # 3 sqrt(2) 0.0135 m of noise allow 0.057 m: 0.144 m, and some more away from the axis
    settings = TrackingSettings(max_incidence_angle=math.radians(60.0))
    cloud, seen = image(wall=3.0 + gap)
    tracks = find(cloud, (3.0, 0.0, 0.1), 0.7, settings=settings)
    assert (seen[tracks.labels == 0] == -1).any() == steps_over


def test_pixels_without_return_are_not_grown_over():
    cloud, seen = image()
    columns = np.arange(CAMERA.n_pixels) % CAMERA.width
    cloud = PointCloud(cloud.points, columns != 20)
    tracks = find(cloud, (3.0, 0.15, 0.1), 0.7)
    np.testing.assert_array_equal(tracks.labels == 0, (seen == 0) & (columns < 20))


def test_nothing_is_found_where_nothing_was_measured():
    cloud, _ = image()
    tracks = find(PointCloud(cloud.points, np.zeros_like(cloud.hit)), (3.0, 0.0, 0.1), 0.3)
    assert tracks.found.tolist() == [False]
    assert (tracks.labels == -1).all()
    for name in ("counts", "depths", "points", "image_points", "scatters"):
        assert not getattr(tracks, name).any()


def test_a_fiducial_out_of_view_or_behind_the_camera_is_not_found():
    tracks = find(image()[0], [(4.0, 2.4, 0.0), (4.0, 0.0, 1.7), (-3.0, 0.0, 0.1)], 1.0)
    assert not tracks.found.any()


def test_a_seed_lies_within_the_radius_and_the_gate_of_the_prediction():
    cloud, _ = image(boxes=())
    # the wall is 0.5 m behind the prediction
    assert not find(cloud, (3.5, 0.0, 0.0), 0.3, sigma=0.05).found[0]
    assert find(cloud, (3.5, 0.0, 0.0), 0.3, sigma=0.07).found[0]
    assert not find(cloud, (3.5, 0.0, 0.0), 0.3, 0.07, TrackingSettings(gate_sigmas=2.0)).found[0]


def test_a_region_of_too_few_pixels_is_not_found():
    cloud, _ = image()
    count = find(cloud, (3.0, 0.0, 0.1), 0.2).counts[0]
    enough, short = (TrackingSettings(min_pixels=int(count) + n) for n in (0, 1))
    assert find(cloud, (3.0, 0.0, 0.1), 0.2, settings=enough).found[0]
    tracks = find(cloud, (3.0, 0.0, 0.1), 0.2, settings=short)
    assert not tracks.found[0]
    assert (tracks.labels == -1).all()


def test_of_balls_that_overlap_a_pixel_belongs_to_the_nearer_seed():
    cloud, _ = image(boxes=())
    pixels = [15 * 40 + 15, 15 * 40 + 18]
    tracks = find(cloud, cloud.points[pixels], 0.6)
    columns = np.arange(CAMERA.n_pixels) % CAMERA.width
    assert tracks.found.all()
    assert columns[tracks.labels == 0].max() == 16
    assert columns[tracks.labels == 1].min() == 17


def test_the_order_of_the_fiducials_does_not_matter():
    cloud, predictions, radii, sigmas = drawn(np.random.default_rng(1))
    tracks = track_fiducials(cloud, SMALL, NOISE, predictions, radii, sigmas)
    order = np.array([3, 0, 4, 1, 2])
    other = track_fiducials(cloud, SMALL, NOISE, predictions[order], radii[order], sigmas[order])
    assert tracks.found.any()
    names = np.append(order, -1)
    np.testing.assert_array_equal(names[other.labels], tracks.labels)
    np.testing.assert_array_equal(other.points, tracks.points[order])


SMALL = DepthCamera(width=24, height=18, far=10.0)


def drawn(rng, k=5):
    """A random image of boxes, noise and holes, and fiducials near to its points."""
    corners = rng.uniform(-1.5, 1.0, (6, 2))
    boxes = [
        (rng.uniform(2.0, 3.8), (y, y + rng.uniform(0.2, 1.5)), (z, z + rng.uniform(0.2, 1.5)))
        for y, z in corners
    ]
    cloud, _ = image(boxes, camera=SMALL)
    points = cloud.points * (1 + rng.normal(0, 0.02, SMALL.n_pixels))[:, None]
    hit = rng.random(SMALL.n_pixels) < rng.choice([0.7, 0.95])
    predictions = points[rng.integers(0, SMALL.n_pixels, k)] + rng.normal(0, 0.1, (k, 3))
    return PointCloud(points, hit), predictions, rng.uniform(0.1, 0.8, k), rng.uniform(0, 0.1, k)


def test_regions_equal_those_of_breadth_first_growth():
    rng = np.random.default_rng(0)
    found = 0
    for _ in range(60):
        scene = drawn(rng)
        settings = TrackingSettings(
            min_pixels=int(rng.integers(1, 6)),
            max_incidence_angle=math.radians(rng.choice([0.0, 45.0, 70.0])),
        )
        cloud, predictions, radii, sigmas = scene
        tracks = track_fiducials(cloud, SMALL, NOISE, predictions, radii, sigmas, settings)
        expected = plain.grow_regions(cloud, SMALL, NOISE, predictions, radii, sigmas, settings)
        np.testing.assert_array_equal(tracks.labels, expected)
        np.testing.assert_array_equal(tracks.found, np.isin(np.arange(5), expected))
        found += tracks.found.sum()
    assert found > 100


def test_no_fiducials_give_no_tracks():
    tracks = track_fiducials(image()[0], CAMERA, NOISE, np.empty((0, 3)), np.empty(0), np.empty(0))
    assert tracks.labels.shape == (CAMERA.n_pixels,)
    assert tracks.points.shape == (0, 3)


def test_what_does_not_fit_is_rejected_with_its_value():
    cloud, _ = image()
    point, one = np.array([[3.0, 0.0, 0.0]]), np.ones(1)
    with pytest.raises(ValueError, match="1200"):
        track_fiducials(cloud, replace(CAMERA, width=41), NOISE, point, one, one)
    with pytest.raises(ValueError, match=r"\(2,\)"):
        track_fiducials(cloud, CAMERA, NOISE, point, np.ones(2), one)
    with pytest.raises(ValueError, match="nan"):
        track_fiducials(cloud, CAMERA, NOISE, point * math.nan, one, one)
    with pytest.raises(ValueError, match=r"radii.*-1"):
        track_fiducials(cloud, CAMERA, NOISE, point, -one, one)
    with pytest.raises(ValueError, match=r"deviations.*inf"):
        track_fiducials(cloud, CAMERA, NOISE, point, one, one * math.inf)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("min_pixels", 0),
        ("gate_sigmas", -1.0),
        ("step_sigmas", math.nan),
        ("max_incidence_angle", 1.6),
    ],
)
def test_settings_name_the_value_that_is_out_of_range(name, value):
    with pytest.raises(ValueError, match=rf"{name}.*{value}"):
        TrackingSettings(**{name: value})
