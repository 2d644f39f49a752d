"""Pixels that should see the target: which plane, and which fiducial on it."""

import numpy as np
import pytest
from plain.triangle_camera import box, look_at_pose, ray_distances, render_scan

from coopmap_env.geometry import Pose, apply_displacement
from coopmap_env.localization.correction._keyframes import ScanSurfaces
from coopmap_env.localization.correction._known_target import (
    MAX_DEPTH_RESIDUAL,
    MIN_INCIDENCE_COSINE,
    KnownTarget,
    PixelPlanes,
)
from coopmap_env.localization.correction._surface_normals import surface_normals
from coopmap_env.localization.target import TargetModel
from coopmap_env.sensing import DepthCamera, RangeNoise

CAMERA, NOISE, EXACT = DepthCamera(width=32, height=24), RangeNoise(), RangeNoise(intrinsic=0.0)
N = CAMERA.n_pixels
CRATE = box((1.0, 1.4, 1.0), (0, 0, 0.5))
"""Its faces: x = +-0.5, y = +-0.7, z = 0 and 1."""
AHEAD = look_at_pose((-2.5, 0, 0.5), (0, 0, 0.5))
"""2 m before the face x = -0.5."""
SIGMA = 0.01


@pytest.fixture(scope="module")
def crate():
    return KnownTarget(TargetModel(CRATE), CAMERA.intrinsics, 0.4)


def ask(target, pose, points, normals=None, planar=None, deviations=None, first=7):
    """Labels of the pixels, and the planes that they should see."""
    labels, planes = np.full(N, -1, dtype=np.int32), PixelPlanes(*np.full((2, N, 3), np.nan))
    normals = np.zeros((N, 3)) if normals is None else normals
    planar = np.zeros(N, dtype=bool) if planar is None else planar
    deviations = np.full(N, SIGMA) if deviations is None else deviations
    scan = ScanSurfaces(points, normals, planar, np.zeros(N), deviations)
    target.label_pixels(pose, scan, first, labels, planes)
    return labels, planes


def measured(pose, triangles=CRATE, noise=EXACT, seed=0):
    return render_scan(triangles, pose, CAMERA, noise, np.random.default_rng(seed))


def test_by_hand_pixels_on_a_face_get_its_plane_and_the_nearest_fiducial(crate):
    cloud = measured(AHEAD)
    labels, planes = ask(crate, AHEAD, cloud.points)
    # 2 m ahead and 1.4 m by 1 m large: 19.4 columns and 14.5 rows of 0.072 m and 0.069 m
    assert cloud.hit.sum() == (labels >= 0).sum() == 20 * 14
    np.testing.assert_array_equal(labels >= 0, cloud.hit)
    np.testing.assert_allclose(planes.normals[cloud.hit], [[-1, 0, 0]] * 280, atol=1e-12)
    np.testing.assert_allclose(planes.points[cloud.hit, 0], -0.5, atol=1e-12)
    assert not planes.normals[~cloud.hit].any()
    seen = AHEAD.transform(cloud.points[cloud.hit])
    away = np.linalg.norm(seen[:, None] - crate.centers, axis=2)
    np.testing.assert_array_equal(labels[cloud.hit], 7 + away.argmin(axis=1))


