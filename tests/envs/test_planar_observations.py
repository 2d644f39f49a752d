import math

import numpy as np
import pytest
from plain.candidates import candidate_features
from plain.planar_worlds import (
    NO_NOISE,
    env_with_world,
    observe_again,
    open_world,
    place_team,
    pose_id,
    set_poses,
)
from plain.random_maps import random_map, set_cells
from plain.rollouts import random_actions

from coopmap_env.envs.planar import PlanarEnv, PlanarSettings
from coopmap_env.envs.planar._observation_kernels import crop_offsets
from coopmap_env.information import PlanarRatingSettings
from coopmap_env.sensing import PlanarCamera

SIDE = 16
OCCUPANCY, SAMPLED, TEAMMATES, INSIDE = range(4)
QUARTER = 4  # headings of a quarter turn


def env_of(n_robots=1, world=None, **changes):
    settings = PlanarSettings(**({"noise": NO_NOISE, "crop_cells": SIDE} | changes))
    return env_with_world(world or open_world(), n_robots=n_robots, settings=settings)


def observation_of(env, robot=0):
    observations = observe_again(env._worlds)
    env._belief = env._current_belief()
    return env._observations_of_robots(observations)[robot]


def shown(image, channel, value=255):
    """Where a channel holds a value: list of (i, j)."""
    return [tuple(at) for at in np.argwhere(image[channel] == value).tolist()]


# A cell i + 1/2 - 8 cells ahead and j + 1/2 - 8 to the left, for a camera in cell (20, 20). A map
# cell's center lies on the border of two cells of the picture, and the same neighbour is taken for
# every heading: the one towards +x and +y. So the camera's cell is picture cell 7 or 8.
@pytest.mark.parametrize(
    ("quarters", "ahead"),
    [(0, (23, 20)), (1, (20, 23)), (2, (17, 20)), (3, (20, 17))],
)
def test_a_cell_ahead_of_the_camera_is_shown_ahead(quarters, ahead):
    env = env_of()
    set_poses(env, (20, 20, quarters * QUARTER))
    set_cells(env.belief().map, [ahead[0] * 40 + ahead[1]], 0.9)
    image = observation_of(env)["map"]
    # ahead is towards +x or +y at headings 0 and 1, and left of the camera at 3 and 0
    i = 7 + 3 if quarters in (0, 1) else 8 + 3
    j = 7 if quarters in (0, 3) else 8
    assert shown(image, OCCUPANCY, round(0.9 * 255)) == [(i, j)]
    assert (i, j) in shown(image, SAMPLED)


@pytest.mark.parametrize(
    ("quarters", "left"),
    [(0, (20, 22)), (1, (18, 20)), (2, (20, 18)), (3, (22, 20))],
)
def test_a_cell_to_the_left_of_the_camera_is_shown_at_a_higher_j(quarters, left):
    env = env_of()
    set_poses(env, (20, 20, quarters * QUARTER))
    set_cells(env.belief().map, [left[0] * 40 + left[1]], 0.9)
    i = 7 if quarters in (0, 1) else 8
    j = 7 + 2 if quarters in (0, 3) else 8 + 2
    assert shown(observation_of(env)["map"], OCCUPANCY, round(0.9 * 255)) == [(i, j)]


def test_in_a_picture_of_odd_side_the_camera_is_in_the_middle_at_every_heading():
    env = env_of(crop_cells=9)
    for heading in range(16):
        set_poses(env, (20, 20, heading))
        assert shown(observation_of(env)["map"], SAMPLED) == [(4, 4)]
        angle = heading * math.tau / 16
        ahead = (20 + round(3 * math.cos(angle)), 20 + round(3 * math.sin(angle)))
        set_cells(env.belief().map, [ahead[0] * 40 + ahead[1]], 0.9)
        assert (7, 4) in shown(observation_of(env)["map"], OCCUPANCY, round(0.9 * 255))


