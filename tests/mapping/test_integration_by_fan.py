"""Fusing a scan from the lattice by the camera's fan equals following each of its beams."""

import numpy as np
import pytest

from coopmap_env.core.random_streams import draw_stream
from coopmap_env.mapping import BeamModel, OccupancyMap, VoxelGrid
from coopmap_env.mapping.arrays import UpdateBuffers
from coopmap_env.mapping.integration_fan import integrate_lattice_scan
from coopmap_env.mapping.integration_scalar import allocate_beam, integrate_rays
from coopmap_env.robots import PoseLattice
from coopmap_env.sensing import BeamFan, PlanarCamera, RangeNoise, ScanArrays
from coopmap_env.simulation.planar import camera_arrays
from coopmap_env.simulation.planar_scans import scan_from_lattice


def updates(buffers, count, n_cells):
    """Sum of the updates of each cell; none is listed twice."""
    cells = buffers.updated_cells[:count]
    assert len(np.unique(cells)) == count
    out = np.zeros(n_cells, dtype=np.int64)
    out[cells] = buffers.pending[cells]
    assert np.count_nonzero(buffers.pending) == count
    return out


@pytest.mark.parametrize(
    "camera",
    [
        pytest.param(PlanarCamera(), id="default"),
        # an even number, not a whole turn: no beam along a diagonal, where roundings decide
        pytest.param(PlanarCamera(6.2, 9.0, 132), id="almost all around, three words"),
    ],
)
@pytest.mark.parametrize(
    "model",
    [
        pytest.param(BeamModel(), id="v0"),
        pytest.param(BeamModel(free=0.0003, occupied=0.9995, behind=0.93), id="v1"),
        pytest.param(BeamModel(surface="anywhere"), id="anywhere"),
    ],
)
def test_fusing_by_the_fan_equals_following_each_beam(camera, model):
    rng = np.random.default_rng(1)
    grid = VoxelGrid((41, 33))
    lattice = PoseLattice(grid, 16)
    fan = BeamFan.from_camera(camera, grid.resolution, lattice.n_headings).arrays(grid.shape[1])
    arrays = camera_arrays(camera, RangeNoise())
    n = camera.n_beams
    n_mixed = 0
    for _ in range(60):
        occupied = rng.random(grid.n_cells) < rng.choice([0.0, 0.01, 0.1])
        pose_id = int(rng.integers(lattice.n_poses))
        pose, (cell, heading) = lattice.poses(pose_id), divmod(pose_id, lattice.n_headings)
        scan = ScanArrays(pose[:2], np.empty((n, 2)), np.empty((n, 2, 2)), np.empty(n, np.bool_))
        free_beams = np.zeros(len(fan.all_beams), dtype=np.uint64)
        scan_from_lattice(
            occupied, grid.shape, 1.0, cell, heading, pose, fan, arrays, draw_stream(rng),
            scan, free_beams,
        )  # fmt: skip
        expected, expected_hits = UpdateBuffers.empty(grid.n_cells), np.empty(n, np.int64)
        scratch = allocate_beam(grid.shape_3d, 2)
        count = integrate_rays(
            scan, grid.geometry, model.parameters, scratch, expected, expected_hits
        )
        buffers, hits = UpdateBuffers.empty(grid.n_cells), np.full(n, 7)
        mine = integrate_lattice_scan(
            scan, cell, heading, fan, free_beams, grid.geometry, model.parameters,
            allocate_beam(grid.shape_3d, 2), buffers, hits,
        )  # fmt: skip
        np.testing.assert_array_equal(
            updates(buffers, mine, grid.n_cells), updates(expected, count, grid.n_cells)
        )
        np.testing.assert_array_equal(hits, expected_hits)
        n_mixed += 0 < scan.hit.sum() < n
    assert n_mixed > 5


def test_a_map_of_the_fans_updates_knows_what_the_camera_saw():
    """By hand: one beam along x, a wall four cells away; free before it, occupied in it."""
    grid = VoxelGrid((12, 9))
    lattice, camera = PoseLattice(grid, 4), PlanarCamera(1.0, 6.0, 1)
    fan = BeamFan.from_camera(camera, 1.0, 4).arrays(9)
    occupied = np.zeros(grid.shape, dtype=np.bool_)
    occupied[6, :] = True
    cell, n = int(grid.flat_index([2, 4])), 1
    pose = lattice.poses(cell * 4)
    scan = ScanArrays(pose[:2], np.empty((n, 2)), np.empty((n, 2, 2)), np.empty(n, np.bool_))
    free_beams = np.zeros(1, dtype=np.uint64)
    scan_from_lattice(
        occupied.ravel(), grid.shape, 1.0, cell, 0, pose, fan,
        camera_arrays(camera, RangeNoise(intrinsic=0.0)), draw_stream(np.random.default_rng(0)),
        scan, free_beams,
    )  # fmt: skip
    np.testing.assert_array_equal(scan.points, [[6.0, 4.5]])
    map_, hits = OccupancyMap(grid), np.empty(1, np.int64)
    buffers = UpdateBuffers.empty(grid.n_cells)
    count = integrate_lattice_scan(
        scan, cell, 0, fan, free_beams, grid.geometry, map_.model.parameters,
        allocate_beam(grid.shape_3d, 2), buffers, hits,
    )  # fmt: skip
    update = updates(buffers, count, grid.n_cells).reshape(grid.shape)
    assert (update[2:6, 4] < 0).all()
    assert update[6, 4] > 0
    assert np.count_nonzero(update) == 5
    assert hits.tolist() == [grid.flat_index([6, 4])]
