import numpy as np
import pytest
from scipy import ndimage

from coopmap_env.core.kernels import kernel
from coopmap_env.core.random_streams import stream_state
from coopmap_env.envs.planar._starts import (
    StartBuffers,
    StartSettings,
    list_known_cells,
    sample_start_poses,
)
from coopmap_env.simulation.scenes.planar import Obstacles, PlanarWorld, Rooms, largest_free_region

SPREAD, RADIUS = 3.0, 1.5


def world_of(occupied, resolution=0.5):
    return PlanarWorld(occupied, resolution, (-1.0, 2.0), "drawn")


@kernel
def start_team(occupied, settings, stream, buffers, pose_ids, is_known):
    """Write start poses and known cells; kernels that borrow their arrays are called by others."""
    sample_start_poses(occupied, settings, stream, buffers, pose_ids)
    for pose_id in pose_ids:
        cell = pose_id // settings.n_headings
        n_known = list_known_cells(occupied, cell, settings.known_radius, buffers)
        for known in buffers.cells[:n_known]:
            is_known[known] = True


def place(world, n_robots, seed, spread=SPREAD, radius=RADIUS):
    n, resolution = world.occupied.size, world.resolution
    settings = StartSettings(12, spread / resolution, radius / resolution)
    buffers = StartBuffers.empty(world.shape, np.empty(n, dtype=np.int32))
    pose_ids, is_known = np.empty(n_robots, dtype=np.int64), np.zeros(n, dtype=bool)
    stream = stream_state(np.random.SeedSequence(seed))
    start_team(world.occupied, settings, stream, buffers, pose_ids, is_known)
    assert not buffers.marks.any()
    return tuple(pose_ids.tolist()), pose_ids // 12, np.flatnonzero(is_known)


def centers(world, cells):
    """Cell centers (n, 2) in metres from the lower corner."""
    return (np.column_stack(np.unravel_index(cells, world.shape)) + 0.5) * world.resolution


@pytest.fixture(
    params=[Obstacles(occupied_fraction=0.5, resolution=0.5), Rooms()], ids=lambda s: s.name
)
def worlds(request):
    return [request.param.world(np.random.default_rng(seed)) for seed in range(10)]


@pytest.mark.parametrize("n_robots", [1, 2, 5])
def test_robots_start_in_different_cells_of_the_largest_region_close_together(worlds, n_robots):
    for seed, world in enumerate(worlds):
        _, cells, _ = place(world, n_robots, seed)
        assert len(set(cells.tolist())) == n_robots
        assert largest_free_region(world.occupied).ravel()[cells].all()
        apart = centers(world, cells) - centers(world, cells[:1])
        assert (np.hypot(*apart.T) <= SPREAD + 1e-9).all()  # but for rounding


def test_known_cells_are_the_free_ones_around_a_start_and_none_behind_a_wall(worlds):
    for seed, world in enumerate(worlds):
        _, cells, known = place(world, 3, seed)
        every = centers(world, np.arange(world.occupied.size))
        expected = set()
        for cell in cells:
            offsets = every - centers(world, np.array([cell]))
            near = np.hypot(*offsets.T) <= RADIUS + 1e-9
            free = (near & ~world.occupied.ravel()).reshape(world.shape)
            pieces, _ = ndimage.label(free)
            expected |= set(np.flatnonzero(pieces == pieces.flat[cell]).tolist())
        assert known.tolist() == sorted(expected)


def test_the_seed_decides_all(worlds):
    world = worlds[0]
    first, _, known = place(world, 3, 7)
    again, _, known_again = place(world, 3, 7)
    assert first == again
    np.testing.assert_array_equal(known, known_again)
    assert len({place(world, 3, seed)[0] for seed in range(20)}) == 20


def test_every_cell_of_the_region_every_heading_and_every_mate_is_as_likely():
    occupied = np.ones((8, 8), dtype=bool)
    occupied[2:4, 2:4] = False
    world = world_of(occupied)
    starts = np.array([place(world, 2, seed)[0] for seed in range(2400)])
    cells, headings = np.divmod(starts, 12)
    # Four standard errors: 85 of 600 starts in a cell, 54 of 200 pairs, 77 of 400 headings.
    for robot in range(2):
        counts = np.unique(cells[:, robot], return_counts=True)[1]
        np.testing.assert_allclose(counts, 600, atol=85)
    counts = np.unique(cells, axis=0, return_counts=True)[1]
    assert len(counts) == 12
    np.testing.assert_allclose(counts, 200, atol=54)
    counts = np.bincount(headings.ravel(), minlength=12)
    np.testing.assert_allclose(counts, 400, atol=77)


def test_more_robots_than_cells_are_distributed_evenly():
    occupied = np.ones((8, 8), dtype=bool)
    occupied[3, 4:7] = False
    for seed in range(20):
        _, cells, known = place(world_of(occupied), 5, seed)
        assert sorted(np.unique(cells, return_counts=True)[1].tolist()) == [1, 2, 2]
        np.testing.assert_array_equal(known, [28, 29, 30])


@pytest.mark.parametrize("n_robots", [1, 3])
def test_a_lone_free_cell_holds_the_whole_team(n_robots):
    occupied = np.ones((8, 9), dtype=bool)
    occupied[7, 8] = False
    _, cells, known = place(world_of(occupied), n_robots, 0)
    assert cells.tolist() == [71] * n_robots
    assert known.tolist() == [71]


def test_a_radius_of_three_cells_is_that_even_if_its_division_rounds_down():
    assert 0.6 / 0.2 < 3.0
    world = world_of(np.zeros((40, 40), dtype=bool), resolution=0.2)
    # A disc of radius 3 has 29 cells, fewer at the border of the world.
    assert max(len(place(world, 1, seed, radius=0.6)[2]) for seed in range(20)) == 29


def test_without_distance_or_radius_the_team_starts_in_one_known_cell():
    _, cells, known = place(world_of(np.zeros((8, 8), dtype=bool)), 3, 0, spread=0.0, radius=0.0)
    assert len(set(cells.tolist())) == 1
    assert known.tolist() == [cells[0]]
