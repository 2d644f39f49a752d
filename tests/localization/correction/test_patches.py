"""Scans compared with earlier ones: what is measured of a patch's displacement."""

import dataclasses

import numpy as np
import pytest
from plain import patches as plain
from plain.triangle_camera import box, look_at_pose, render_scan

from coopmap_env.geometry import Pose, apply_displacement
from coopmap_env.localization import CorrectionSettings
from coopmap_env.localization.correction._association import (
    MIN_NORMAL_COSINE,
    AssociationGates,
    PatchScan,
    PatchSources,
    accumulate_patches,
    associate,
    count_overlap,
)
from coopmap_env.localization.correction._keyframes import KeyframeArrays, ScanSurfaces
from coopmap_env.localization.correction._known_target import PixelPlanes
from coopmap_env.localization.correction._patches import (
    MIN_VARIANCE,
    TARGET_SOURCE,
    PatchSums,
    patches_from_sums,
)
from coopmap_env.localization.correction._surface_normals import surface_normals
from coopmap_env.sensing import DepthCamera, RangeNoise

CAMERA = DepthCamera(width=32, height=24)
INTRINSICS = CAMERA.intrinsics
NOISE, EXACT = RangeNoise(), RangeNoise(intrinsic=0.0)
LATERAL = 0.25
SETTINGS = CorrectionSettings()
HERE = Pose(np.zeros(3), np.eye(3))
WALL = box((1, 8, 8), (2.5, 0, 0))
"""Its face is 2 m ahead."""
SIGMA = 0.01
"""Metres, of each pixel, in tests by hand."""


def scanned(triangles, pose, noise=EXACT, seed=0, stated=NOISE):
    """A scan, its normals, and the deviations of its pixels by Eq. 1."""
    cloud = render_scan(triangles, pose, CAMERA, noise, np.random.default_rng(seed))
    normals = surface_normals(cloud, CAMERA, stated)
    ranges = np.linalg.norm(cloud.points, axis=1)
    deviations = np.where(cloud.hit, stated.intrinsic * ranges**2, 0.0)
    return plain.PlainScan(
        pose, cloud.points, normals.normals, normals.planar, normals.normal_variances, deviations
    )


def with_sigma(scan):
    """The same scan with errors of `SIGMA` in each pixel."""
    return scan._replace(deviations=np.full(len(scan.points), SIGMA))


def surfaces(scan):
    """A scan in the camera frame, for kernels."""
    return ScanSurfaces(*scan[1:])


def keyframes(scans):
    n = CAMERA.n_pixels
    stacked = ScanSurfaces(
        np.array([s.points for s in scans]).reshape(-1, n, 3),
        np.array([s.normals for s in scans]).reshape(-1, n, 3),
        np.array([s.planar for s in scans], dtype=bool).reshape(-1, n),
        np.array([s.normal_variances for s in scans]).reshape(-1, n),
        np.array([s.deviations for s in scans]).reshape(-1, n),
    )
    rotations = np.array([s.pose.rotation for s in scans]).reshape(-1, 3, 3)
    return KeyframeArrays(
        stacked, rotations, np.array([s.pose.translation for s in scans]).reshape(-1, 3)
    )


def measure(now, scans, labels=None, planes=None, gates=(0.25, 0.0), n_labels=1, order=None):
    """Compare a scan with others, in their order or in another one."""
    n = CAMERA.n_pixels
    slots = np.arange(len(scans)) if order is None else np.array(order)
    labels = np.zeros(n, dtype=np.int32) if labels is None else labels
    planes = PixelPlanes.zeros(n) if planes is None else planes
    sums = PatchSums.zeros(n_labels, 1 + len(slots))
    axis = np.ascontiguousarray(now.pose.rotation[:, 0])
    accumulate_patches(
        PatchScan(surfaces(now).in_world(now.pose), labels, planes, axis, LATERAL),
        PatchSources(keyframes(scans), slots, np.zeros((len(slots), n), dtype=bool)),
        INTRINSICS, AssociationGates(*gates), sums,
    )  # fmt: skip
    return sums


def scene(rng):
    """A few crates before a wall, and ground."""
    crates = [
        box(rng.uniform(0.3, 0.9, 3), [rng.uniform(1.8, 3.0), y, rng.uniform(-0.5, 0.5)], turn)
        for y, turn in zip((-0.8, 0.0, 0.7), rng.uniform(0, 3, 3), strict=True)
    ]
    return np.concatenate([*crates, box((1, 9, 9), (4.5, 0, 0)), box((9, 9, 1), (2, 0, -1.2))])


def around(rng):
    """A camera somewhere near to the origin, turned a little."""
    return apply_displacement(HERE, rng.normal(size=6) * [0.2, 0.2, 0.2, 0.05, 0.05, 0.05])


