import math

import numpy as np

from coopmap_env.envs.field._initial_knowledge import initial_free_voxels
from coopmap_env.envs.field._map_crop import Crop, write_crop
from coopmap_env.geometry import Pose
from coopmap_env.mapping import OccupancyMap, VoxelGrid

GRID = VoxelGrid((20, 16, 8), 0.1, (-1.0, -0.8, -0.25))


def base(x, y, heading):
    c, s = math.cos(heading), math.sin(heading)
    return Pose(np.array([x, y, 0.0]), np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]))


def plain_crop(map_, pose, cells, fit):
    """The same crop, cell by cell and voxel by voxel."""
    (side, height), grid = cells, map_.grid
    resolution = fit * grid.resolution
    out = np.zeros((2 * height, side, side), dtype=np.uint8)
    for z, i, j in np.ndindex(height, side, side):
        probabilities = []
        for a, b, c in np.ndindex(fit, fit, fit):
            ahead = (i - side / 2) * resolution + (b + 0.5) * resolution / fit
            left = (j - side / 2) * resolution + (c + 0.5) * resolution / fit
            up = z * resolution + (a + 0.5) * resolution / fit + grid.origin[2]
            at = pose.transform([ahead, left, 0.0])
            index = grid.index([at[0], at[1], up])
            if grid.contains(index) and map_.sampled[tuple(index)]:
                probabilities.append(map_.probability[tuple(index)])
        out[z, i, j] = round(255 * max(probabilities)) if probabilities else 128
        out[height + z, i, j] = 255 * len(probabilities) // fit**3
    return out


def test_the_crop_equals_a_voxel_by_voxel_lookup():
    rng = np.random.default_rng(0)
    map_ = OccupancyMap(GRID)
    map_.log_odds_fixed[:] = rng.integers(
        -map_.log_odds_range.clamp, map_.log_odds_range.clamp + 1, GRID.n_cells
    )
    map_.sampled_mask[:] = rng.random(GRID.n_cells) < 0.6
    byte_of_log_odds = np.round(255 * map_.log_odds_range.probability).astype(np.uint8)
    for heading in (0.0, 0.3, -2.0):
        # off the voxels' faces, where rounding would decide
        pose, cells = base(0.213, -0.127, heading), (6, 5)
        crop = Crop.around(GRID, pose, cells, 2)
        out = np.empty((10, 6, 6), dtype=np.uint8)
        write_crop(map_.arrays, crop, 2, byte_of_log_odds, out)
        np.testing.assert_array_equal(out, plain_crop(map_, pose, cells, 2))


def test_ahead_and_left_of_the_base_are_the_first_and_second_axis():
    pose = base(0.0, 0.0, math.pi / 2)  # faces +y
    crop = Crop.around(GRID, pose, (4, 4), 1)
    ahead = np.unravel_index(crop.columns[3, 2, 0], GRID.shape)
    assert GRID.center(np.array(ahead))[1] > 0.1  # +1.5 cells along y
    left = np.unravel_index(crop.columns[2, 3, 0], GRID.shape)
    assert GRID.center(np.array(left))[0] < -0.1


def test_space_around_a_vehicle_is_known_above_the_ground_only():
    cells = initial_free_voxels(GRID, [base(0.0, 0.0, 0.0)], 0.3)
    centers = GRID.center(np.stack(np.unravel_index(cells, GRID.shape), axis=-1))
    assert (np.hypot(centers[:, 0], centers[:, 1]) <= 0.3).all()
    # origin -0.25: layers begin at ... -0.05, 0.05; the one that holds z = 0 is not known
    assert centers[:, 2].min() > 0.05
    assert np.unique(centers[:, 2]).size == 5
    columns = np.unique(centers[:, :2], axis=0)
    assert len(columns) == sum(
        math.hypot(x, y) <= 0.3
        for x in np.arange(-0.95, 1, 0.1)
        for y in np.arange(-0.75, 0.8, 0.1)
    )