def test_every_picture_cell_shows_the_nearest_map_cell():
    rng = np.random.default_rng(0)
    env = env_of(world=open_world(30, 24))
    for _ in range(40):
        x, y, heading = rng.integers(30), rng.integers(24), rng.integers(16)
        set_poses(env, (x, y, heading))
        known = random_map(rng, (30, 24))
        env.belief().map.log_odds_fixed[:] = known.log_odds_fixed
        env.belief().map.sampled_mask[:] = known.sampled_mask
        image, angle = observation_of(env)["map"], heading * math.tau / 16
        for i, j in np.ndindex(SIDE, SIDE):
            ahead, left = i + 0.5 - SIDE / 2, j + 0.5 - SIDE / 2
            cx = math.floor(x + 0.5 + math.cos(angle) * ahead - math.sin(angle) * left + 1e-9)
            cy = math.floor(y + 0.5 + math.sin(angle) * ahead + math.cos(angle) * left + 1e-9)
            if 0 <= cx < 30 and 0 <= cy < 24:
                p, seen = known.probability[cx, cy], known.sampled[cx, cy]
                expected = [round(255 * p), 255 * seen, 0, 255]
            else:
                expected = [128, 0, 0, 0]
            assert image[:, i, j].tolist() == expected


def test_unknown_is_128_free_is_0_and_occupied_255():
    env = env_of()
    set_poses(env, (20, 20, 0))
    set_cells(env.belief().map, [21 * 40 + 20], 0.9989)
    image = observation_of(env)["map"]
    assert image[OCCUPANCY, 7, 7] == 0
    assert image[OCCUPANCY, 8, 7] == 255
    assert (image[OCCUPANCY] == 128).sum() == SIDE**2 - 2
    assert (image[SAMPLED] == 255).sum() == 2


def test_outside_the_world_nothing_is_inside_known_or_sampled():
    env = env_of()
    set_poses(env, (1, 38, 0), known=np.ones((40, 40), dtype=bool))
    image = observation_of(env)["map"]
    # cells (1 + i - 7, 38 + j - 7): inside for i >= 6 and j <= 8
    inside = np.zeros((SIDE, SIDE), dtype=bool)
    inside[6:, :9] = True
    np.testing.assert_array_equal(image[INSIDE], 255 * inside)
    np.testing.assert_array_equal(image[SAMPLED], 255 * inside)
    np.testing.assert_array_equal(image[OCCUPANCY], np.where(inside, 0, 128))


@pytest.mark.parametrize("quarters", range(4))
@pytest.mark.parametrize(
    ("resolution", "origin"), [(1.0, (0.0, 0.0)), (0.2, (-3.3, 77.7)), (0.3, (1e5, -1e5))]
)
def test_a_teammate_is_a_block_of_nine_at_its_place_at_every_heading(quarters, resolution, origin):
    env = env_of(2, open_world(40, 40, resolution, origin))
    ahead = [(1, 0), (0, 1), (-1, 0), (0, -1)][quarters]
    left = [(0, 1), (-1, 0), (0, -1), (1, 0)][quarters]
    mate = [20 + 3 * ahead[axis] - 5 * left[axis] for axis in (0, 1)]
    set_poses(env, (20, 20, quarters * QUARTER), (*mate, 0))
    image = observation_of(env)["map"]
    # 3 ahead and 5 to the right of the picture's middle, which lies between cells 7 and 8
    block = [(i, j) for i in (10, 11, 12) for j in (2, 3, 4)]
    assert shown(image, TEAMMATES) == block


def test_a_teammate_at_the_edge_of_the_crop_is_clipped_and_one_far_away_is_not_shown():
    env = env_of(2)
    set_poses(env, (20, 20, 0), (28, 20, 0))
    assert shown(observation_of(env)["map"], TEAMMATES) == [(15, 7), (15, 8), (15, 9)]
    set_poses(env, (20, 20, 0), (30, 20, 0))
    assert shown(observation_of(env)["map"], TEAMMATES) == []