# association


def test_by_hand_a_pixel_looks_through_where_its_point_is():
    """The wall of an earlier scan: the pixel right and above of the middle sees 5 cm and 4 cm."""
    there = scanned(WALL, HERE)
    p, n = np.array([2.0, -0.01, 0.01]), np.array([-1.0, 0, 0])
    middle = 11 * 32 + 16  # row 11 of 24, column 16 of 32: the first to the right, above
    assert associate(p, n, 0, keyframes([there]), INTRINSICS, 0.25) == middle
    assert associate(p * [1, -1, -1], n, 0, keyframes([there]), INTRINSICS, 0.25) == middle + 31


@pytest.mark.parametrize(
    ("point", "normal"),
    [
        ((-2.0, 0, 0), (-1.0, 0, 0)),  # behind the camera
        ((0.05, 0, 0), (-1.0, 0, 0)),  # in it
        ((2.0, 3, 0), (-1.0, 0, 0)),  # out of the image
        ((2.0, 0, -3), (-1.0, 0, 0)),
        ((1.7, 0, 0), (-1.0, 0, 0)),  # nothing within 25 cm
        ((2.0, 0, 0), (1.0, 0, 0)),  # the back of a wall
        ((2.0, 0, 0), (-0.8, 0.6, 0)),  # turned by 37 degrees
        ((2.0, 1.12, 0), (-1.0, 0, 0)),  # a pixel without a normal, at the border
    ],
)
def test_a_surface_that_an_earlier_scan_did_not_see_has_no_pixel(point, normal):
    args = (0, keyframes([scanned(WALL, HERE)]), INTRINSICS, 0.25)
    assert associate(np.array(point), np.array(normal), *args) == -1


def test_association_is_the_plain_one():
    rng = np.random.default_rng(1)
    found = 0
    for k in range(6):
        triangles = scene(rng)
        now, *scans = (scanned(triangles, around(rng), NOISE, 3 * k + i) for i in range(3))
        points, normals = now.pose.transform(now.points), now.normals @ now.pose.rotation.T
        for gate in (0.05, 0.25):
            wanted = [
                [plain.associated_pixel(p, n, there, CAMERA, gate, MIN_NORMAL_COSINE)
                 for p, n in zip(points, normals, strict=True)]
                for there in scans
            ]  # fmt: skip
            for s in range(2):
                for p, n, m in zip(points, normals, wanted[s], strict=True):
                    same = associate(p, n, s, keyframes(scans), INTRINSICS, gate)
                    assert same == (-1 if m is None else m)
            counts = np.full(2, -1)
            count_overlap(
                surfaces(now).in_world(now.pose), 5, np.array([1, 0]), keyframes(scans), INTRINSICS,
                gate, counts,
            )  # fmt: skip
            shared = [
                sum(bool(now.planar[i]) and of[i] is not None for i in range(0, len(points), 5))
                for of in wanted
            ]
            assert counts.tolist() == shared[::-1]  # in the order in which they were named
            found += sum(shared)
    assert found > 500


# sums over pixels


@pytest.mark.parametrize("gates", [(0.25, 0.05), (0.15, 0.0)])
def test_sums_are_the_plain_ones(gates):
    rng = np.random.default_rng(2)
    counts = np.zeros(4)
    for k in range(4):
        triangles = scene(rng)
        now, *scans = (scanned(triangles, around(rng), NOISE, 10 * k + i) for i in range(4))
        labels = rng.integers(-1, 5, CAMERA.n_pixels).astype(np.int32)
        planes = PixelPlanes.zeros(CAMERA.n_pixels)
        on_target = rng.random(CAMERA.n_pixels) < 0.2
        n = rng.normal(size=(on_target.sum(), 3))
        planes.normals[on_target] = n / np.linalg.norm(n, axis=1)[:, None]
        shifts = 0.03 * rng.normal(size=n.shape)
        planes.points[on_target] = now.pose.transform(now.points[on_target]) + shifts
        for order in ([0, 1, 2], [2, 0]):
            sums = measure(now, scans, labels, planes, gates, 5, order)
            wanted = plain.measure_patches(
                now, [scans[i] for i in order], CAMERA, LATERAL, labels, planes, gates,
                MIN_NORMAL_COSINE, MIN_VARIANCE, 5,
            )  # fmt: skip
            for sums_of, wanted_of in zip(sums, wanted, strict=True):
                scale = np.abs(wanted_of).max()
                # hundreds of terms, added in the same order
                np.testing.assert_allclose(sums_of / scale, wanted_of / scale, atol=1e-10)
            if len(order) == 3:
                counts += sums.n_pixels.sum(axis=0)
    assert (counts > 50).all()  # the target, and each of three scans