def test_planes_and_fiducials_are_those_of_a_ray_against_each_triangle(crate):
    """From anywhere, by a pose that is a little off, with the noise of Eq. 1."""
    rng = np.random.default_rng(1)
    total = 0
    for seed in range(12):
        angle = rng.uniform(0, 2 * np.pi)
        eye = np.array([2.6 * np.cos(angle), 2.6 * np.sin(angle), rng.uniform(0.4, 1.8)])
        pose = look_at_pose(eye, rng.uniform([-0.3, -0.3, 0.2], [0.3, 0.3, 0.8]))
        cloud = measured(
            apply_displacement(pose, 0.01 * rng.normal(size=6)), noise=NOISE, seed=seed
        )
        deviations = np.where(cloud.hit, NOISE.intrinsic * (cloud.points**2).sum(axis=1), 0.0)
        labels, planes = ask(crate, pose, cloud.points, deviations=deviations)
        directions = CAMERA.directions @ pose.rotation.T
        each = [ray_distances(pose.translation, directions, t[None]) for t in crate.model.triangles]
        first, depth = np.argmin(each, axis=0), np.min(each, axis=0) * CAMERA.directions[:, 0]
        off = np.abs(cloud.points[:, 0] - depth)
        wanted = cloud.hit & np.isfinite(depth) & (off <= MAX_DEPTH_RESIDUAL + 3 * deviations)
        rays = cloud.points @ pose.rotation.T
        facing = -np.einsum("ni,ni->n", rays, crate.model.normals[first])
        wanted &= facing >= MIN_INCIDENCE_COSINE * np.linalg.norm(rays, axis=1)
        # rays through an edge of a triangle may be said to meet either side or none
        differ = wanted != (labels >= 0)
        assert differ.sum() <= 2
        same = wanted & ~differ
        normals, plane_points = crate.model.planes.normals[first], crate.model.planes.points[first]
        off_plane = np.einsum("ni,ni->n", planes.normals, plane_points - planes.points)
        np.testing.assert_allclose(planes.normals[same], normals[same], atol=1e-12)
        np.testing.assert_allclose(off_plane[same], 0.0, atol=1e-12)
        away = np.linalg.norm(pose.transform(cloud.points)[:, None] - crate.centers, axis=2)
        np.testing.assert_array_equal(labels[same], 7 + away.argmin(axis=1)[same])
        total += same.sum()
    assert total > 1500


def test_by_hand_pixels_that_miss_by_more_than_the_jump_are_left_out(crate):
    """10 cm and three deviations of 1 cm, in front of the face and behind it."""
    cloud = measured(AHEAD)
    for off, used in [(0.129, True), (0.131, False), (-0.129, True), (-0.131, False)]:
        labels, planes = ask(crate, AHEAD, cloud.points + off * np.eye(3)[0])
        assert (labels[cloud.hit] >= 0).all() == used
        assert (labels[cloud.hit] >= 0).any() == used
        assert planes.normals.any() == used


@pytest.mark.parametrize(("y", "used"), [(1.05, False), (2.0, True)])
def test_by_hand_a_face_that_is_seen_at_a_grazing_angle_is_left_out(crate, y, used):
    """The face y = 0.7, from 2.8 m before it: 0.35 m and 1.3 m aside, cosines of 0.1 and 0.4."""
    pose = look_at_pose((-3.0, y, 0.5), (-0.5, 0.6, 0.5))
    cloud = measured(pose)
    labels, planes = ask(crate, pose, cloud.points)
    at = pose.transform(cloud.points)
    on_front = cloud.hit & (np.abs(at[:, 0] + 0.5) < 1e-6)
    on_side = cloud.hit & (np.abs(at[:, 1] - 0.7) < 1e-6)
    assert (labels[on_front] >= 0).all()
    assert on_side.sum() > 5
    assert (labels[on_side] >= 0).all() == used
    assert (labels[on_side] >= 0).any() == used
    assert (planes.normals[on_side, 1] == 1.0).all() == used


def test_what_stands_before_the_target_is_not_taken_for_it(crate):
    """A post half a metre ahead of the face hides a part of it."""
    post = box((0.1, 0.3, 3.0), (-1.0, 0, 0.5))
    cloud, behind = measured(AHEAD, np.concatenate([CRATE, post])), measured(AHEAD)
    labels, _ = ask(crate, AHEAD, cloud.points)
    hidden = behind.hit & (cloud.points[:, 0] < behind.points[:, 0] - 0.2)
    assert hidden.sum() > 50
    assert (labels[hidden] == -1).all()
    assert (labels[behind.hit & ~hidden] >= 0).all()


def test_pixels_that_measured_nothing_are_left_out(crate):
    cloud = measured(AHEAD)
    deviations = np.full(N, SIGMA)
    deviations[::2] = 0.0
    labels, planes = ask(crate, AHEAD, cloud.points, deviations=deviations)
    np.testing.assert_array_equal(labels >= 0, cloud.hit & (np.arange(N) % 2 == 1))
    assert not planes.normals[::2].any()