def test_one_does_not_see_oneself():
    env = env_of(1)
    set_poses(env, (20, 20, 0))
    assert not observation_of(env)["map"][TEAMMATES].any()
    assert "teammates" not in observation_of(env)


def test_pose_is_fractions_of_the_sides_and_the_direction():
    env = env_of(world=open_world(40, 20, 0.5, (-4.0, 9.0)))
    set_poses(env, (9, 14, 2))
    expected = [9.5 / 40, 14.5 / 20, math.cos(math.pi / 4), math.sin(math.pi / 4)]
    np.testing.assert_allclose(observation_of(env)["pose"], expected, rtol=1e-6)  # float32


def test_teammates_are_in_the_own_frame_and_in_order_of_their_numbers():
    env = env_of(3, open_world(30, 40, 2.0))  # a diagonal of 100 m
    set_poses(env, (10, 10, 4), (10, 15, 4), (7, 10, 8))
    # from robot 0, which faces +y: robot 1 is 10 m ahead, robot 2 is 6 m to the left
    expected = [[0.10, 0.0, 1.0, 0.0], [0.0, 0.06, 0.0, 1.0]]
    np.testing.assert_allclose(observation_of(env, 0)["teammates"], expected, atol=1e-7)
    # from robot 2, which faces -x: robot 0 is 6 m behind, robot 1 also 10 m to the right
    expected = [[-0.06, 0.0, 0.0, -1.0], [-0.06, -0.10, 0.0, -1.0]]
    np.testing.assert_allclose(observation_of(env, 2)["teammates"], expected, atol=1e-7)


def test_the_state_is_the_map_row_by_row_then_the_poses_then_the_budget():
    env = env_of(2, open_world(10, 8))
    belief = set_poses(env, (3, 4, 0), (9, 7, 8))
    set_cells(belief.map, [11], 0.25)
    state = env.state()
    known = np.full(80, 0.5)
    known[[3 * 8 + 4, 9 * 8 + 7]] = 0.001
    known[11] = 0.25
    np.testing.assert_allclose(state[:80], known, atol=1e-3)  # a level is 1/1024 nat
    np.testing.assert_array_equal(np.flatnonzero(state[80:160]), [11, 28, 79])
    poses = [0.35, 4.5 / 8, 1, 0, 0.95, 7.5 / 8, -1, 0]
    np.testing.assert_allclose(state[160:-2], poses, atol=1e-6)
    np.testing.assert_array_equal(state[-2:], [1.0, 1.0])


def test_candidate_features_by_hand():
    rating = PlanarRatingSettings(K=0.1, exponent=2.0, alpha_heading=0.5)
    settings = PlanarSettings(noise=NO_NOISE, rating=rating)
    env = env_with_world(
        open_world(30, 40, 2.0), n_robots=1, settings=settings,
        action_mode="candidates", n_candidates=40,
    )  # fmt: skip
    set_poses(env, (10, 10, 4), known=[10 * 40 + 11])
    observation, most = observation_of(env), math.log(rating.n_gray_bins)
    belief = env.belief()
    assert observation["action_mask"].tolist() == [1] * 32 + [0] * 8
    assert not observation["candidates"][32:].any()
    row = belief.candidates[0].tolist().index(pose_id(env, 10, 11, heading=0))
    rated = belief.rate(0, [pose_id(env, 10, 11)])
    d2 = 2.0**2 + 0.5 * (math.pi / 2) ** 2
    expected = [
        0.02, 0.0,  # 2 m ahead of the camera, which faces +y
        0.0, -1.0,  # a quarter turn to the right
        rated.new_information[0] / most,
        0.1 * d2 / most,
        0.0001,
        rated.rating[0] / most,
        belief.rating_function.count_unknown_cells(belief.map, [pose_id(env, 10, 11)])[0]
        / belief.rating_function.fan.max_visible_cells,
    ]  # fmt: skip
    np.testing.assert_allclose(observation["candidates"][row], expected, atol=1e-6)
    assert expected[7] == pytest.approx((expected[4] - expected[5]) * 0.9999, abs=1e-6)
    assert 0.9 < expected[8] < 1


