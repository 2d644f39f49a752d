"""What scans truly show: every cell of every beam up to the first surface, and nothing else."""

import math

import numpy as np
import pytest
from plain.ray_cells import crossed_cells

from coopmap_env.geometry import random_rotation
from coopmap_env.mapping import VoxelGrid
from coopmap_env.robots import PoseLattice
from coopmap_env.sensing import BeamFan, PlanarCamera
from coopmap_env.simulation.shown_cells import SURFACE_DEPTH, mark_depth_image, mark_planar_view

CAMERAS = [
    pytest.param(PlanarCamera(), id="default"),
    pytest.param(PlanarCamera(math.radians(90), 7.3, 64), id="one full word"),
    pytest.param(PlanarCamera(2 * math.pi, 5.0, 131), id="all around, three words"),
    pytest.param(PlanarCamera(1.0, 12.0, 1), id="one beam"),
]


def mark_planar(occupied, pose_ids, fan, mask):
    arrays = fan.arrays(occupied.shape[1])
    n_headings = len(arrays.start) - 1
    alive = np.empty(len(arrays.all_beams), dtype=np.uint64)
    cells = np.empty(arrays.max_visible_cells, dtype=np.int32)
    return sum(
        mark_planar_view(
            occupied.ravel(), occupied.shape, pose_id // n_headings, pose_id % n_headings,
            arrays, alive, cells, mask.reshape(-1),
        )
        for pose_id in pose_ids
    )  # fmt: skip


def plain_view(occupied, pose, camera):
    """Cells of each beam by clipping it with all cells, up to the first occupied one."""
    shown = set()
    for bearing in camera.bearings:
        u = [math.cos(pose[2] + bearing), math.sin(pose[2] + bearing)]
        for cell, _, _ in crossed_cells(pose[:2], u, camera.depth_of_field, occupied.shape):
            shown.add(cell)
            if occupied[cell]:
                break
    return shown


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("fraction", [0.0, 0.03, 0.2])
def test_a_planar_scan_shows_the_cells_of_its_beams_up_to_their_first_surface(camera, fraction):
    rng = np.random.default_rng(11)
    grid = VoxelGrid((23, 31))
    lattice = PoseLattice(grid, 16)
    fan = BeamFan.from_camera(camera, 1.0, 16)
    for _ in range(12):
        occupied = rng.random(grid.shape) < fraction
        pose_id = int(rng.integers(lattice.n_poses))
        mask = np.zeros(grid.shape, dtype=np.uint8)
        count = mark_planar(occupied, [pose_id], fan, mask)
        expected = plain_view(occupied, lattice.poses(pose_id), camera)
        found = set(map(tuple, np.argwhere(mask).tolist()))
        # an exact diagonal runs through corners, where rounding chooses the cells that it touches
        assert found == expected or pose_id % 2 == 0
        assert len(found ^ expected) <= (0 if pose_id % 2 else 12)
        assert count == mask.sum()


def test_scans_of_a_team_add_up_and_count_each_cell_once():
    rng = np.random.default_rng(5)
    grid = VoxelGrid((40, 40))
    fan = BeamFan.from_camera(PlanarCamera(), 1.0, 16)
    occupied = rng.random(grid.shape) < 0.05
    ids = rng.integers(40 * 40 * 16, size=30).tolist()
    union = np.zeros(grid.shape, dtype=np.uint8)
    for pose_id in ids:
        mark_planar(occupied, [pose_id], fan, union)
    mask = np.zeros(grid.shape, dtype=np.uint8)
    mask[:7] = 1
    count = mark_planar(occupied, ids, fan, mask)
    np.testing.assert_array_equal(mask[7:], union[7:])
    assert (mask[:7] == 1).all()
    assert count == mask.sum() - 7 * 40


def test_a_wall_hides_what_is_behind_it_by_hand():
    """A beam along x from the middle of cell 2 to a wall in cell 5."""
    occupied = np.zeros((12, 3), dtype=bool)
    occupied[5] = True
    camera = PlanarCamera(0.1, 8.0, 1)
    fan = BeamFan.from_camera(camera, 1.0, 4)
    mask = np.zeros((12, 3), dtype=np.uint8)
    assert mark_planar(occupied, [(2 * 3 + 1) * 4], fan, mask) == 4
    assert np.argwhere(mask).tolist() == [[2, 1], [3, 1], [4, 1], [5, 1]]


def plain_depth_image(grid, R, t, directions, distances, near, far):
    shown = set()
    origin = (t - np.array(grid.origin)) / grid.resolution
    for direction, d in zip(directions, distances, strict=True):
        if d < near:
            continue
        length = d / grid.resolution + SURFACE_DEPTH if d <= far else far / grid.resolution
        cells = crossed_cells(origin, R @ direction, length, grid.shape)
        shown |= {cell for cell, _, _ in cells}
    return shown


