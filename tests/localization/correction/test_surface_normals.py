"""Planes around pixels: exact without noise, and without a lean under that of Eq. 1."""

import numpy as np
import pytest
from plain.triangle_camera import box, look_at_pose, render_scan
from scipy.stats import chi2

from coopmap_env.localization.correction._surface_normals import surface_normals
from coopmap_env.sensing import DepthCamera, PointCloud, RangeNoise

CAMERA, NOISE, EXACT = DepthCamera(), RangeNoise(), RangeNoise(intrinsic=0.0)
U = CAMERA.directions[:, 1] / CAMERA.directions[:, 0]
V = CAMERA.directions[:, 2] / CAMERA.directions[:, 0]
SPREAD = 1.0 + U**2 + V**2
"""Squared range over squared depth, of each pixel."""
LARGE, SMALL = 50.0, 6.0
"""Sums of squared columns over 5 x 5 and 3 x 3 pixels: 5 (4 + 1 + 0 + 1 + 4) and 3 (1 + 0 + 1)."""
WIDTH = 2.0 * np.tan(np.radians(30.0)) / 64.0
"""Of a pixel, at 1 m."""


def cloud_of(depths, hit=None):
    """Points of depths (n,) along the optical axis."""
    points = np.column_stack([depths, depths * U, depths * V])
    return PointCloud(points, np.isfinite(depths) if hit is None else hit)


def plane(normal, distance):
    """Depths of a plane at so many metres from the camera; its unit normal towards the camera."""
    n = np.array(normal, dtype=float) / np.linalg.norm(normal)
    toward = n[0] + U * n[1] + V * n[2]
    return np.where(toward < -0.05, -distance / np.minimum(toward, -0.05), np.inf), n


def noisy(depths, rng):
    """With the error of Eq. 1 along the optical axis, at the true range."""
    hit = np.isfinite(depths)
    depths = np.where(hit, depths, 6.0)
    sigma = NOISE.intrinsic * depths**2 * SPREAD
    return cloud_of(depths + sigma * rng.standard_normal(len(depths)), hit)


def image(values):
    return values.reshape(CAMERA.height, CAMERA.width)


def windows(values, inside=0.5):
    """Of every fifth pixel in rows and columns, whose windows share none, near enough the axis."""
    near = (np.abs(U) < inside) & (np.abs(V) < inside)
    column, row = np.arange(CAMERA.n_pixels) % CAMERA.width, np.arange(CAMERA.n_pixels) // 64
    return values[near & (column % 5 == 2) & (row % 5 == 2) & (column < 60) & (row < 45)]


PLANES = [((-1, 0, 0), 2.0), ((-0.5, 0.85, 0), 1.5), ((-0.5, -0.3, 0.8), 1.5), ((-0.3, 0.2, 1), 1)]


@pytest.mark.parametrize(("normal", "distance"), PLANES)
def test_without_noise_the_normal_of_a_plane_is_exact(normal, distance):
    depths, n = plane(normal, distance)
    hit = np.isfinite(depths)
    found = surface_normals(cloud_of(np.where(hit, depths, 6.0), hit), CAMERA, NOISE)
    assert found.planar.sum() > 800
    # one in 1e16 of the inverse depth, over a pixel's width of 0.02
    np.testing.assert_allclose(
        found.normals[found.planar], np.broadcast_to(n, (found.planar.sum(), 3)), atol=1e-12
    )
    assert (found.normals[~found.planar] == 0).all()
    assert (found.normal_variances[~found.planar] == 0).all()


def test_by_hand_a_wall_two_metres_ahead():
    """The inverse depth is known to 0.0015 in 5 x 5 pixels 0.018 wide, and 1/2 at the wall."""
    found = surface_normals(cloud_of(np.full(CAMERA.n_pixels, 2.0)), CAMERA, NOISE)
    np.testing.assert_allclose(found.normals[found.planar], [[-1, 0, 0]] * 2852, atol=1e-13)
    inner = np.zeros((48, 64), dtype=bool)
    inner[2:-2, 2:-2] = True
    std = 0.0015 * SPREAD / (0.5 * WIDTH * np.sqrt(LARGE))
    assert image(std)[24, 32] == pytest.approx(0.02352, rel=1e-3)
    np.testing.assert_allclose(
        image(found.normal_variances)[inner], image(std**2)[inner], rtol=1e-9
    )