@pytest.mark.parametrize("n_headings", [5, 16])
def test_candidate_features_are_bit_for_bit_those_of_each_pose_alone(n_headings):
    rng = np.random.default_rng(3)
    env = env_with_world(
        open_world(30, 34, 0.3, origin=(-3.0, 7.7)), n_robots=3, action_mode="candidates",
        settings=PlanarSettings(
            camera=PlanarCamera(depth_of_field=3.0), reach=2.4, n_headings=n_headings,
            rating=PlanarRatingSettings(exponent=2.0, alpha_heading=0.7),
        ),
    )  # fmt: skip
    for _ in range(4):
        map_, known = random_map(rng, (30, 34), occupied=0.02), env.belief().map
        known.log_odds_fixed[:], known.sampled_mask[:] = map_.log_odds_fixed, map_.sampled_mask
        place_team(env, rng.integers(env.belief().lattice.n_poses, size=3))
        for robot in range(3):
            observation, belief = observation_of(env, robot), env.belief()
            offer = belief.candidates[robot]
            actual = observation["candidates"][: len(offer)]
            expected = [candidate_features(belief, robot, int(pose)) for pose in offer]
            np.testing.assert_array_equal(
                actual.view(np.uint32), np.array(expected).view(np.uint32)
            )


def test_huge_costs_end_at_the_limit():
    rating = PlanarRatingSettings(K=1e5)
    env = env_with_world(
        open_world(), n_robots=1, settings=PlanarSettings(rating=rating), action_mode="candidates"
    )
    set_poses(env, (20, 20, 0), known=[20 * 40 + 21])
    features = observation_of(env)["candidates"]
    moved = np.abs(features[:, 1]) + np.abs(features[:, 0]) > 0
    assert moved.any()
    assert (features[moved, 5] == 10).all()
    assert (features[moved, 7] == -10).all()


def test_masks_say_which_rows_are_candidates_and_the_others_are_zero():
    world = open_world(8, 8)
    arguments = {"n_robots": 2, "action_mode": "candidates", "n_candidates": 400, "max_scans": 3}
    env = env_with_world(
        world, settings=PlanarSettings(initial_free_radius=1.0, reach=2.0), **arguments
    )
    env.reset(seed=0)
    rng, full = np.random.default_rng(0), []
    while env.agents:
        observations, *_ = env.step(random_actions(env, rng))
        for robot, observation in enumerate(observations.values()):
            mask = observation["action_mask"]
            assert mask.dtype == np.int8
            candidates = env.belief().candidates[robot]
            assert mask.sum() == len(candidates) < 400
            assert mask[: len(candidates)].all()
            features = observation["candidates"]
            assert not features[len(candidates) :].any()
            assert features[: len(candidates)].any(axis=1).all()
            full.append(len(candidates))
    assert max(full) > min(full)


def test_observations_are_new_arrays_each_time():
    env = PlanarEnv(action_mode="candidates")
    first, _ = env.reset(seed=0)
    kept = {key: value.copy() for key, value in first["robot_0"].items()}
    env.step(dict.fromkeys(env.agents, 0))
    for key, value in first["robot_0"].items():
        np.testing.assert_array_equal(value, kept[key])


def test_the_corners_of_the_picture_are_half_a_side_away():
    offsets = crop_offsets(SIDE, 16)
    assert offsets.shape == (16, SIDE * SIDE, 2)
    # heading 0, corner [0, 0]: 7.5 cells back and to the right of a cell center
    assert offsets[0, 0].tolist() == [-7, -7]
    assert offsets[0, -1].tolist() == [8, 8]
