"""What unknown cells are expected to be, by their distance to the known surface."""

import numpy as np
import pytest
from plain.random_maps import set_cells

from coopmap_env.information import near_surface_hazards, near_surface_weights
from coopmap_env.information.near_surface import HAZARDS, NEAR_SURFACE
from coopmap_env.mapping import OccupancyMap, VoxelGrid


def test_weights_fall_with_the_distance_from_the_known_surface():
    map_ = OccupancyMap(VoxelGrid((20, 3, 3)))
    cells = np.arange(180).reshape(20, 3, 3)
    set_cells(map_, cells[0, 0, 0], 0.9)
    set_cells(map_, cells[19, 2, 2], 0.3)  # known, and free
    weights = near_surface_weights(map_).reshape(20, 3, 3)
    far = [NEAR_SURFACE[-1]] * 4  # the table ends after 15 voxels
    np.testing.assert_array_equal(weights[:, 0, 0], np.float32([0, *NEAR_SURFACE, *far]))
    # the longest of dx, dy and dz counts
    np.testing.assert_array_equal(weights[2:, 2, 1], np.float32([*NEAR_SURFACE[1:], *far]))
    assert weights[0, 2, 1] == np.float32(NEAR_SURFACE[1])


def test_without_a_known_surface_all_voxels_are_alike():
    map_ = OccupancyMap(VoxelGrid((4, 4, 4)))
    np.testing.assert_array_equal(near_surface_weights(map_), np.float32(NEAR_SURFACE[-1]))


def test_hazards_fall_with_the_distance_from_the_known_surface():
    map_ = OccupancyMap(VoxelGrid((8, 2)))
    set_cells(map_, 0, 0.9)
    hazards = near_surface_hazards(map_).reshape(8, 2)
    np.testing.assert_array_equal(
        hazards[:, 0], np.float32([0, *HAZARDS, HAZARDS[-1], HAZARDS[-1]])
    )
    assert hazards[1, 1] == np.float32(HAZARDS[0])  # across the corner it is one step


def test_maps_of_the_other_dimension_are_refused():
    with pytest.raises(ValueError, match=r"this one is planar: choose lookahead"):
        near_surface_weights(OccupancyMap(VoxelGrid((4, 4))))
    with pytest.raises(ValueError, match=r"this one has three dimensions: choose near_surface_we"):
        near_surface_hazards(OccupancyMap(VoxelGrid((4, 4, 4))))
