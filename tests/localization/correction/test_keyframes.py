"""Earlier scans side by side in memory."""

import numpy as np
import pytest

from coopmap_env.geometry import Pose
from coopmap_env.localization.correction._keyframes import KeyframeBuffer, ScanSurfaces
from coopmap_env.localization.correction._surface_normals import surface_normals
from coopmap_env.sensing import DepthCamera, PointCloud, RangeNoise

CAMERA = DepthCamera(width=8, height=6)
N = CAMERA.n_pixels


def numbered(k):
    """A scan whose every value is k."""
    values = np.full(N, float(k))
    return ScanSurfaces(
        np.full((N, 3), k), np.full((N, 3), k), np.full(N, k % 2 == 1), values, values
    )


def standing(k):
    return Pose(np.full(3, float(k)), np.eye(3))


def in_order(kept):
    """The number of each stored scan, as kernels find it."""
    return [int(kept.arrays.surfaces.points[slot, 0, 0]) for slot in kept.slots]


def test_scans_keep_their_order_when_one_is_removed_and_its_slot_is_used_again():
    kept = KeyframeBuffer(3, N)
    for k in (1, 2, 3):
        kept.add(numbered(k))
    assert in_order(kept) == [1, 2, 3]
    kept.remove(0)
    assert in_order(kept) == [2, 3]
    kept.add(numbered(4))
    assert in_order(kept) == [2, 3, 4]
    kept.set_camera_poses([standing(2), standing(3), standing(4)])
    for slot, k in zip(kept.slots, (2, 3, 4), strict=True):
        assert kept.arrays.translations[slot].tolist() == [k, k, k]
        np.testing.assert_array_equal(kept.arrays.rotations[slot], np.eye(3))
        for part, wanted in zip(kept.arrays.surfaces, numbered(k), strict=True):
            np.testing.assert_array_equal(part[slot], wanted)


def test_a_full_buffer_takes_no_more():
    kept = KeyframeBuffer(2, N)
    kept.add(numbered(1))
    kept.add(numbered(2))
    with pytest.raises(ValueError, match="all 2 slots are used"):
        kept.add(numbered(3))
    assert in_order(kept) == [1, 2]


def test_each_scan_needs_a_pose():
    kept = KeyframeBuffer(2, N)
    kept.add(numbered(1))
    with pytest.raises(ValueError, match="zip"):
        kept.set_camera_poses([])


def test_by_hand_the_surfaces_of_a_scan():
    """A wall 2 m ahead; a pixel measured nothing. Eq. 1 at the distance, not at the depth."""
    points = CAMERA.directions * (2.0 / CAMERA.directions[:, :1])
    hit = np.ones(N, dtype=bool)
    hit[3] = False
    cloud, noise = PointCloud(points, hit), RangeNoise(intrinsic=0.002, depth=0.5, lateral=0.1)
    surfaces = ScanSurfaces.from_cloud(cloud, CAMERA, noise)
    wanted = 0.002 * 0.5 * (points**2).sum(axis=1) * hit
    np.testing.assert_allclose(surfaces.deviations, wanted, rtol=1e-12)
    normals = surface_normals(cloud, CAMERA, noise)
    np.testing.assert_array_equal(surfaces.normals, normals.normals)
    np.testing.assert_array_equal(surfaces.planar, normals.planar)
    np.testing.assert_array_equal(surfaces.normal_variances, normals.normal_variances)
    # a camera without noise has a small deviation
    exact = ScanSurfaces.from_cloud(cloud, CAMERA, RangeNoise(intrinsic=0.0)).deviations
    np.testing.assert_array_equal(exact > 0, hit)
