"""The discrete configuration space: cells times headings."""

import math

import numpy as np
import pytest

from coopmap_env.mapping import VoxelGrid
from coopmap_env.robots import PoseLattice

LATTICE = PoseLattice(VoxelGrid((5, 3), 0.5, (-1.0, 2.0)), n_headings=8)
LATTICES = [
    LATTICE,
    PoseLattice(VoxelGrid((4, 9))),
    PoseLattice(VoxelGrid((3, 3), 0.1, (0.3, -0.7)), n_headings=7),
    PoseLattice(VoxelGrid((2, 6), 3.0), n_headings=1),
]


def test_a_pose_number_is_its_cell_times_the_headings_plus_the_heading():
    # cell (2, 1) has flat index 7; heading 2 of 8 is a quarter turn
    pose_id = 7 * 8 + 2
    assert LATTICE.poses(pose_id) == pytest.approx([0.25, 2.75, math.pi / 2])
    assert LATTICE.pose(pose_id) == pytest.approx((0.25, 2.75, math.pi / 2))
    assert LATTICE.n_poses == 120


def test_headings_lie_in_one_turn_and_begin_with_the_x_axis():
    headings = np.degrees(LATTICE.poses(np.arange(8))[:, 2])
    assert headings == pytest.approx([0, 45, 90, 135, -180, -135, -90, -45])


@pytest.mark.parametrize("lattice", LATTICES)
def test_every_pose_is_nearest_to_itself(lattice):
    ids = np.arange(lattice.n_poses)
    poses = lattice.poses(ids)
    assert (poses[:, 2] >= -math.pi).all()
    assert (poses[:, 2] < math.pi).all()
    assert [lattice.nearest_pose_id(tuple(pose)) for pose in poses.tolist()] == ids.tolist()
    assert [lattice.pose(int(k)) for k in ids] == [tuple(pose) for pose in poses.tolist()]


@pytest.mark.parametrize("lattice", LATTICES)
def test_the_nearest_pose_is_that_of_the_least_distance_and_turn(lattice):
    rng = np.random.default_rng(0)
    grid = lattice.grid
    poses = lattice.poses(np.arange(lattice.n_poses))
    for _ in range(100):
        x, y = np.array(grid.origin) + rng.uniform(0, 1, 2) * grid.shape * grid.resolution
        heading = rng.uniform(-20, 20)
        distance = np.hypot(poses[:, 0] - x, poses[:, 1] - y)
        turn = np.abs(np.angle(np.exp(1j * (poses[:, 2] - heading))))
        # a lattice of square cells: position and heading are decided apart
        best = np.lexsort((turn, distance.round(9)))[0]
        assert lattice.nearest_pose_id((x, y, heading)) == best


def test_poses_keep_the_shape_of_the_numbers():
    assert LATTICE.poses(np.zeros((2, 4), dtype=int)).shape == (2, 4, 3)
    assert LATTICE.poses([]).shape == (0, 3)


@pytest.mark.parametrize("position", [(-1.01, 2.5), (0.0, 1.99), (1.5, 2.5), (0.0, 3.5)])
def test_a_pose_outside_the_grid_has_no_nearest(position):
    assert LATTICE.nearest_pose_id((*position, 0.0)) == -1


@pytest.mark.parametrize("outside", [-1, LATTICE.n_poses, 2**40, -(2**63)])
def test_a_number_that_is_no_pose_is_named(outside):
    with pytest.raises(ValueError, match=rf"0 \.\.\. {LATTICE.n_poses - 1}, .*, got {outside}: "):
        LATTICE.checked_ids([[0, 1], [outside, -7]])


@pytest.mark.parametrize("ids", [[0.5], [True], ["0"], [2**70], np.array([2.0])])
def test_pose_ids_are_integers(ids):
    with pytest.raises(ValueError, match="pose ids must be integers, got"):
        LATTICE.checked_ids(ids)


def test_checked_ids_keep_their_shape():
    for ids in ([], 3, [[0, 1], [2, LATTICE.n_poses - 1]]):
        found = LATTICE.checked_ids(ids)
        assert found.dtype == np.int64
        np.testing.assert_array_equal(found, ids)


def test_a_lattice_needs_a_planar_grid_and_a_heading():
    with pytest.raises(ValueError, match="planar"):
        PoseLattice(VoxelGrid((3, 3, 3)))
    with pytest.raises(ValueError, match="n_headings"):
        PoseLattice(VoxelGrid((3, 3)), n_headings=0)
