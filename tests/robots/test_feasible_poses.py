"""Regions that a team reaches, kept up to date, and random poses in them."""

import math

import numpy as np
import pytest
from plain.random_maps import random_map
from scipy import stats

from coopmap_env.core.random_streams import draw_stream
from coopmap_env.mapping import OccupancyMap, VoxelGrid
from coopmap_env.robots import PoseLattice, ReachableCells, free_mask
from coopmap_env.robots.planar.feasible_poses import (
    PoseSampling,
    picked_size,
    sample_feasible_poses,
    write_feasible_cells,
)
from coopmap_env.robots.planar.reachable_regions import (
    RegionArrays,
    find_regions,
    is_reachable,
    update_regions,
)

N_HEADINGS = 8


def plain_reachable(map_, start):
    """Cells that a breadth-first search from the start finds."""
    return set(ReachableCells.search(map_, start).cells.tolist())


def reachable(regions, map_, robot, start):
    return {c for c in range(map_.grid.n_cells) if is_reachable(regions, robot, start, c)}


def assert_regions(regions, map_, poses):
    for robot, pose in enumerate(poses):
        start = int(pose) // N_HEADINGS
        assert reachable(regions, map_, robot, start) == plain_reachable(map_, start)
    assert free_mask(map_)[regions.labels != 0].all()


def test_a_robot_in_a_free_cell_reaches_the_region_of_it():
    map_ = OccupancyMap(VoxelGrid((3, 8)))
    map_.mark_free(np.arange(24))
    map_.mark_occupied([3, 11, 19])
    regions, poses = RegionArrays.empty(24, 2), np.array([0, 5]) * N_HEADINGS
    find_regions(map_.arrays, poses, N_HEADINGS, regions)
    assert reachable(regions, map_, 0, 0) == {0, 1, 2, 8, 9, 10, 16, 17, 18}
    assert_regions(regions, map_, poses)


def test_a_robot_in_a_cell_that_is_not_free_reaches_the_regions_around_it():
    map_ = OccupancyMap(VoxelGrid((1, 9)))
    map_.mark_free(np.arange(9))
    map_.mark_occupied([4])
    poses = np.array([4, 0, 7]) * N_HEADINGS
    regions = RegionArrays.empty(9, 3)
    find_regions(map_.arrays, poses, N_HEADINGS, regions)
    assert reachable(regions, map_, 0, 4) == set(range(9))
    assert reachable(regions, map_, 1, 0) == {0, 1, 2, 3}
    assert reachable(regions, map_, 2, 7) == {5, 6, 7, 8}


@pytest.mark.parametrize("n_robots", [1, 3])
def test_regions_kept_up_to_date_are_those_of_a_new_search(n_robots):
    rng = np.random.default_rng(4)
    outcomes = {"lost": 0, "grown": 0}
    for _ in range(12):
        map_ = random_map(rng, (14, 11), unknown=0.7, occupied=0.1)
        regions = RegionArrays.empty(map_.grid.n_cells, n_robots)
        starts = rng.integers(map_.grid.n_cells, size=n_robots)
        poses = starts * N_HEADINGS
        find_regions(map_.arrays, poses, N_HEADINGS, regions)
        assert_regions(regions, map_, poses)
        for _ in range(25):
            before = free_mask(map_)
            cells = rng.integers(map_.grid.n_cells, size=rng.integers(1, 12))
            marked_free = rng.random(len(cells)) < 0.85
            map_.mark_free(cells[marked_free])
            map_.mark_occupied(cells[~marked_free])
            outcomes["lost"] += bool((before & ~free_mask(map_)).any())
            outcomes["grown"] += bool((free_mask(map_) & ~before).any())
            for robot in range(n_robots):  # somewhere that it reaches, or where it is
                start = int(poses[robot]) // N_HEADINGS
                goals = sorted(plain_reachable(map_, start))
                poses[robot] = rng.choice(goals) * N_HEADINGS
            update_regions(map_.arrays, cells, len(cells), poses, N_HEADINGS, regions)
            assert_regions(regions, map_, poses)
    assert min(outcomes.values()) > 50


def sampler(map_, reach, poses):
    lattice = PoseLattice(map_.grid, N_HEADINGS)
    regions = RegionArrays.empty(map_.grid.n_cells, len(poses))
    find_regions(map_.arrays, poses, N_HEADINGS, regions)
    return PoseSampling(lattice.geometry, map_.grid.shape_3d, reach), regions, lattice


def sample(sampling, regions, pose, m, rng):
    out = np.full(m, -1)
    picked = np.empty(picked_size(m), dtype=np.int64)
    n = sample_feasible_poses(pose, 0, sampling, regions, draw_stream(rng), picked, out)
    assert (out[n:] == -1).all() or n == m
    return out[:n]


