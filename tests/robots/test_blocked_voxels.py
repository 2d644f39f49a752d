"""Blocked voxels as bits: the same answers as from the voxels' states."""

import numpy as np
import pytest
from scipy.ndimage import distance_transform_cdt

from coopmap_env.mapping import OccupancyMap, VoxelGrid
from coopmap_env.robots import VoxelStates
from coopmap_env.robots.collision.blocked_voxels import (
    N_LEVELS,
    BlockedVoxels,
    free_distance,
    is_sphere_blocked,
)
from coopmap_env.robots.collision.voxel_states import sphere_state


def scattered(rng, shape, fraction):
    map_ = OccupancyMap(VoxelGrid(shape, 0.1, (-1.0, -0.7, -0.3)))
    cells = rng.permutation(map_.grid.n_cells)
    blocked = int(fraction * len(cells))
    map_.mark_free(cells[blocked:])
    map_.mark_occupied(cells[: blocked // 2])  # the others are unknown
    return map_


def test_by_hand_the_distance_and_the_bits_around_one_blocked_voxel():
    map_ = OccupancyMap(VoxelGrid((30, 30, 30), 0.1))
    map_.mark_free(np.arange(map_.grid.n_cells))
    map_.mark_occupied(map_.grid.flat_index([15, 15, 15]))
    blocked = BlockedVoxels.from_map(map_, (1.5, 1.5, 1.5), 1.44)  # all 30 but one on each side
    assert free_distance(blocked, 15.5, 15.5, 15.5) == -1
    assert free_distance(blocked, 5.5, 15.5, 15.5) == 0  # not known yet
    blocked.find_distances()
    assert blocked.words.shape == (30, 30, 1, N_LEVELS)
    assert blocked.words[15, 15, 0, 0] == (1 << 15) | ~np.uint64((1 << 30) - 1)
    assert blocked.words[16, 15, 0, 1] == (0b111 << 14) | 1 | ~np.uint64((1 << 29) - 1)
    for offset, distance in ((0, -1), (1, 0), (2, 1), (7, 6), (8, 7)):
        assert free_distance(blocked, 15.5 - offset, 15.5, 15.5) == distance
    assert free_distance(blocked, 15.5, 0.5, 15.5) == 0  # the edge of the box
    assert free_distance(blocked, -0.5, 15.5, 15.5) == -1
    assert not is_sphere_blocked(blocked, 13.5, 15.5, 15.5, 1.49)
    assert is_sphere_blocked(blocked, 13.5, 15.5, 15.5, 1.51)
    assert not is_sphere_blocked(blocked, 15.5, 15.5, 13.5, 1.49)
    assert is_sphere_blocked(blocked, 15.5, 15.5, 13.5, 1.51)
    assert is_sphere_blocked(blocked, 15.5, 15.5, 1.0, 1.01)  # beyond the box


@pytest.mark.parametrize("fraction", [0.0, 0.003, 0.02, 0.6])
@pytest.mark.parametrize("shape", [(24, 20, 16), (14, 12, 150)])  # one word and several a column
def test_random_spheres_and_points_agree_with_the_states_of_the_voxels(fraction, shape):
    rng = np.random.default_rng(0)
    map_ = scattered(rng, shape, fraction)
    middle = np.array(map_.grid.origin) + 0.05 * np.array(shape)
    reach = 0.04 * max(shape)
    states = VoxelStates.from_map(map_, middle, reach)
    blocked = BlockedVoxels.from_map(map_, middle, reach)
    blocked.find_distances()
    n = 3000
    size = np.array(states.states.shape)
    points = rng.uniform(-0.05, 1.05, (n, 3)) * size
    points[: n // 3] = np.round(points[: n // 3] * 2) / 2  # on faces and in middles
    radii = rng.uniform(0.05, 4.0, n)
    radii[: n // 3] = np.round(radii[: n // 3] * 2) / 2
    found = [is_sphere_blocked(blocked, *p, r) for p, r in zip(points, radii, strict=True)]
    wanted = [sphere_state(states.states, *p, r) > 0 for p, r in zip(points, radii, strict=True)]
    np.testing.assert_array_equal(found, wanted)
    padded = np.pad(states.states == 0, 1)
    chessboard = distance_transform_cdt(padded, "chessboard")[1:-1, 1:-1, 1:-1]
    index = np.floor(points).astype(int)
    within = ((index >= 0) & (index < size)).all(axis=1)
    distance = np.array([free_distance(blocked, *p) for p in points])
    expected = np.minimum(chessboard[tuple(index[within].T)], N_LEVELS) - 1
    np.testing.assert_array_equal(distance[within], expected)
    assert (distance[~within] == -1).all()
