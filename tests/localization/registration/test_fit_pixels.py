import numpy as np
import pytest
from plain.triangle_camera import box, look_at_pose, render_scan

from coopmap_env.geometry import rotation_about_z
from coopmap_env.geometry.rotations import apply_displacement
from coopmap_env.geometry.transforms import Pose
from coopmap_env.localization.depth_rendering import render_depth
from coopmap_env.localization.registration.pixel_residuals import (
    AGREES,
    OCCLUDED,
    SEEN_THROUGH,
    UNDECIDED,
    count_off_surface,
    pixel_residuals,
)
from coopmap_env.localization.registration.views import View, ViewBatch
from coopmap_env.localization.target import TargetModel
from coopmap_env.robots import PoseEstimate
from coopmap_env.sensing import DepthCamera, RangeNoise
from coopmap_env.sensing.noise import rotate_covariances

CAMERA, NOISE = DepthCamera(), RangeNoise()
NUMBERS = (NOISE.intrinsic, NOISE.depth, NOISE.lateral, NOISE.exponent)
MODEL = TargetModel(box((1.0, 1.6, 1.2), (0, 0, 0.6)))
T = Pose(np.array([3.0, 0.4, 0.0]), rotation_about_z(np.pi - 0.2))


def seen(world, where=T, noise=NOISE, at=(0, 0, 0.7)):
    """ViewBatch of one look at a world, from where the base stands."""
    pose = look_at_pose((0.2, 0.1, 1.5), where.inverse().transform(at))
    cloud = render_scan(world, where @ pose, CAMERA, noise, np.random.default_rng(0))
    return ViewBatch.from_views([View(cloud, PoseEstimate(pose, np.zeros((6, 6))))], CAMERA)


def judged(batch, T, sigma_floor=0.003):
    n = CAMERA.n_pixels
    R, t = T.rotation @ batch.R[0], T.transform(batch.t[0])
    depth, triangle, verdict = np.empty(n), np.empty(n, np.int64), np.empty(n, np.int8)
    render_depth(MODEL.triangles, R.T.copy(), -R.T @ t, batch.intrinsics, depth, triangle)
    H, b, patches = np.zeros((6, 6)), np.zeros(6), np.zeros((10, 16, 12), dtype=bool)
    chi2 = pixel_residuals(
        batch.points[0], batch.hit[0], batch.ranges[0], batch.min_ranges[0], depth, triangle,
        MODEL.normals, MODEL.plane_points, batch.R[0], batch.t[0], T.rotation, T.translation, NUMBERS,
        sigma_floor, 3.0, 0.08, 0.3, verdict, H, b, patches, MODEL.bounds[0], 0.1,
    )  # fmt: skip
    return triangle, verdict, chi2, H, b, patches


def residuals(batch, T, triangle, agrees):
    """n . (T p - q) of the pixels that agree, and their standard deviations by Eqs. 1 and 3."""
    R = T.rotation @ batch.R[0]
    points = T.transform(batch.points[0] @ batch.R[0].T + batch.t[0])[agrees]
    n, q = MODEL.normals[triangle[agrees]], MODEL.plane_points[triangle[agrees]]
    sigma = NOISE.standard_deviations(batch.ranges[0][agrees], 3)
    C = rotate_covariances(sigma[..., None] ** 2 * np.eye(3), R)
    return (n * (points - q)).sum(axis=1), np.sqrt(np.einsum("ni,nij,nj->n", n, C, n) + 0.003**2)