def test_by_hand_a_wall_that_came_1_cm_nearer():
    """N pixels of 1 cm in each scan: 2 cm^2 / N along the axis, and no information across it."""
    there, now = with_sigma(scanned(WALL, HERE)), with_sigma(scanned(WALL, HERE))
    now = now._replace(points=now.points - [0.01, 0, 0])
    sums = measure(now, [there])
    n = sums.n_pixels[0, 1]
    assert n > 400
    assert not any(array[0, 0].any() for array in sums)  # there is no known target
    patches = patches_from_sums(sums, SETTINGS)
    assert patches.labels.tolist() == [0]
    assert patches.sources.tolist() == [0]
    np.testing.assert_allclose(patches.displacements, [[0.01, 0, 0]], atol=1e-12)
    strength = 1.0 / (2 * SIGMA**2 / n + SETTINGS.patch_model_std**2 + MIN_VARIANCE)
    np.testing.assert_allclose(patches.precisions, [[0, 0, strength]], rtol=1e-9)
    np.testing.assert_allclose(patches.information, [np.diag([strength, 0, 0])], atol=1e-6)
    np.testing.assert_allclose(patches.positions[0, 0], 1.99, atol=1e-12)
    np.testing.assert_allclose(
        np.abs(patches.along_axes(np.array([[0.3, 0.0, 0.0]]))), [[0, 0, 0.3]], atol=1e-12
    )


def test_a_wall_does_not_measure_a_motion_along_itself():
    there, now = with_sigma(scanned(WALL, HERE)), with_sigma(scanned(WALL, HERE))
    now = now._replace(points=now.points - np.array([0, -0.03, 0.02]))
    patches = patches_from_sums(measure(now, [there]), SETTINGS)
    np.testing.assert_allclose(patches.displacements, [[0, 0, 0]], atol=1e-12)
    assert (patches.precisions > 0).tolist() == [[False, False, True]]


def test_an_oblique_wall_measures_the_displacement_along_its_normal():
    """Seen from another place; it is moved by 1 cm along its normal and 2 cm along itself."""
    triangles = box((1, 8, 8), (3.0, 0, 0), 0.6)
    n = -np.array([np.cos(0.6), np.sin(0.6), 0])
    there = with_sigma(scanned(triangles, look_at_pose((0, 0.1, 0), (2.5, 0.2, 0.1))))
    now = with_sigma(scanned(triangles, look_at_pose((0.2, -0.3, 0.2), (2.5, -0.1, 0))))
    moved = 0.01 * n + 0.02 * np.array([0, 0, 1])
    now = now._replace(points=now.points + moved @ now.pose.rotation)
    patches = patches_from_sums(measure(now, [there]), SETTINGS)
    np.testing.assert_allclose(patches.displacements, [-0.01 * n], atol=1e-12)
    np.testing.assert_allclose(np.abs(patches.axes[0, :, 2] @ n), 1.0, atol=1e-12)


@pytest.mark.parametrize(("faces", "directions"), [("edge", 2), ("corner", 3)])
def test_two_faces_determine_two_directions_and_three_all(faces, directions):
    crate = box((1.2, 1.2, 1.2), (2.4, 0, 0), np.pi / 4)
    eye = (0, 0, 0) if faces == "edge" else (0.4, 0, 1.8)
    pose = look_at_pose(eye, (2.4, 0, 0.0 if faces == "edge" else 0.5))
    there, now = with_sigma(scanned(crate, pose)), with_sigma(scanned(crate, pose))
    moved = np.array([0.01, -0.005, 0.004])
    now = now._replace(points=now.points + moved @ pose.rotation)
    patches = patches_from_sums(measure(now, [there]), SETTINGS)
    assert (patches.precisions > 0).sum() == directions
    wanted = -moved * [1, 1, directions == 3]
    # pixels at the edges are paired with the face that the earlier scan measured there
    np.testing.assert_allclose(patches.displacements, [wanted], atol=1e-9)


def test_with_the_target_only_the_present_scan_has_errors():
    now = with_sigma(scanned(WALL, HERE))
    planes = PixelPlanes(*np.tile([[[-1.0, 0, 0]], [[2.01, 5, 5]]], (1, CAMERA.n_pixels, 1)))
    sums = measure(now, [], planes=planes)
    patches = patches_from_sums(sums, SETTINGS)
    assert patches.sources.tolist() == [TARGET_SOURCE]
    np.testing.assert_allclose(patches.displacements, [[0.01, 0, 0]], atol=1e-12)
    n = CAMERA.n_pixels
    strength = 1.0 / (SIGMA**2 / n + SETTINGS.patch_model_std**2 + MIN_VARIANCE)
    np.testing.assert_allclose(patches.precisions, [[0, 0, strength]], rtol=1e-9)


