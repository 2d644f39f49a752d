"""Planners that look ahead."""

import itertools

import numpy as np
import pytest
from plain.planar_worlds import NO_NOISE, env_with_world, open_world, set_poses
from plain.random_maps import set_cells

import coopmap_baselines
from coopmap_baselines.tour import shortest_tour
from coopmap_env.envs.planar import PlanarEnv, PlanarSettings
from coopmap_env.sensing import PlanarCamera

SETTINGS = PlanarSettings(noise=NO_NOISE, camera=PlanarCamera(depth_of_field=6.0), reach=6.0)
N = 16
EVERYTHING = {"search": "exhaustive", "width": 300, "samples": 2000, "discount": 0.9}


def pocket_or_door(n_robots=1):
    """A corridor with a closed pocket at its left end; behind its long right end, all is unknown.

    The first view into the pocket shows more than any other; the door is two actions away.
    """
    env = env_with_world(open_world(60, 40), n_robots=n_robots, settings=SETTINGS)
    known = [x * 40 + y for x in range(13, 32) for y in (19, 20, 21)]
    belief = set_poses(env, *[(20, 20, 0)] * n_robots, known=known)
    walls = [x * 40 + y for x in range(9, 32) for y in (18, 22)]
    walls += [8 * 40 + y for y in range(18, 23)]
    set_cells(belief.map, walls, 0.99)
    return belief


def cells_of(policy, belief):
    policy.reset(np.random.default_rng(0))
    poses = []
    for agent, action in policy.act(belief, {}).items():
        pose, reason = belief.actions.decode(agent, action, belief)
        assert reason == 0
        poses.append(int(pose) // N // belief.map.grid.shape[1])
    return poses


def test_one_step_looks_into_the_pocket_and_look_ahead_goes_to_the_door():
    one = coopmap_baselines.make("lookahead", horizon=1, **EVERYTHING)
    two = coopmap_baselines.make("lookahead", horizon=2, **EVERYTHING)
    assert cells_of(one, pocket_or_door())[0] < 20
    assert cells_of(two, pocket_or_door())[0] > 24


@pytest.mark.parametrize("coordination", ["sequential", "joint"])
def test_a_team_looks_at_both_ends_and_robots_alone_at_one(coordination):
    belief = pocket_or_door(n_robots=2)
    alone = coopmap_baselines.make("lookahead", horizon=1, coordination="independent", **EVERYTHING)
    together = coopmap_baselines.make(
        "lookahead", horizon=2, coordination=coordination, **EVERYTHING
    )
    assert len(set(cells_of(alone, belief))) == 1
    left, right = sorted(cells_of(together, belief))
    assert left < 20 < right


def test_what_a_view_probably_shows_can_be_entered():
    belief = pocket_or_door()
    future = belief.planning.foresight(belief)
    at_door, rng = (31 * 40 + 20) * N, np.random.default_rng(0)
    before = future.random_poses(0, at_door, 5000, rng)
    assert (before // N // 40).max() == 31
    later = future.copy()
    later.take(0, at_door)
    after = later.random_poses(0, at_door, 5000, rng)
    assert (after // N // 40).max() > 33
    assert (before // N // 40).min() == (after // N // 40).min() == 25
    assert later.gain(0, np.array([at_door]))[0] < 0.5 * future.gain(0, np.array([at_door]))[0]
    beyond = np.array([(33 * 40 + 20) * N])
    assert 0 == future.gain(0, beyond)[0] < later.gain(0, beyond)[0]
    assert later.distance(0, beyond, at_door)[0] == pytest.approx(2.0)


def test_with_a_horizon_of_one_the_pose_that_is_expected_to_show_most_is_taken():
    env = PlanarEnv(2, max_scans=3)
    env.reset(seed=1)
    belief = env.belief()
    policy = coopmap_baselines.make(
        "lookahead", horizon=1, search=50, coordination="independent", motion_weight=0.01
    )
    policy.reset(np.random.default_rng(4))
    actions, rng = policy.act(belief, {}), np.random.default_rng(4)
    for robot, agent in enumerate(belief.agents):
        poses = belief.random_poses(robot, 50, rng)
        gain = belief.planning.expected_unknown_fraction(belief, robot, poses, None)
        best = poses[np.argmax(gain - 0.01 * belief.distance(robot, poses))]
        np.testing.assert_array_equal(actions[agent], belief.action_for(robot, best))


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("horizon", 0),
        ("horizon", 7),
        ("width", 0),
        ("search", "all"),
        ("samples", 0),
        ("coordination", "team"),
        ("discount", 1.5),
        ("motion_weight", -1),
    ],
)
def test_a_wrong_option_is_named_with_its_value(option, value):
    with pytest.raises(ValueError, match=f"{option} must be .* got {value!r}"):
        coopmap_baselines.make("lookahead", **{option: value})


# tours


def test_a_tour_visits_all_points_once_and_is_nearly_the_shortest():
    rng = np.random.default_rng(0)
    for n in (1, 2, 3, 4, 5, 6):
        for _ in range(10):
            points = rng.random((n + 1, 2))
            way = np.linalg.norm(points[:, None] - points[None], axis=-1)
            tour = shortest_tour(way[0, 1:], way[1:, 1:])
            assert sorted(tour) == list(range(n))

            def length(order, way=way):
                return sum(way[a, b] for a, b in itertools.pairwise([0, *(k + 1 for k in order)]))

            best = min(length(order) for order in itertools.permutations(range(n)))
            assert length(tour) <= 1.2 * best


def test_a_tour_on_a_line_goes_to_the_nearer_end_first():
    x = np.array([3.0, -1.0, 2.0, 1.0])
    assert shortest_tour(np.abs(x), np.abs(x[:, None] - x)) == [1, 3, 2, 0]


def test_the_tour_begins_with_the_nearest_of_the_viewpoints():
    belief = pocket_or_door()
    first = coopmap_baselines.make("tour", search=10**6, viewpoints=1)
    tour = coopmap_baselines.make("tour", search=10**6, viewpoints=3, least_gain=0.0)
    assert cells_of(first, belief)[0] < 20
    assert abs(cells_of(tour, belief)[0] - 20) <= abs(cells_of(first, belief)[0] - 20)


def test_the_viewpoints_of_a_team_are_split_among_its_robots():
    belief = pocket_or_door(n_robots=2)
    tour = coopmap_baselines.make("tour", search=10**6, viewpoints=2)
    left, right = sorted(cells_of(tour, belief))
    assert left < 20 <= right


@pytest.mark.parametrize(("option", "value"), [("viewpoints", 0), ("least_gain", 2.0)])
def test_a_wrong_option_of_a_tour_is_named(option, value):
    with pytest.raises(ValueError, match=f"{option} must be .* got {value!r}"):
        coopmap_baselines.make("tour", **{option: value})