def test_the_information_is_that_of_residuals_and_their_differences():
    """H = J^T J, b = -J^T r, with J by differences of the residuals as the base is displaced."""
    batch = seen(MODEL.triangles)
    start = apply_displacement(T, [0.01, -0.01, 0.005, 0.002, -0.001, 0.003])
    triangle, verdict, chi2, H, b, _ = judged(batch, start)
    agrees = verdict == AGREES
    r, sigma = residuals(batch, start, triangle, agrees)
    J = np.empty((len(r), 6))
    for i in range(6):
        d = 1e-6 * np.eye(6)[i]
        more = residuals(batch, apply_displacement(start, d), triangle, agrees)[0]
        less = residuals(batch, apply_displacement(start, -d), triangle, agrees)[0]
        J[:, i] = (more - less) / 2e-6 / sigma
    assert agrees.sum() > 500
    assert chi2 == pytest.approx(np.square(r / sigma).sum())
    np.testing.assert_allclose(H, J.T @ J, rtol=1e-6, atol=1e-6 * H.max())
    np.testing.assert_allclose(b, -J.T @ (r / sigma), rtol=1e-6, atol=1e-6 * np.abs(b).max())


def test_a_true_pose_is_agreed_on_and_residuals_are_those_of_eq_1():
    batch = seen(MODEL.triangles)
    triangle, verdict, chi2, *_ = judged(batch, T)
    agree = (verdict == AGREES).sum()
    assert agree > 0.97 * (triangle >= 0).sum()
    assert not (verdict == SEEN_THROUGH).any()
    # 1, less what three sigma cut off, and the lateral noise, which a look along beams has not
    assert 0.7 < chi2 / agree < 1.0


def test_a_screen_is_in_front_and_an_empty_place_is_seen_through():
    screen = box((0.1, 6.0, 6.0), (1.6, 0, 1.0))
    triangle, verdict, *_ = judged(seen(np.concatenate([MODEL.triangles, screen])), T)
    assert (verdict[triangle >= 0] == OCCLUDED).all()
    wall = box((0.1, 9.0, 9.0), (-2.0, 0, 0.0))
    triangle, verdict, *_ = judged(seen(wall), T)
    # at the image's border and the ends of the range there is no telling
    assert (verdict[triangle >= 0] == SEEN_THROUGH).mean() > 0.9


def test_beams_that_say_nothing_are_no_evidence():
    batch = seen(MODEL.triangles)
    batch.ranges[:], batch.hit[:] = 0.0, False
    triangle, verdict, chi2, H, *_ = judged(batch, T)
    assert (verdict[triangle >= 0] == OCCLUDED).all()
    assert (verdict[triangle < 0] == UNDECIDED).all()
    assert chi2 == 0.0
    assert not H.any()


def test_patches_are_those_of_the_faces_in_sight():
    """A front of 16 x 12 square decimetres; the top is seen at a slant, so beams skip some."""
    straight = Pose(np.array([3.0, 0.0, 0.0]), rotation_about_z(np.pi))
    *_, patches = judged(seen(MODEL.triangles, straight, RangeNoise(intrinsic=0.0)), straight)
    assert patches[9].mean() > 0.9  # the front
    assert patches[:9, :, -1].any()  # the top
    assert not patches[:9, 1:-1, :-1].any()  # the sides, which the base stands beside


def test_points_inside_of_the_box_and_off_the_surface_are_counted():
    """A pole inside of a hollow frame."""
    surface_distances, origin = (
        np.full((40, 40, 40), 0.5, dtype=np.float32),
        np.array([-2.0, -2.0, -2.0]),
    )
    points = np.array([[3.0, 0, 0], [3.0, 0.2, 0], [3.0, 5.0, 0], [1.0, 0, 0]])
    hit = np.array([True, True, True, False])
    eye = np.eye(3), np.zeros(3), np.eye(3), np.array([-3.0, 0.0, 0.0])
    box_ = -np.ones(3), np.ones(3)
    assert (
        count_off_surface(points, hit, *eye, surface_distances, origin, 0.1, *box_, NUMBERS, 0.08)
        == 2
    )
    surface_distances[:] = 0.05
    assert (
        count_off_surface(points, hit, *eye, surface_distances, origin, 0.1, *box_, NUMBERS, 0.08)
        == 0
    )
