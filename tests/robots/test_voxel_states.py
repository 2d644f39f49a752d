import numpy as np
import pytest
from plain.kinematics import sphere_state
from scipy.ndimage import distance_transform_edt

from coopmap_env.mapping import FREE_LOG_ODDS_FIXED, OccupancyMap, VoxelGrid
from coopmap_env.robots import VoxelStates, are_spheres_free
from coopmap_env.robots.collision.voxel_states import FREE, OCCUPIED, OUTSIDE, UNKNOWN


def scattered(rng, shape=(24, 20, 16), fraction=0.02):
    map_ = OccupancyMap(VoxelGrid(shape, 0.1, (-1.0, -0.7, -0.3)))
    cells = rng.permutation(map_.grid.n_cells)
    blocked = int(fraction * len(cells))
    map_.mark_free(cells[blocked:])
    map_.mark_occupied(cells[: blocked // 2])
    return map_


def test_by_hand_a_sphere_is_clear_up_to_the_face_of_a_voxel():
    map_ = OccupancyMap(VoxelGrid((10, 10, 10), 0.1))
    map_.mark_free(np.arange(1000))
    map_.mark_occupied(map_.grid.flat_index([5, 5, 5]))  # from 0.5 to 0.6
    around = VoxelStates.from_map(map_, (0.5, 0.5, 0.5), 0.6)
    assert around.sphere_states([0.35, 0.55, 0.55], 0.149) == FREE
    assert around.sphere_states([0.35, 0.55, 0.55], 0.151) == OCCUPIED
    corner = 0.1 * np.sqrt(3)  # across to the voxel's corner at (0.5, 0.5, 0.5)
    assert around.sphere_states([0.4, 0.4, 0.4], corner - 1e-6) == FREE
    assert around.sphere_states([0.4, 0.4, 0.4], corner + 1e-6) == OCCUPIED


def test_by_hand_unknown_is_blocked_and_so_is_all_beyond_the_map():
    map_ = OccupancyMap(VoxelGrid((10, 10, 10), 0.1))
    around = VoxelStates.from_map(map_, (0.5, 0.5, 0.5), 0.7)
    assert around.sphere_states([0.55, 0.55, 0.55], 0.01) == UNKNOWN
    map_.mark_free(np.arange(1000))
    around = VoxelStates.from_map(map_, (0.5, 0.5, 0.5), 0.7)
    assert around.sphere_states([0.15, 0.55, 0.55], 0.14) == FREE
    assert around.sphere_states([0.15, 0.55, 0.55], 0.16) == OUTSIDE
    assert around.sphere_states([9.0, 0.55, 0.55], 0.1) == OUTSIDE


def test_a_cell_is_free_as_in_the_plane_below_5_percent():
    map_ = OccupancyMap(VoxelGrid((3, 3, 3), 0.1))
    map_.mark_free(np.arange(27))
    for level, state in ((FREE_LOG_ODDS_FIXED - 1, FREE), (FREE_LOG_ODDS_FIXED, OCCUPIED)):
        map_.log_odds_fixed[13] = level
        assert (
            VoxelStates.from_map(map_, (0.15,) * 3, 0.15).sphere_states([0.15] * 3, 0.01) == state
        )


def test_spheres_meet_what_the_plain_reference_says():
    rng = np.random.default_rng(0)
    for _ in range(5):
        map_ = scattered(rng, fraction=rng.choice([0.01, 0.1, 0.6]))
        around = VoxelStates.from_map(map_, rng.uniform(-0.5, 0.5, 3), 2.5)
        centers, radii = rng.uniform(-1.2, 1.4, (60, 3)), rng.uniform(0.01, 0.35, 60)
        wanted = [
            sphere_state(map_, c, r, FREE_LOG_ODDS_FIXED)
            for c, r in zip(centers, radii, strict=True)
        ]
        np.testing.assert_array_equal(around.sphere_states(centers, radii), wanted)


def test_clearness_agrees_with_scipys_distances_within_half_a_voxels_diagonal():
    """Distances between voxels' centers bound that of a center from a voxel's box on both sides."""
    rng = np.random.default_rng(1)
    map_ = scattered(rng)
    grid = map_.grid
    blocked = (map_.log_odds_fixed >= FREE_LOG_ODDS_FIXED) | (map_.sampled_mask == 0)
    padded = np.pad(blocked.reshape(grid.shape), 1, constant_values=True)
    distance = 0.1 * distance_transform_edt(~padded)[1:-1, 1:-1, 1:-1]
    index = np.stack(np.nonzero(distance > 0), axis=-1)
    index = index[rng.permutation(len(index))[:400]]
    around = VoxelStates.from_map(map_, (0.2, 0.3, 0.5), 2.5)
    half = 0.05 * np.sqrt(3)
    d = distance[tuple(index.T)]
    assert (around.sphere_states(grid.center(index), d - half - 1e-9) == FREE).all()
    assert (around.sphere_states(grid.center(index), d) != FREE).all()


def test_sets_of_spheres_are_clear_if_each_one_is():
    map_ = OccupancyMap(VoxelGrid((10, 10, 10), 0.1))
    map_.mark_free(np.arange(1000))
    map_.mark_occupied(0)
    around = VoxelStates.from_map(map_, (0.5, 0.5, 0.5), 0.5)
    centers = np.array([[[0.5, 0.5, 0.5], [0.7, 0.7, 0.7]], [[0.5, 0.5, 0.5], [0.18, 0.12, 0.12]]])
    np.testing.assert_array_equal(are_spheres_free(around, centers, [0.1, 0.1]), [True, False])
    np.testing.assert_array_equal(
        are_spheres_free(around, centers, [0.1, 0.1], 0.15), [True, False]
    )
    np.testing.assert_array_equal(
        are_spheres_free(around, centers, [0.1, 0.1], 0.25), [False, False]
    )


def test_arguments_are_checked():
    flat = OccupancyMap(VoxelGrid((10, 10)))
    with pytest.raises(ValueError, match=r"3-D map, got the grid \(10, 10\)"):
        VoxelStates.from_map(flat, (0, 0, 0), 1)
    map_ = OccupancyMap(VoxelGrid((4, 4, 4)))
    with pytest.raises(ValueError, match="reach must be finite and > 0, got -1"):
        VoxelStates.from_map(map_, (0, 0, 0), -1)
    with pytest.raises(ValueError, match="center must be three finite values"):
        VoxelStates.from_map(map_, (0, 0), 1)