@pytest.mark.parametrize(("degrees", "used"), [(0, True), (36, True), (38, False), (180, False)])
def test_a_surface_that_faces_another_way_is_not_the_targets(crate, degrees, used):
    """The cosine must be 0.8 at least, 36.9 degrees; where no plane fits nothing is asked."""
    cloud, angle = measured(AHEAD), np.radians(degrees)
    normals = np.tile([-np.cos(angle), np.sin(angle), 0.0], (N, 1))
    labels, _ = ask(crate, AHEAD, cloud.points, normals, np.ones(N, dtype=bool))
    assert (labels[cloud.hit] >= 0).all() == used
    assert (labels[cloud.hit] >= 0).any() == used
    labels, _ = ask(crate, AHEAD, cloud.points, normals, np.zeros(N, dtype=bool))
    assert (labels[cloud.hit] >= 0).all()


def test_all_is_the_same_from_everywhere_in_the_world():
    """Target, camera and points moved together: the same pixels, the plane moved as they are."""
    motion = apply_displacement(Pose(np.zeros(3), np.eye(3)), [3.0, -1.0, 0.4, 0.3, -0.2, 1.0])
    here = KnownTarget(TargetModel(CRATE), CAMERA.intrinsics, 0.4)
    there = KnownTarget(TargetModel(motion.transform(CRATE)), CAMERA.intrinsics, 0.4)
    pose = look_at_pose((-2.2, 1.1, 1.4), (0, 0.05, 0.45))
    cloud = measured(pose)
    normals = surface_normals(cloud, CAMERA, NOISE)
    args = (cloud.points, normals.normals, normals.planar)
    labels, planes = ask(here, pose, *args)
    moved_labels, moved = ask(there, motion @ pose, *args)
    np.testing.assert_array_equal(labels >= 0, moved_labels >= 0)
    used = labels >= 0
    np.testing.assert_allclose(
        moved.normals[used], planes.normals[used] @ motion.rotation.T, atol=1e-9
    )
    np.testing.assert_allclose(moved.points[used], motion.transform(planes.points[used]), atol=1e-9)


def test_labels_of_pixels_that_do_not_see_the_target_stay(crate):
    cloud = measured(AHEAD)
    labels, planes = np.arange(N, dtype=np.int32) % 5, PixelPlanes.zeros(N)
    before = labels.copy()
    scan = ScanSurfaces(
        cloud.points, np.zeros((N, 3)), np.zeros(N, dtype=bool), np.zeros(N), np.full(N, SIGMA)
    )
    crate.label_pixels(AHEAD, scan, 100, labels, planes)
    np.testing.assert_array_equal(labels[~cloud.hit], before[~cloud.hit])
    assert (labels[cloud.hit] >= 100).all()


@pytest.mark.parametrize("spacing", [0.2, 0.4, 1.0])
def test_there_is_one_fiducial_in_each_cube_of_the_grid_that_holds_surface(spacing):
    """The sample nearest to the middle of those in the cube."""
    model = TargetModel(CRATE)
    samples, centers = (
        model.samples[0],
        KnownTarget(model, CAMERA.intrinsics, spacing).centers,
    )
    cubes = {}
    for point in samples:
        cubes.setdefault(tuple(np.floor(point / spacing).astype(int)), []).append(point)
    assert len(centers) == len(cubes)
    for center in centers:
        points = np.array(cubes.pop(tuple(np.floor(center / spacing).astype(int))))
        away = np.linalg.norm(points - points.mean(axis=0), axis=1)
        chosen = np.linalg.norm(center - points.mean(axis=0))
        assert chosen == pytest.approx(away.min(), abs=1e-12)
    # so none of the surface is further from one than the diagonal of a cube
    nearest = np.linalg.norm(samples[:, None] - centers, axis=2).min(axis=1)
    assert nearest.max() <= np.sqrt(3) * spacing