def test_there_is_no_normal_at_the_border_of_the_image_and_a_small_window_next_to_it():
    found = surface_normals(cloud_of(np.full(CAMERA.n_pixels, 2.0)), CAMERA, NOISE)
    wanted = np.zeros((48, 64), dtype=bool)
    wanted[1:-1, 1:-1] = True
    np.testing.assert_array_equal(image(found.planar), wanted)
    ratio = (
        image(found.normal_variances / SPREAD**2)
        / image(found.normal_variances / SPREAD**2)[24, 32]
    )
    np.testing.assert_allclose(ratio[1, 1:-1], LARGE / SMALL, rtol=1e-9)
    np.testing.assert_allclose(ratio[1:-1, -2], LARGE / SMALL, rtol=1e-9)
    np.testing.assert_allclose(ratio[2:-2, 2], 1.0, rtol=1e-9)


def test_there_is_no_normal_at_a_step_and_a_small_window_next_to_it():
    """A step of half a metre between columns 31 and 32."""
    near = np.arange(CAMERA.n_pixels) % 64 < 32
    found = surface_normals(cloud_of(np.where(near, 2.0, 2.5)), CAMERA, NOISE)
    planar, normal_variances = (
        image(found.planar)[2:-2],
        image(found.normal_variances / SPREAD**2)[2:-2],
    )
    assert not planar[:, 31:33].any()
    assert planar[:, 1:31].all()
    assert planar[:, 33:-1].all()
    np.testing.assert_allclose(
        normal_variances[:, 30], normal_variances[:, 29] * LARGE / SMALL, rtol=1e-9
    )
    np.testing.assert_allclose(
        normal_variances[:, 33], normal_variances[:, 34] * LARGE / SMALL, rtol=1e-9
    )
    np.testing.assert_allclose(
        found.normals[found.planar], [[-1, 0, 0]] * found.planar.sum(), atol=1e-12
    )


def test_there_is_no_normal_at_a_crease_and_each_face_has_its_own_beside_it():
    """The upright edge of a crate, turned by 45 degrees, 2 m ahead."""
    eye = look_at_pose((0, 0, 0), (1, 0, 0))
    crate = box((1, 1, 3), (2.0 + np.sqrt(0.5), 0, 0), np.pi / 4)
    cloud = render_scan(crate, eye, CAMERA, EXACT, np.random.default_rng(0))
    found = surface_normals(cloud, CAMERA, NOISE)
    row = found.normals.reshape(48, 64, 3)[24]
    half = np.sqrt(0.5)
    assert not image(found.planar)[24, 31:33].any()
    np.testing.assert_allclose(row[20:30], [[-half, half, 0]] * 10, atol=1e-12)
    np.testing.assert_allclose(row[34:44], [[-half, -half, 0]] * 10, atol=1e-12)


def test_there_is_no_normal_beside_a_pixel_that_measured_nothing():
    hit = np.ones(CAMERA.n_pixels, dtype=bool)
    hit[20 * 64 + 40] = False
    found = surface_normals(cloud_of(np.full(CAMERA.n_pixels, 2.0), hit), CAMERA, NOISE)
    planar, normal_variances = image(found.planar), image(found.normal_variances / SPREAD**2)
    assert not planar[19:22, 39:42].any()
    ring = np.ones((5, 5), dtype=bool)
    ring[1:4, 1:4] = False
    assert planar[18:23, 38:43][ring].all()
    np.testing.assert_allclose(
        normal_variances[18:23, 38:43][ring], normal_variances[30, 30] * LARGE / SMALL, rtol=1e-9
    )
    assert normal_variances[20, 43] == pytest.approx(normal_variances[30, 30], rel=1e-9)


def test_a_camera_without_noise_sees_planes_too():
    depths, n = plane((-0.5, 0.85, 0), 1.5)
    hit = np.isfinite(depths)
    cloud = cloud_of(np.where(hit, depths, 6.0), hit)
    exact = surface_normals(cloud, CAMERA, EXACT)
    np.testing.assert_array_equal(exact.planar, surface_normals(cloud, CAMERA, NOISE).planar)
    np.testing.assert_allclose(exact.normals[exact.planar] @ n, 1.0, atol=1e-12)


def by_scatter(points):
    """Normal of the plane that is nearest to points in space, towards the camera."""
    off = points - points.mean(axis=0)
    n = np.linalg.eigh(off.T @ off)[1][:, 0]
    return n if n @ points.mean(axis=0) < 0 else -n


