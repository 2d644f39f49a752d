import math

import numpy as np
import pytest

from coopmap_env.envs.field import FieldEnv
from coopmap_env.envs.field._initial_knowledge import initial_free_voxels
from coopmap_env.envs.field._map_crop import Crop, CropUpdate, write_crop
from coopmap_env.envs.field.observations import FieldObserver
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
        all_cells = CropUpdate(map_.changes.last_change, -1)
        write_crop(map_.arrays, crop, 2, byte_of_log_odds, all_cells, out)
        np.testing.assert_array_equal(out, plain_crop(map_, pose, cells, 2))


def test_only_columns_that_have_changed_are_written():
    map_ = OccupancyMap(GRID)
    byte_of_log_odds = np.round(255 * map_.log_odds_range.probability).astype(np.uint8)
    pose, cells = base(0.213, -0.127, 0.3), (6, 5)
    crop, changes = Crop.around(GRID, pose, cells, 2), map_.changes
    out = np.full((10, 6, 6), 7, dtype=np.uint8)
    write_crop(map_.arrays, crop, 2, byte_of_log_odds, CropUpdate(changes.last_change, 0), out)
    assert (out == 7).all()
    column = crop.columns[2, 3, 0]
    map_.log_odds_fixed[column], map_.sampled_mask[column] = 100, 1
    changes.add(np.array([column]))
    write_crop(map_.arrays, crop, 2, byte_of_log_odds, CropUpdate(changes.last_change, 1), out)
    assert (out == 7).all()
    write_crop(map_.arrays, crop, 2, byte_of_log_odds, CropUpdate(changes.last_change, 0), out)
    wanted = plain_crop(map_, pose, cells, 2)
    written = out[0] != 7
    assert written[2, 3]
    assert written.sum() <= 2  # a column may be nearest to points of two cells
    np.testing.assert_array_equal(out[:, written], wanted[:, written])


def random_actions(env, rng):
    return {agent: rng.uniform(-1, 1, 5).astype(np.float32) for agent in env.agents}


@pytest.mark.parametrize("initialization", ["located", "search"])
def test_observed_maps_are_those_of_an_observer_that_sees_them_first(initialization):
    """In two episodes, over scans, and where the map is cleared, marked, or set as a whole."""
    pytest.importorskip("pybullet")
    env = FieldEnv(max_scans=3, initialization=initialization)
    rng = np.random.default_rng(0)

    def check(observations):
        first = FieldObserver(
            env.scene.grid, env.settings, [5, 5], None, initialization == "search"
        )
        for agent, wanted in zip(env.possible_agents, first.observe(env.belief()), strict=True):
            np.testing.assert_array_equal(observations[agent]["map"], wanted["map"])

    for seed in (0, 1):
        check(env.reset(seed=seed)[0])
        while env.agents:
            check(env.step(random_actions(env, rng))[0])
    belief = env.belief()
    map_ = belief.planning_map(0)
    kept = map_.copy()
    for change in (
        lambda: map_.mark_occupied(rng.choice(map_.grid.n_cells, 9)),
        lambda: map_.mark_free(rng.choice(map_.grid.n_cells, 9)),
        map_.clear,
        lambda: map_.set_state(kept.log_odds_fixed, kept.sampled_mask, *kept.hit_cell_sums()),
    ):
        change()
        check(dict(zip(env.possible_agents, env._observer.observe(belief), strict=True)))


def test_an_observation_is_not_changed_by_the_next_one():
    pytest.importorskip("pybullet")
    env, rng = FieldEnv(max_scans=2), np.random.default_rng(0)
    before = env.reset(seed=0)[0]["robot_0"]["map"]
    kept = before.copy()
    env.step(random_actions(env, rng))
    np.testing.assert_array_equal(before, kept)
    before[:] = 0  # and a user may write to it
    after = env.step(random_actions(env, rng))[0]
    assert after["robot_0"]["map"].any()


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
