import itertools
import math

import numpy as np
import pytest
from plain.kinematics import pose_is_free, random_joints, waypoints

from coopmap_env.geometry import Pose
from coopmap_env.mapping import FREE_LOG_ODDS_FIXED
from coopmap_env.robots import CollisionChecker, CollisionSettings, Vehicle, plan_path
from coopmap_env.robots.collision._motion import (
    MAX_SEGMENT,
    allocate_motion,
    count_waypoints,
    write_travel,
)
from coopmap_env.robots.collision.checker import robot_arrays

LEFT, RIGHT = np.array([-1.0, 0.6, 0.9, 0, 0]), np.array([1.0, 0.6, 0.9, 0, 0])


@pytest.fixture
def ahead(mast):
    """A mast at the origin, facing x."""
    return Vehicle.from_mount(mast, Pose(np.zeros(3), np.eye(3)))


def wall(map_, mark):
    """A wall that blocks the robot from left to right."""
    index = np.stack(np.unravel_index(np.arange(map_.grid.n_cells), map_.grid.shape), axis=-1)
    x, y, z = map_.grid.center(index).T
    mark(np.flatnonzero((abs(y) < 0.1) & (x > 0.55) & (z > 0)))


def forget(map_):
    def cells(numbers):
        map_.log_odds_fixed[numbers] = 0
        map_.sampled_mask[numbers] = 0

    return cells


def test_in_the_open_all_is_free(ahead, open_map):
    s = CollisionChecker(ahead, open_map)
    q = random_joints(ahead.chain, np.random.default_rng(0), 40)
    assert s.are_poses_free(q).all()
    assert s.are_motions_free(ahead.home, q).all()
    assert s.infeasibility_reason(LEFT, RIGHT) == ""
    assert s.first_contact(LEFT, RIGHT) is None
    assert s.infeasibility_reason(LEFT, LEFT) == ""


def test_why_not_names_the_link_and_what_it_would_touch(ahead, open_map):
    wall(open_map, open_map.mark_occupied)
    text = CollisionChecker(ahead, open_map).infeasibility_reason(LEFT, RIGHT)
    assert "link forearm would touch an obstacle at (" in text
    assert "% of the path" in text
    wall(open_map, forget(open_map))
    s = CollisionChecker(ahead, open_map)
    assert "would touch unknown space" in s.infeasibility_reason(LEFT, RIGHT)
    middle = 0.5 * (LEFT + RIGHT)
    assert s.infeasibility_reason(LEFT, middle).endswith("at the goal")
    assert s.first_contact(LEFT, middle, goal_first=True).free_fraction == 0


def test_the_first_contact_tells_how_far_the_way_is_free(ahead, open_map):
    wall(open_map, open_map.mark_occupied)
    s = CollisionChecker(ahead, open_map)
    contact = s.first_contact(LEFT, RIGHT)
    assert 0.1 < contact.free_fraction < 0.5
    assert not contact.at_goal
    stop = LEFT + contact.free_fraction * (RIGHT - LEFT)
    assert s.are_motions_free(LEFT, stop)[0]
    assert not s.are_motions_free(LEFT, LEFT + (contact.free_fraction + 0.05) * (RIGHT - LEFT))[0]


def test_own_links_are_in_the_way_too(open_map, somewhere):
    pytest.importorskip("pybullet_data")
    vehicle = Vehicle.from_mount("husky_panda", somewhere)
    low = vehicle.home + np.array([0, 1.6, 0, 0.3, 0, 0, 0])  # leans over, and into the chassis
    text = CollisionChecker(vehicle, open_map).infeasibility_reason(vehicle.home, low)
    assert "would touch its own" in text


def test_teammates_are_in_the_way_too(mast, open_map):
    base = Pose(np.zeros(3), np.eye(3))
    left = Vehicle.from_mount(mast, base)
    right = Vehicle.from_mount(mast, Pose(np.array([1.0, 0, 0]), np.eye(3)))
    team = [right.spheres(right.home)]
    assert "would touch teammate 0 at" in CollisionChecker(
        left, open_map, team
    ).infeasibility_reason(LEFT, RIGHT)
    far = Vehicle.from_mount(mast, Pose(np.array([2.8, 0, 0]), np.eye(3)))
    s = CollisionChecker(left, open_map, [far.spheres(far.home)])
    assert s.infeasibility_reason(LEFT, RIGHT) == ""