@pytest.fixture(scope="module")
def tilted():
    """Normals of an oblique plane, as seen in 60 noisy images, where windows share no pixel."""
    depths, n = plane((-0.5, 0.75, 0.43), 1.2)
    rng = np.random.default_rng(1)
    normals, scatter, normal_variances = [], [], []
    for draw in range(60):
        cloud = noisy(depths, rng)
        found = surface_normals(cloud, CAMERA, NOISE)
        usable = windows(found.planar)
        normals.append(windows(found.normals)[usable])
        normal_variances.append(windows(found.normal_variances)[usable])
        if draw < 20:
            at = windows(np.arange(CAMERA.n_pixels))[usable]
            around = (np.arange(-2, 3)[:, None] * CAMERA.width + np.arange(-2, 3)).ravel()
            scatter += [by_scatter(cloud.points[k + around]) for k in at]
    return n, np.concatenate(normals), np.array(scatter), np.concatenate(normal_variances)


def lean(normals, n):
    """Mean component of normals along the direction that leads from n to the optical axis."""
    axis = np.array([-1.0, 0, 0])
    toward = axis - (axis @ n) * n
    toward /= np.linalg.norm(toward)
    along = normals @ toward
    return along.mean(), along.std() / np.sqrt(len(along))


def test_planes_do_not_lean_towards_the_optical_axis(tilted):
    """Thousands of windows. A plane fitted to points in space by their scatter leans towards it,
    and its normal away."""
    n, normals, scatter, _ = tilted
    assert len(normals) > 3000
    value, error = lean(normals, n)
    assert abs(value) < 3 * error
    value, error = lean(scatter, n)
    assert value < -5 * error
    across = np.cross(n, [1.0, 0, 0])
    along = normals @ across / np.linalg.norm(across)
    assert abs(along.mean()) < 3 * along.std() / np.sqrt(len(along))


@pytest.mark.parametrize(("normal", "distance"), PLANES[:3])
def test_the_spread_of_normals_is_that_of_tilts_in_its_worst_direction(normal, distance):
    """Of 5 x 5 pixels near the axis. Its angle to the axis is more precise, by its cosine."""
    depths, n = plane(normal, distance)
    by_hand = NOISE.intrinsic * SPREAD * distance / (WIDTH * np.sqrt(LARGE))
    rng = np.random.default_rng(2)
    normals = []
    for _ in range(60):
        found = surface_normals(noisy(depths, rng), CAMERA, NOISE)
        large = windows(found.planar & (found.normal_variances < 2 * by_hand**2), 0.25)
        normals.append(windows(found.normals, 0.25)[large])
        np.testing.assert_allclose(
            windows(found.normal_variances, 0.25)[large], windows(by_hand**2, 0.25)[large], rtol=0.2
        )  # the ranges and lengths they are made of are noisy themselves
    spread = np.sqrt(np.linalg.eigvalsh(np.cov(np.concatenate(normals).T)))
    wanted = np.sqrt(np.mean(windows(by_hand**2, 0.25)))
    # pixels are 4.5 % lower than they are wide, and 1700 windows determine a spread to 2 %
    assert spread[2] == pytest.approx(wanted, rel=0.1)
    assert spread[1] == pytest.approx(-n[0] * wanted, rel=0.15)
    assert spread[0] < 0.1 * wanted  # lengths do not change


def test_noise_alone_makes_a_window_too_rough_once_in_thirty():
    """As chi-square has it: 22 degrees of freedom in 5 x 5 pixels, 6 in 3 x 3."""
    depths = np.full(CAMERA.n_pixels, 2.0)
    rng = np.random.default_rng(3)
    large, small = [], []
    for _ in range(60):
        found = surface_normals(noisy(depths, rng), CAMERA, NOISE)
        large.append(windows(found.normal_variances < 1e-3 * SPREAD**2) & windows(found.planar))
        small.append(image(found.planar)[1, 1:-1:3])  # next to the border there are only these
    large, small = np.concatenate(large), np.concatenate(small)
    wanted = chi2.cdf(1.6 * 22, 22), chi2.cdf(2.2 * 6, 6)
    assert wanted == pytest.approx((1 - 1 / 27, 1 - 1 / 25), abs=0.002)
    # a fraction of 0.04 of 6000 and of 1200 windows, to three standard errors
    assert large.mean() == pytest.approx(wanted[0], abs=3 * np.sqrt(0.04 / len(large)))
    assert small.mean() == pytest.approx(wanted[1], abs=3 * np.sqrt(0.04 / len(small)))
