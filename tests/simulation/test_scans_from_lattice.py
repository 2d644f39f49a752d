"""A scan from a pose of the lattice, by the fan of the camera, is that of casting each beam."""

import math

import numpy as np
import pytest

from coopmap_env.core.random_streams import draw_stream
from coopmap_env.mapping import VoxelGrid
from coopmap_env.robots import PoseLattice
from coopmap_env.sensing import BeamFan, PlanarCamera, RangeNoise, ScanArrays
from coopmap_env.simulation.planar import camera_arrays
from coopmap_env.simulation.planar_scans import scan_from_lattice, simulate_scan

CAMERAS = [
    pytest.param(PlanarCamera(), id="default"),
    pytest.param(PlanarCamera(math.radians(90), 7.3, 64), id="one full word"),
    pytest.param(PlanarCamera(2 * math.pi, 9.0, 131), id="all around, three words"),
    pytest.param(PlanarCamera(1.0, 12.0, 1), id="one beam"),
]


def empty_scan(camera, position):
    n = camera.n_beams
    return ScanArrays(
        position, np.full((n, 2), np.nan), np.full((n, 2, 2), np.nan), np.zeros(n, dtype=np.bool_)
    )


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("fraction", [0.0, 0.02, 0.2])
def test_a_scan_by_the_fan_equals_casting_each_beam(camera, fraction):
    rng = np.random.default_rng(7)
    grid = VoxelGrid((37, 45))
    lattice = PoseLattice(grid, 16)
    fan = BeamFan.from_camera(camera, grid.resolution, lattice.n_headings)
    arrays = camera_arrays(camera, RangeNoise())
    n_hits = 0
    for _ in range(60):
        occupied = rng.random(grid.shape) < fraction
        pose_id = int(rng.integers(lattice.n_poses))
        pose = lattice.poses(pose_id)
        stream = draw_stream(rng)
        expected, scan = empty_scan(camera, pose[:2]), empty_scan(camera, pose[:2])
        plain_camera = (arrays.beams, arrays.reach, tuple(arrays.noise))
        after = stream.copy()
        simulate_scan(occupied, tuple(grid.geometry), pose, plain_camera, after, tuple(expected))
        free_beams = np.zeros(len(fan.all_beams), dtype=np.uint64)
        scan_from_lattice(
            occupied.ravel(), grid.shape, grid.resolution, *divmod(pose_id, lattice.n_headings),
            pose, fan.arrays(grid.shape[1]), arrays, stream, scan, free_beams,
        )  # fmt: skip
        for mine, theirs in zip(scan, expected, strict=True):
            np.testing.assert_array_equal(mine, theirs)
        np.testing.assert_array_equal(stream, after)
        bits = [int(free_beams[b // 64]) >> b % 64 & 1 for b in range(camera.n_beams)]
        np.testing.assert_array_equal(scan.hit, np.logical_not(bits))
        n_hits += scan.hit.sum()
    assert (n_hits > 0) == (fraction > 0)


def test_on_other_cells_a_scan_equals_casting_each_beam_to_rounding():
    """Off grids of whole metres the center of a cell in cells is not exactly i + 1/2."""
    rng = np.random.default_rng(3)
    grid = VoxelGrid((30, 30), 0.135, (-3.2, 1.7))
    lattice, camera, noise = PoseLattice(grid, 8), PlanarCamera(depth_of_field=1.1), RangeNoise()
    fan, arrays = BeamFan.from_camera(camera, 0.135, 8), camera_arrays(camera, noise)
    occupied = rng.random(grid.shape) < 0.1
    for _ in range(40):
        pose_id = int(rng.integers(lattice.n_poses))
        pose, stream = lattice.poses(pose_id), draw_stream(rng)
        expected, scan = empty_scan(camera, pose[:2]), empty_scan(camera, pose[:2])
        plain_camera = (arrays.beams, arrays.reach, tuple(arrays.noise))
        simulate_scan(
            occupied, tuple(grid.geometry), pose, plain_camera, stream.copy(), tuple(expected)
        )
        scan_from_lattice(
            occupied.ravel(), grid.shape, 0.135, *divmod(pose_id, 8),
            pose, fan.arrays(grid.shape[1]), arrays, stream, scan, np.zeros(1, dtype=np.uint64),
        )  # fmt: skip
        np.testing.assert_array_equal(scan.hit, expected.hit)
        np.testing.assert_allclose(scan.points, expected.points, rtol=0, atol=1e-12)