def test_poses_are_clear_where_the_plain_reference_says_so(vehicle, mast, open_map):
    rng = np.random.default_rng(40)
    cells = rng.choice(open_map.grid.n_cells, open_map.grid.n_cells // 400)
    open_map.mark_occupied(cells[::2])
    forget(open_map)(cells[1::2])
    mate = Vehicle.from_mount(mast, Pose(np.array([1.7, 0.3, 0.0]), np.eye(3)))
    team, settings = [mate.spheres(mate.home)], CollisionSettings()
    q = random_joints(vehicle.chain, rng, 40)
    wanted = [pose_is_free(vehicle, open_map, team, p, settings, FREE_LOG_ODDS_FIXED) for p in q]
    s = CollisionChecker(vehicle, open_map, team)
    np.testing.assert_array_equal(s.are_poses_free(q), wanted)
    assert 0 < np.mean(wanted) < 1


def test_a_motion_called_free_is_free_in_between_too(vehicle, open_map):
    """The margin makes up for what may be missed between two checks."""
    rng = np.random.default_rng(5)
    cells = rng.choice(open_map.grid.n_cells, 400)
    index = np.stack(np.unravel_index(cells, open_map.grid.shape), axis=-1)
    aside = (open_map.grid.center(index) - vehicle.T_world_base.translation)[:, :2]
    open_map.mark_occupied(cells[np.linalg.norm(aside, axis=1) > 0.4])  # not in the post
    s = CollisionChecker(vehicle, open_map)
    bare = CollisionSettings(margin=0.0)
    start = next(q for q in random_joints(vehicle.chain, rng, 99) if s.are_poses_free(q)[0])
    goals = random_joints(vehicle.chain, rng, 30)
    free = s.are_motions_free(start, goals)
    assert 2 < free.sum() < 28
    for goal in goals[free][:4]:
        for q in waypoints(start, goal, 40):
            assert pose_is_free(vehicle, open_map, [], q, bare, FREE_LOG_ODDS_FIXED)


def test_many_motions_are_judged_like_single_ones(vehicle, open_map):
    rng = np.random.default_rng(6)
    open_map.mark_occupied(rng.choice(open_map.grid.n_cells, 60))
    goals = random_joints(vehicle.chain, rng, 30)
    together = CollisionChecker(vehicle, open_map).are_motions_free(vehicle.home, goals)
    alone = CollisionChecker(vehicle, open_map)
    one_by_one = [alone.first_contact(vehicle.home, goal) is None for goal in goals]
    np.testing.assert_array_equal(together, one_by_one)
    assert [alone.infeasibility_reason(vehicle.home, goal) == "" for goal in goals] == one_by_one
    assert 0 < together.mean() < 1


def waypoint_fractions(vehicle, q0, q1, step):
    """Fractions of a motion at all its waypoints, start and goal included; `MAX_SEGMENT` apart."""
    n = max(1, math.ceil(np.abs(q1 - q0).max() / MAX_SEGMENT))
    ends = vehicle.spheres(q0 + np.linspace(0, 1, n + 1)[:, None] * (q1 - q0)).centers
    n_static = vehicle.body.n_static_spheres
    counts = [count_waypoints(n_static, *ends[k : k + 2], step) for k in range(n)]
    parts = [(k + np.arange(c) / c) / n for k, c in enumerate(counts)]
    return np.concatenate([*parts, [1.0]])


def test_no_center_moves_more_than_a_step_between_two_checks(any_mount):
    vehicle = Vehicle.from_mount(any_mount, Pose(np.zeros(3), np.eye(3)))
    chain, body = vehicle.chain, vehicle.body
    rng = np.random.default_rng(7)
    largest = 0.0
    for q0, q1 in zip(*(random_joints(chain, rng, 60) for _ in range(2)), strict=True):
        fractions = waypoint_fractions(vehicle, q0, q1, 0.05)
        moved = np.diff(body.centers(q0 + fractions[:, None] * (q1 - q0)), axis=0)
        largest = max(largest, np.linalg.norm(moved, axis=2).max())
    assert 0.03 < largest <= 0.05


def test_waypoints_that_are_passed_over_are_free(any_mount, mast, open_map):
    """The first contact is that of checking every waypoint."""
    vehicle = Vehicle.from_mount(any_mount, Pose(np.array([0.3, -0.2, 0.0]), np.eye(3)))
    rng = np.random.default_rng(8)
    mate = Vehicle.from_mount(mast, Pose(np.array([1.9, 0.3, 0.0]), np.eye(3)))
    team = [mate.spheres(mate.home)]
    state = open_map.log_odds_fixed.copy(), open_map.sampled_mask.copy()
    found_free = found_contacts = 0
    for n_blocked in (0, 10, 40, 150):
        open_map.log_odds_fixed[:], open_map.sampled_mask[:] = state
        open_map.mark_occupied(rng.choice(open_map.grid.n_cells, n_blocked))
        s, alone = (CollisionChecker(vehicle, open_map, team) for _ in range(2))
        s.are_motions_free(vehicle.home, np.repeat(vehicle.home[None], 9, axis=0))
        poses = random_joints(vehicle.chain, rng, 120)
        poses = poses[s.are_poses_free(poses)]
        for start, goal in zip(poses[:-1:2], poses[1::2], strict=False):
            fractions = waypoint_fractions(vehicle, start, goal, s.settings.step)
            free = s.are_poses_free(start + fractions[:, None] * (goal - start))
            contact = s.first_contact(start, goal)
            assert s.are_motions_free(start, goal)[0] == (contact is None) == free.all()
            assert str(contact) == str(alone.first_contact(start, goal))  # without distances
            if contact is None:
                found_free += 1
            else:
                found_contacts += 1
                last_free = fractions[np.argmin(free) - 1]
                assert contact.free_fraction == pytest.approx(last_free, abs=1e-12)
    assert found_free > 10
    assert found_contacts > 10 or any_mount.name == "tiago"  # its head has nothing to touch


def test_spheres_that_no_joint_moves_have_no_speed(any_mount):
    vehicle = Vehicle.from_mount(any_mount, Pose(np.zeros(3), np.eye(3)))
    robot, n_static = robot_arrays(vehicle), vehicle.body.n_static_spheres
    garbage = [np.full(300, np.nan) for _ in range(50)]
    del garbage  # memory that is given out again
    work = allocate_motion(robot, vehicle.chain.n_joints)
    assert not work.speeds[:n_static].any()
    assert not work.travel[:n_static].any()
    home = vehicle.home
    write_travel(robot, home, home + 0.1, 2, vehicle.spheres(home).centers, work)
    assert not work.travel[:n_static].any()


def test_the_check_ends_when_enough_motions_are_free(vehicle, open_map):
    goals = random_joints(vehicle.chain, np.random.default_rng(9), 30)
    s = CollisionChecker(vehicle, open_map)
    free = np.flatnonzero(s.are_motions_free(vehicle.home, goals))
    for n in (0, 1, 5, len(free), 30):
        first = np.flatnonzero(s.are_motions_free(vehicle.home, goals, n))
        np.testing.assert_array_equal(first, free[:n])


def test_what_touches_at_the_start_may_move_away_but_not_deeper(ahead, open_map):
    wall(open_map, open_map.mark_occupied)
    s = CollisionChecker(ahead, open_map)
    touching = LEFT + 0.42 * (RIGHT - LEFT)
    assert not s.are_poses_free(touching)[0]
    assert s.infeasibility_reason(touching, LEFT) == ""
    assert s.infeasibility_reason(touching, touching) == ""
    assert s.infeasibility_reason(touching, 0.5 * (LEFT + RIGHT)) != ""


def test_what_was_left_may_not_be_entered_again(ahead, open_map):
    """The forearm swings clear of a block at the start, and is stopped by the wall after it."""
    wall(open_map, open_map.mark_occupied)
    index = open_map.grid.index(ahead.camera_pose(LEFT).translation)
    open_map.mark_occupied(open_map.grid.flat_index(index))
    s = CollisionChecker(ahead, open_map)
    assert not s.are_poses_free(LEFT)[0]
    assert 0.1 < s.first_contact(LEFT, RIGHT).free_fraction < 0.5


def test_arguments_are_checked(ahead, open_map):
    s = CollisionChecker(ahead, open_map)
    with pytest.raises(ValueError, match="'elbow' at 3 is outside of its limits"):
        s.infeasibility_reason(LEFT, [0, 0, 3, 0, 0])
    with pytest.raises(ValueError, match="not finite"):
        s.are_motions_free(LEFT, [[0, np.nan, 1, 0, 0]])
    with pytest.raises(ValueError, match=r"teammate 0 needs centers"):
        CollisionChecker(ahead, open_map, [(np.zeros((2, 3)), np.zeros(3))])
    for bad in ({"step": 0.0}, {"margin": -1.0}, {"team_margin": np.inf}):
        with pytest.raises(ValueError, match=f"CollisionSettings.{next(iter(bad))}"):
            CollisionSettings(**bad)


def test_a_way_around_is_found_and_each_piece_of_it_is_free(ahead, open_map):
    pytest.importorskip("ompl")
    wall(open_map, open_map.mark_occupied)
    s = CollisionChecker(ahead, open_map)
    path = plan_path(s, LEFT, RIGHT, seed=3)
    assert len(path) > 2
    np.testing.assert_array_equal(path[[0, -1]], [LEFT, RIGHT])
    for one, other in itertools.pairwise(path):
        assert s.infeasibility_reason(one, other) == ""
    np.testing.assert_array_equal(plan_path(s, LEFT, RIGHT, seed=3), path)
    assert not np.array_equal(plan_path(s, LEFT, RIGHT, seed=4), path)


def test_a_way_around_is_straight_where_it_can_be_and_none_where_there_is_none(ahead, open_map):
    pytest.importorskip("ompl")
    s = CollisionChecker(ahead, open_map)
    np.testing.assert_array_equal(plan_path(s, LEFT, RIGHT, seed=1), [LEFT, RIGHT])
    wall(open_map, open_map.mark_occupied)
    s = CollisionChecker(ahead, open_map)
    assert plan_path(s, LEFT, 0.5 * (LEFT + RIGHT), seed=1) is None
    assert plan_path(s, LEFT, RIGHT, seed=1, iterations=1) is None
    with pytest.raises(ValueError, match="at least 1, got 0 and 300"):
        plan_path(s, LEFT, RIGHT, seed=0)