def test_a_depth_image_shows_the_voxels_of_its_rays():
    rng = np.random.default_rng(2)
    grid = VoxelGrid((14, 12, 10), 0.25, (-1.0, 0.5, -0.25))
    for _ in range(15):
        R = random_rotation(rng)
        t = np.array(grid.origin) + rng.uniform(0.5, 9.5, 3) * grid.resolution
        directions = rng.normal(size=(40, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        distances = rng.uniform(0.0, 3.0, 40)
        distances[::7] = np.inf
        mask = np.zeros(grid.n_cells, dtype=np.uint8)
        mark_depth_image(tuple(grid.geometry), (R, t), directions, distances, 0.3, 2.5, mask)
        expected = plain_depth_image(grid, R, t, directions, distances, 0.3, 2.5)
        found = set(map(tuple, np.argwhere(mask.reshape(grid.shape)).tolist()))
        assert found == expected


def test_a_camera_outside_of_the_grid_shows_what_its_rays_cross_in_it():
    """From all sides; the mask lies in a larger array, of which nothing else may change."""
    rng = np.random.default_rng(4)
    grid = VoxelGrid((6, 7, 5), 0.25, (-1.0, 0.5, -0.25))
    low, size = np.array(grid.origin), np.array(grid.shape) * grid.resolution
    n_shown = 0
    for side in range(60):
        R, t = random_rotation(rng), low + rng.uniform(0.0, 1.0, 3) * size
        axis = side % 3
        t[axis] = low[axis] + (-0.4 if side % 2 else size[axis] + 0.4)
        directions = rng.normal(size=(60, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        distances = rng.uniform(0.3, 2.5, 60)
        padded = np.full(3 * grid.n_cells, 7, dtype=np.uint8)
        mask = padded[grid.n_cells : 2 * grid.n_cells]
        mask[:] = 0
        mark_depth_image(tuple(grid.geometry), (R, t), directions, distances, 0.3, 2.5, mask)
        assert (padded[: grid.n_cells] == 7).all()
        assert (padded[2 * grid.n_cells :] == 7).all()
        expected = plain_depth_image(grid, R, t, directions, distances, 0.3, 2.5)
        found = set(map(tuple, np.argwhere(mask.reshape(grid.shape)).tolist()))
        assert found == expected
        n_shown += len(found)
    assert n_shown > 1000


@pytest.mark.parametrize("x", [1.0, 1.25, -0.25])
def test_by_hand_a_camera_outside_that_looks_at_the_grid_or_away(x):
    grid = VoxelGrid((10, 1, 1), 0.1)
    for way in (1.0, -1.0):
        mask = np.zeros(10, dtype=np.uint8)
        pose, ahead = (np.eye(3), np.array([x, 0.05, 0.05])), np.array([[way, 0.0, 0.0]])
        mark_depth_image(tuple(grid.geometry), pose, ahead, np.array([np.inf]), 0.1, 5.0, mask)
        looks_at_it = (way > 0) == (x < 0)
        assert mask.tolist() == [int(looks_at_it)] * 10


def test_a_surface_in_the_face_of_a_voxel_counts_for_the_voxel_behind_it():
    grid = VoxelGrid((10, 1, 1), 0.1)
    mask = np.zeros(10, dtype=np.uint8)
    ahead, pose = np.array([[1.0, 0.0, 0.0]]), (np.eye(3), np.array([0.05, 0.05, 0.05]))
    mark_depth_image(tuple(grid.geometry), pose, ahead, np.array([0.35]), 0.01, 5.0, mask)
    assert np.flatnonzero(mask).tolist() == [0, 1, 2, 3, 4]


@pytest.mark.parametrize(
    ("distance", "shown"), [(0.09, []), (0.1, [0, 1]), (0.5, range(6)), (0.51, range(6))]
)
def test_surfaces_out_of_the_range_of_a_camera_by_hand(distance, shown):
    """Nearer than `near` hides all; beyond `far`, the ray is free up to there."""
    grid = VoxelGrid((10, 1, 1), 0.1)
    mask = np.zeros(10, dtype=np.uint8)
    ahead, pose = np.array([[1.0, 0.0, 0.0]]), (np.eye(3), np.array([0.05, 0.05, 0.05]))
    mark_depth_image(tuple(grid.geometry), pose, ahead, np.array([distance]), 0.1, 0.5, mask)
    assert np.flatnonzero(mask).tolist() == list(shown)