@pytest.mark.parametrize("resolution", [1.0, 0.3])
def test_feasible_cells_are_the_reachable_ones_in_a_square_around_the_camera(resolution):
    rng = np.random.default_rng(0)
    grid = VoxelGrid((17, 23), resolution, (-4.0, 2.0))
    for _ in range(30):
        map_ = OccupancyMap(grid)
        map_.mark_free(np.flatnonzero(rng.random(grid.n_cells) < 0.8))
        pose = int(rng.integers(grid.n_cells * N_HEADINGS))
        reach = float(rng.uniform(0.5, 12.0)) * resolution
        sampling, regions, lattice = sampler(map_, reach, np.array([pose]))
        out = np.empty(grid.n_cells, dtype=np.int32)
        n = write_feasible_cells(pose, 0, sampling, regions, out)
        x, y, heading = lattice.pose(pose)
        expected = []
        for cell in sorted(plain_reachable(map_, pose // N_HEADINGS)):
            cx, cy, _ = lattice.pose(cell * N_HEADINGS)
            ahead = math.cos(heading) * (cx - x) + math.sin(heading) * (cy - y)
            left = math.cos(heading) * (cy - y) - math.sin(heading) * (cx - x)
            if max(abs(ahead), abs(left)) <= reach * (1 + 1e-9):
                expected.append(cell)
        assert out[:n].tolist() == expected


def test_cells_ahead_or_to_a_side_by_hand():
    map_ = OccupancyMap(VoxelGrid((5, 3), 0.5))
    map_.mark_free(np.arange(15))

    def feasible(pose, reach):
        sampling, regions, _ = sampler(map_, reach, np.array([pose]))
        out = np.empty(15, dtype=np.int32)
        return out[: write_feasible_cells(pose, 0, sampling, regions, out)].tolist()

    # from cell (2, 1), facing +y: one cell of 0.5 m ahead and back, and to both sides
    assert feasible(7 * 8 + 2, 0.5) == list(range(3, 12))
    assert feasible(7 * 8 + 2, 0.49) == [7]
    # an eighth of a turn: the corners of the square are 0.71 m ahead or to a side
    assert feasible(7 * 8 + 1, 0.5) == [4, 6, 7, 8, 10]


@pytest.mark.parametrize(("free", "m"), [(1.0, 5), (0.6, 20), (0.03, 20), (0.03, 500)])
def test_samples_are_different_feasible_poses_as_many_as_there_are(free, m):
    rng = np.random.default_rng(6)
    grid = VoxelGrid((19, 19))
    for _ in range(20):
        map_ = OccupancyMap(grid)
        map_.mark_free(np.flatnonzero(rng.random(grid.n_cells) < free))
        pose = (9 * 19 + 9) * N_HEADINGS + int(rng.integers(N_HEADINGS))
        sampling, regions, _ = sampler(map_, 6.0, np.array([pose]))
        cells = np.empty(grid.n_cells, dtype=np.int32)
        n_cells = write_feasible_cells(pose, 0, sampling, regions, cells)
        poses = sample(sampling, regions, pose, m, rng)
        assert len(poses) == min(m, n_cells * N_HEADINGS)
        assert len(np.unique(poses)) == len(poses)
        assert np.isin(poses // N_HEADINGS, cells[:n_cells]).all()


@pytest.mark.parametrize("m", [1, 3, 11])
def test_every_feasible_pose_is_as_likely_in_every_place(m):
    """A ring of a few cells in a large square: most tries fail, and the list serves as well."""
    rng = np.random.default_rng(8)
    map_ = OccupancyMap(VoxelGrid((15, 15)))
    cells = [7 * 15 + 7, 7 * 15 + 8]
    map_.mark_free(cells)
    pose = cells[0] * N_HEADINGS
    sampling, regions, _ = sampler(map_, 7.0, np.array([pose]))
    n_samples = 4000
    counts = np.zeros((m, 15 * 15 * N_HEADINGS), dtype=np.int64)
    for _ in range(n_samples):
        poses = sample(sampling, regions, pose, m, rng)
        counts[np.arange(m), poses] += 1
    feasible = (np.array(cells)[:, None] * N_HEADINGS + np.arange(N_HEADINGS)).ravel()
    for place in range(m):
        assert stats.chisquare(counts[place, feasible]).pvalue > 1e-4


def test_samples_of_the_open_square_are_uniform():
    rng = np.random.default_rng(9)
    map_ = OccupancyMap(VoxelGrid((9, 9)))
    map_.mark_free(np.arange(81))
    pose = 40 * N_HEADINGS + 1  # 45 degrees
    sampling, regions, _ = sampler(map_, 2.0, np.array([pose]))
    cells = np.empty(81, dtype=np.int32)
    n = write_feasible_cells(pose, 0, sampling, regions, cells)
    assert n == 13  # |i + j| and |i - j| at most 2 sqrt(2): 2.83
    counts = np.zeros(81 * N_HEADINGS, dtype=np.int64)
    for _ in range(6000):
        counts[sample(sampling, regions, pose, 4, rng)] += 1
    feasible = (cells[:n, None].astype(int) * N_HEADINGS + np.arange(N_HEADINGS)).ravel()
    assert stats.chisquare(counts[feasible]).pvalue > 1e-4


def test_an_unknown_map_leaves_the_own_cell():
    map_ = OccupancyMap(VoxelGrid((9, 9)))
    sampling, regions, _ = sampler(map_, 3.0, np.array([40 * N_HEADINGS]))
    poses = sample(sampling, regions, 40 * N_HEADINGS, 20, np.random.default_rng(0))
    assert sorted(poses.tolist()) == list(range(40 * N_HEADINGS, 41 * N_HEADINGS))