def test_across_the_optical_axis_errors_are_smaller_by_eq_1():
    """A surface along the axis: its pixels are four times as precise along its normal."""
    now = with_sigma(scanned(WALL, HERE))
    planes = PixelPlanes.zeros(CAMERA.n_pixels)
    planes.normals[:, 1] = 1.0
    planes.points[:] = now.points
    sums = measure(now, [], planes=planes)
    assert sums.weight[0, 0] == pytest.approx(CAMERA.n_pixels / (LATERAL * SIGMA) ** 2, rel=1e-9)


def test_a_pixel_of_an_earlier_scan_is_paired_once():
    """All present pixels are at one point: one is paired in the first scan, one in the second."""
    there, now = with_sigma(scanned(WALL, HERE)), with_sigma(scanned(WALL, HERE))
    now = now._replace(points=np.tile([[2.0, -0.01, 0.01]], (CAMERA.n_pixels, 1)))
    assert measure(now, [there]).n_pixels[0].tolist() == [0, 1]
    assert measure(now, [there, there]).n_pixels[0].tolist() == [0, 1, 1]


def test_by_hand_residuals_beyond_three_sigma_are_left_out():
    """Both scans err by 1 cm: three sigma are 4.24 cm, and 5.20 cm with 1 cm that is added."""
    there = with_sigma(scanned(WALL, HERE))
    for off, gate, used in [(0.042, 0, True), (0.043, 0, False), (0.051, 0.01, True),
                            (0.053, 0.01, False)]:  # fmt: skip
        now = there._replace(points=there.points + np.array([off, 0, 0]))
        assert (measure(now, [there], gates=(0.25, gate)).n_pixels[0, 1] > 0) == used


def test_pixels_without_a_label_or_a_normal_do_not_count():
    there = with_sigma(scanned(WALL, HERE))
    none = np.full(CAMERA.n_pixels, -1, dtype=np.int32)
    assert not measure(there, [there], labels=none).n_pixels.any()
    without = there._replace(planar=np.zeros_like(there.planar))
    assert not measure(without, [there]).n_pixels.any()


# patches


def test_patches_of_too_few_pixels_are_left_out():
    there = with_sigma(scanned(WALL, HERE))
    labels = np.full(CAMERA.n_pixels, -1, dtype=np.int32)
    labels[12 * 32 + 5 : 12 * 32 + 10] = 0  # five
    labels[12 * 32 + 15 : 12 * 32 + 21] = 1  # six
    six = dataclasses.replace(SETTINGS, min_patch_pixels=6)
    patches = patches_from_sums(measure(there, [there], labels, n_labels=3), six)
    assert patches.labels.tolist() == [1]
    fewer = dataclasses.replace(SETTINGS, min_patch_pixels=5)
    patches = patches_from_sums(measure(there, [there], labels, n_labels=3), fewer)
    assert patches.labels.tolist() == [0, 1]


def noisy_wall(seed):
    pose = look_at_pose((0.1, -0.2, 0.1), (2.2, 0.3, 0))
    there, now = scanned(WALL, HERE, NOISE, seed), scanned(WALL, pose, NOISE, seed + 1000)
    labels = -np.ones(CAMERA.n_pixels, dtype=np.int32)
    near = np.linalg.norm(pose.transform(now.points) - [2.0, 0.1, 0], axis=1) < 0.4
    labels[near] = 0
    return measure(now, [there], labels)


def test_directions_that_noise_in_normals_makes_up_are_left_out():
    """Fifty scans of a wall: one direction each. Noise in the normals makes up two others."""
    made_up = 0
    for seed in range(50):
        sums = noisy_wall(seed)
        patches = patches_from_sums(sums, SETTINGS)
        assert (patches.precisions > 0).tolist() == [[False, False, True]]
        all_of_them = patches_from_sums(sums, dataclasses.replace(SETTINGS, tilt_noise_factor=0.0))
        made_up += (all_of_them.precisions > 0).sum() - 1
    assert made_up == 100


def test_the_precision_of_a_noisy_wall_is_that_of_its_errors():
    """200 pairs of scans of a wall that stands still: squared displacements in their variance."""
    squares = []
    for seed in range(200):
        patches = patches_from_sums(
            noisy_wall(seed), dataclasses.replace(SETTINGS, patch_model_std=0.0)
        )
        squares.append((patches.along_axes(patches.displacements)[0, 2]) ** 2
                       * patches.precisions[0, 2])  # fmt: skip
    assert 0.81 < np.mean(squares) < 1.21  # the mean of 200 squares is 1 +- 0.1
