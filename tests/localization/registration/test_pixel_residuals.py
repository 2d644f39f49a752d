import numpy as np
import pytest
from plain.triangle_camera import box, look_at_pose, render_scan

from coopmap_env.geometry import Pose, RigidTransform, apply_displacement, rotation_about_z
from coopmap_env.localization import TargetModel, View
from coopmap_env.localization._depth_rendering import DepthImage, render_depth
from coopmap_env.localization.registration._likelihood_field import DistanceField
from coopmap_env.localization.registration._pixel_residuals import (
    AGREES,
    OCCLUDED,
    SEEN_THROUGH,
    UNDECIDED,
    SurfacePatches,
    Thresholds,
    ViewEvidence,
    count_off_surface,
    pixel_residuals,
)
from coopmap_env.localization.registration.views import ViewArrays, ViewBatch
from coopmap_env.robots import PoseEstimate
from coopmap_env.sensing import DepthCamera, RangeNoise, rotate_covariances

CAMERA, NOISE = DepthCamera(), RangeNoise()
MODEL = TargetModel(box((1.0, 1.6, 1.2), (0, 0, 0.6)))
T = Pose(np.array([3.0, 0.4, 0.0]), rotation_about_z(np.pi - 0.2))


def scanned(world, where=T, noise=NOISE, at=(0, 0, 0.7)):
    """A batch of one scan of a world, from a base pose."""
    pose = look_at_pose((0.2, 0.1, 1.5), where.inverse().transform(at))
    cloud = render_scan(world, where @ pose, CAMERA, noise, np.random.default_rng(0))
    return ViewBatch.from_views([View(cloud, PoseEstimate(pose, np.zeros((6, 6))))], CAMERA)


def evaluated(batch, T, sigma_floor=0.003):
    """Triangles that the pixels should see, their verdicts, chi^2, H, b and the patches seen."""
    n = CAMERA.n_pixels
    image = DepthImage.empty(n)
    T_target_camera = T @ Pose(batch.t[0], batch.R[0])
    render_depth(MODEL.triangles, T_target_camera.inverse().arrays, batch.intrinsics, image)
    evidence = ViewEvidence(np.empty(n, np.int8), np.zeros((6, 6)), np.zeros(6))
    patches = SurfacePatches(np.zeros((10, 16, 12), dtype=bool), MODEL.bounds[0], 0.1)
    chi2 = pixel_residuals(
        batch.view(0), image, MODEL.planes, T.arrays, NOISE.parameters,
        Thresholds(sigma_floor, 3.0, 0.08, 0.3), evidence, patches,
    )  # fmt: skip
    return image.triangle_index, evidence.verdicts, chi2, evidence.H, evidence.b, patches.seen


def residuals(batch, T, triangle, agrees):
    """n . (T p - q) of the pixels that agree, and their standard deviations by Eqs. 1 and 3."""
    R = T.rotation @ batch.R[0]
    points = T.transform(batch.points[0] @ batch.R[0].T + batch.t[0])[agrees]
    n, q = MODEL.planes.normals[triangle[agrees]], MODEL.planes.points[triangle[agrees]]
    sigma = NOISE.standard_deviations(batch.ranges[0][agrees], 3)
    C = rotate_covariances(sigma[..., None] ** 2 * np.eye(3), R)
    return (n * (points - q)).sum(axis=1), np.sqrt(np.einsum("ni,nij,nj->n", n, C, n) + 0.003**2)


def test_the_information_is_that_of_residuals_and_their_differences():
    """H = J^T J, b = -J^T r, with J by differences of the residuals as the base is displaced."""
    batch = scanned(MODEL.triangles)
    start = apply_displacement(T, [0.01, -0.01, 0.005, 0.002, -0.001, 0.003])
    triangle, verdict, chi2, H, b, _ = evaluated(batch, start)
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


def test_pixels_agree_with_a_true_pose_and_residuals_are_those_of_eq_1():
    batch = scanned(MODEL.triangles)
    triangle, verdict, chi2, *_ = evaluated(batch, T)
    agree = (verdict == AGREES).sum()
    assert agree > 0.97 * (triangle >= 0).sum()
    assert not (verdict == SEEN_THROUGH).any()
    # 1, less the tails beyond three sigma, and the lateral noise, which this scan has not
    assert 0.7 < chi2 / agree < 1.0


def test_a_screen_is_in_front_and_an_absent_target_is_seen_through():
    screen = box((0.1, 6.0, 6.0), (1.6, 0, 1.0))
    triangle, verdict, *_ = evaluated(scanned(np.concatenate([MODEL.triangles, screen])), T)
    assert (verdict[triangle >= 0] == OCCLUDED).all()
    wall = box((0.1, 9.0, 9.0), (-2.0, 0, 0.0))
    triangle, verdict, *_ = evaluated(scanned(wall), T)
    # at the image's border and the ends of the range pixels are undecided
    assert (verdict[triangle >= 0] == SEEN_THROUGH).mean() > 0.9


def test_rays_without_a_range_are_no_evidence():
    batch = scanned(MODEL.triangles)
    batch.ranges[:], batch.hit[:] = 0.0, False
    triangle, verdict, chi2, H, *_ = evaluated(batch, T)
    assert (verdict[triangle >= 0] == OCCLUDED).all()
    assert (verdict[triangle < 0] == UNDECIDED).all()
    assert chi2 == 0.0
    assert not H.any()


def test_patches_are_those_of_the_visible_faces():
    """A front of 16 x 12 square decimetres; the top is seen at a slant, so rays skip some."""
    straight = Pose(np.array([3.0, 0.0, 0.0]), rotation_about_z(np.pi))
    *_, patches = evaluated(scanned(MODEL.triangles, straight, RangeNoise(intrinsic=0.0)), straight)
    assert patches[9].mean() > 0.9  # the front
    assert patches[:9, :, -1].any()  # the top
    assert not patches[:9, 1:-1, :-1].any()  # the sides, which the base stands beside


def test_points_inside_of_the_box_and_off_the_surface_are_counted():
    """A pole inside of a hollow frame."""
    distances = np.full((40, 40, 40), 0.5, dtype=np.float32)
    field = DistanceField(distances, np.array([-2.0, -2.0, -2.0]), 0.1)
    points = np.array([[3.0, 0, 0], [3.0, 0.2, 0], [3.0, 5.0, 0], [1.0, 0, 0]])
    hit, none = np.array([True, True, True, False]), np.zeros(4)
    view = ViewArrays(points, hit, none, none, RigidTransform(np.eye(3), np.zeros(3)))
    T_target_base = RigidTransform(np.eye(3), np.array([-3.0, 0.0, 0.0]))
    args = view, T_target_base, field, -np.ones(3), np.ones(3), NOISE.parameters, 0.08
    assert count_off_surface(*args) == 2
    distances[:] = 0.05
    assert count_off_surface(*args) == 0
