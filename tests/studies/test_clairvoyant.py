"""Policies that know the truth: they keep the constraints, and show what they can."""

from dataclasses import replace

import numpy as np
import pytest
from plain.planar_worlds import NO_NOISE, env_with_world, world_from_text
from plain.small_worlds import SETTINGS, small_world
from scipy import ndimage

from coopmap_env.envs import Budget
from coopmap_env.evaluation import rollout
from coopmap_env.evaluation.bounds import BoundSearch, PlanarViews, bound_shown
from coopmap_env.studies.clairvoyant import ClairvoyantGreedy, ClairvoyantLookAhead, LookAhead
from coopmap_env.studies.clairvoyant import policy as policy_module
from coopmap_env.studies.clairvoyant._base_choices import STRIDE
from coopmap_env.studies.clairvoyant._timed_choices import Step
from coopmap_env.studies.clairvoyant._true_rollouts import BASE
from coopmap_env.studies.clairvoyant.policy import _worth

SHORT = LookAhead(n_scans=4, n_tried=4)
CANDIDATES = {"action_mode": "candidates", "n_candidates": 12}
MODES = ({}, CANDIDATES, {"max_time": 14.0})
MODE_NAMES = ("pose", "candidates", "time")
POLICIES = {
    "greedy": ClairvoyantGreedy,
    "look-ahead": lambda env: ClairvoyantLookAhead(env, SHORT),
}


def views_of(views, poses):
    sets = views.pose_sets(np.asarray(poses, dtype=np.int64))
    return [set(own.tolist()) for own in np.split(sets.cells, sets.start[1:-1])]


def play(env, policy, seed=0):
    """Poses of the team and cells shown, after each scan."""
    played = [
        (env.belief().pose_ids, int(env.shown_mask.sum())) for _ in rollout(env, policy, seed)
    ]
    return [poses for poses, _ in played], [shown for _, shown in played]


@pytest.mark.parametrize("mode", MODES, ids=MODE_NAMES)
@pytest.mark.parametrize("name", POLICIES)
def test_no_constraint_is_broken_and_no_more_is_shown_than_the_bound(name, mode):
    env = small_world(max_scans=6, report_shown=True, **mode)
    policy = POLICIES[name](env)
    for seed in range(5):
        env.reset(seed=seed)
        views = PlanarViews.from_env(env)
        bounds = bound_shown(views, 6, BoundSearch(n_exchanges=100, n_rounds=2)).bounds
        shown = set(np.flatnonzero(views.known).tolist())
        for scan, step in enumerate(rollout(env, policy, seed), start=1):
            for info in step.infos.values():
                assert info["rejected_reason"] == 0
                assert not info["collided"]
            shown = shown.union(*views_of(views, env.belief().pose_ids))
            assert len(shown) == env.shown_mask.sum() <= bounds[scan]


@pytest.mark.parametrize("mode", MODES[:2], ids=MODE_NAMES[:2])
def test_greedy_takes_the_pose_that_shows_most_beside_the_robots_before(mode):
    env = small_world(max_scans=4, report_shown=True, **mode)
    policy = ClairvoyantGreedy(env)
    for seed in range(3):
        observations, _ = env.reset(seed=seed)
        policy.reset(np.random.default_rng(0))
        views = PlanarViews.from_env(env)
        shown = set(np.flatnonzero(views.known).tolist())
        while env.agents:
            belief = env.belief()
            actions = policy.act(belief, observations)
            for robot, agent in enumerate(env.agents):
                offered = belief.candidates
                poses = belief.feasible_poses(robot) if offered is None else offered[robot]
                poses = poses[~env.truth.occupied.ravel()[poses // views.n_headings]]
                gains = np.array([len(view - shown) for view in views_of(views, poses)])
                best = poses[gains == gains.max()]
                chosen = belief.actions.decode(agent, actions[agent], belief).pose
                assert chosen in best
                distance = belief.distance(robot, best).min()
                assert belief.distance(robot, [chosen])[0] == distance
                shown = shown.union(*views_of(views, [chosen]))
            observations, *_ = env.step(actions)


@pytest.mark.parametrize("mode", [{}, CANDIDATES], ids=["pose", "candidates"])
def test_where_time_ends_the_episode_greedy_shows_most_for_each_second_of_the_team(mode):
    """All poses are compared, one robot after another; a robot need not be faster than another."""
    env = small_world(max_scans=9, report_shown=True, max_time=12.0, **mode)
    policy = ClairvoyantGreedy(env)
    for seed in range(3):
        observations, _ = env.reset(seed=seed)
        policy.reset(np.random.default_rng(0))
        views = PlanarViews.from_env(env)
        shown = set(np.flatnonzero(views.known).tolist())
        while env.agents:
            belief, gain, slowest = env.belief(), 0, 0.0
            actions = policy.act(belief, observations)
            for robot, agent in enumerate(env.agents):
                offered = belief.candidates
                poses = belief.feasible_poses(robot) if offered is None else offered[robot]
                poses = poses[~env.truth.occupied.ravel()[poses // views.n_headings]]
                gains = gain + np.array([len(view - shown) for view in views_of(views, poses)])
                moving = np.maximum(belief.motion_time(robot, poses), slowest)
                rates = gains / np.minimum(moving + belief.scan_time, belief.budget.time)
                chosen = belief.actions.decode(agent, actions[agent], belief).pose
                (at,) = np.flatnonzero(poses == chosen)
                assert rates[at] == rates.max()
                gain, slowest = gains[at], moving[at]
                shown = shown.union(*views_of(views, [chosen]))
            observations, *_ = env.step(actions)


def test_a_small_gain_near_and_a_large_one_far():
    """10 cells after 1 s of motion, or 24 after 8 s; a scan takes 2 s, a cell 1 s."""
    settings = replace(SETTINGS, speed=1.0, scan_time=2.0, n_headings=16)
    env = small_world(max_scans=50, max_time=30.0, settings=settings)
    env.reset(seed=0)
    belief = env.belief()
    ny, at = belief.map.grid.shape[1], int(belief.pose_ids[0])
    sign = 1 if belief.cell(0) // ny < 12 else -1
    poses = np.array([at + sign * cells * ny * 16 for cells in (1, 8)])
    np.testing.assert_allclose(belief.motion_time(0, poses), [1.0, 8.0])
    counts = np.array([10, 24])
    for left, gain, slowest, expected in (
        (30.0, 0, 0.0, [10 / 3, 24 / 10]),  # near
        (30.0, 0, 8.0, [10 / 10, 24 / 10]),  # a robot before goes as far
        (30.0, 6, 4.0, [16 / 6, 30 / 10]),  # a robot before shows 6 after 4 s
        (2.5, 0, 0.0, [10 / 2.5, 24 / 2.5]),  # the last scan
    ):
        now = replace(belief, budget=Budget(50, left))
        worth = _worth(now, 0, poses, counts, Step(gain, slowest))
        np.testing.assert_allclose(worth, expected)
    np.testing.assert_array_equal(
        _worth(replace(belief, budget=Budget(50)), 0, poses, counts, Step(0, 0.0)), counts
    )


def test_greedy_looks_into_the_only_open_direction():
    """In a corridor that is known to its left end, all that is new lies to the right."""
    world = world_from_text(
        """
        ####################
        #..................#
        #..................#
        ####################
        ####################
        ####################
        ####################
        ####################
        """
    )
    settings = replace(SETTINGS, noise=NO_NOISE, initial_free_radius=2.0, max_start_distance=1.0)
    env = env_with_world(world, settings=settings, n_robots=1, max_scans=1, report_shown=True)
    x = {}
    for seed in range(8):
        env.reset(seed=seed)
        before = env.belief().positions[0, 0]
        play(env, ClairvoyantGreedy(env), seed)
        x[before] = env.belief().camera_poses[0]
    left, right = x[min(x)], x[max(x)]
    assert abs(left[2]) < 1.0  # faces right
    assert abs(right[2]) > 2.0  # faces left


DETOUR = """
    ##############################
    #.......#....................#
    #.......#....................#
    #.......#....................#
    #............................#
    #.......#....................#
    #.......#....................#
    #.......#....................#
    ##############################
    """
"""A small room whose door opens on a hall."""


def test_looking_ahead_shows_more_where_greedy_stays_in_the_small_room():
    settings = replace(SETTINGS, noise=NO_NOISE, reach=3.0, max_start_distance=2.0)
    world = world_from_text(DETOUR)
    env = env_with_world(world, settings=settings, n_robots=1, max_scans=6, report_shown=True)
    ends = []
    for seed in range(60):
        env.reset(seed=seed)
        if env.belief().positions[0, 0] > 4:
            continue
        policies = ClairvoyantGreedy(env), ClairvoyantLookAhead(env, LookAhead(n_scans=6))
        ends.append([play(env, policy, seed)[1][-1] for policy in policies])
    greedy, ahead = np.array(ends).T
    assert len(ends) >= 5
    assert (ahead >= greedy).all()
    assert ahead.mean() > 1.05 * greedy.mean()


@pytest.mark.parametrize("name", POLICIES)
def test_the_same_seed_gives_the_same_trajectory(name):
    env = small_world(max_scans=5, report_shown=True)
    policy = POLICIES[name](env)
    first, other = play(env, policy, 3), play(env, policy, 4)
    again = small_world(max_scans=5, report_shown=True)
    assert play(again, POLICIES[name](again), 3) == first
    assert play(env, policy, 3) == first != other


def plain_regions(free, pose_ids, n_headings):
    """Cells that known free cells lead to, from the cells of the robots."""
    regions = []
    for pose_id in pose_ids:
        own = free.copy()
        own.ravel()[pose_id // n_headings] = True
        labels, _ = ndimage.label(own)
        regions.append(labels == labels.ravel()[pose_id // n_headings])
    return regions


def test_a_plan_that_is_played_on_is_one_that_can_be_executed():
    """Beside a plain reference: where robots can be, and what they show; given poses are kept."""
    env = small_world(max_scans=9, settings=replace(SETTINGS, reach=3.0))
    rng = np.random.default_rng(0)
    for seed in range(4):
        env.reset(seed=seed)
        belief, n_headings = env.belief(), env.belief().lattice.n_headings
        views, occupied = PlanarViews.from_env(env), env.truth.occupied
        policy = ClairvoyantLookAhead(env, LookAhead(n_scans=9))
        policy.reset(rng)
        policy._n_scans = 1
        policy._start_from(belief)
        given = np.full((9, 2), BASE)
        given[0] = [rng.choice(belief.feasible_poses(robot)) for robot in range(2)]
        given[4] = rng.integers(belief.lattice.n_poses, size=2)  # few are possible
        played = policy._play(given.copy())
        np.testing.assert_array_equal(played.plan[0], given[0])
        shown, poses = belief.map.sampled.copy(), belief.pose_ids
        for scan, chosen in enumerate(played.plan):
            regions = plain_regions(shown & ~occupied, poses, n_headings)
            before = shown.sum()
            for robot, pose in enumerate(chosen):
                cells = belief.lattice.poses([poses[robot], pose])[:, :2]
                assert regions[robot].ravel()[pose // n_headings]
                assert np.abs(cells[1] - cells[0]).max() <= 3.0 * np.sqrt(2) + 1e-9
                if given[scan, robot] == BASE:
                    near = np.flatnonzero(regions[robot].ravel())
                    at = belief.lattice.poses(near * n_headings)[:, :2] - cells[0]
                    is_considered = (near // 24 % STRIDE == 0) & (near % 24 % STRIDE == 0)
                    is_considered |= near == poses[robot] // n_headings
                    near = near[is_considered & (np.linalg.norm(at, axis=1) <= 3.0)]
                    best = max(
                        len(view - set(np.flatnonzero(shown).tolist()))
                        for view in views_of(
                            views, (near[:, None] * n_headings + np.arange(n_headings)).ravel()
                        )
                    )
                    (view,) = views_of(views, [pose])
                    is_best = len(view - set(np.flatnonzero(shown).tolist())) >= best
                    assert is_best or goes_far(played, scan, best)
                shown.ravel()[list(views_of(views, [pose])[0])] = True
            assert shown.sum() - before == played.shown[scan]
            poses = chosen


def test_a_plan_that_is_played_on_ends_with_the_time():
    """Beside a plain reference: what the base policy chooses, and the scans that begin in time."""
    settings = replace(SETTINGS, reach=3.0, speed=1.0)
    env = small_world(max_scans=30, max_time=25.0, settings=settings)
    for seed in range(3):
        env.reset(seed=seed)
        belief, n_headings = env.belief(), env.belief().lattice.n_headings
        views, occupied = PlanarViews.from_env(env), env.truth.occupied
        policy = ClairvoyantLookAhead(env)
        policy.reset(np.random.default_rng(0))
        policy._n_scans = 1
        policy._start_from(belief)
        played = policy._play(np.full((13, 2), BASE))
        shown, poses, left = belief.map.sampled.copy(), belief.pose_ids, 25.0
        for scan, chosen in enumerate(played.plan):
            if left <= 0:
                assert (chosen == BASE).all()
                assert played.shown[scan] == 0
                continue
            regions = plain_regions(shown & ~occupied, poses, n_headings)
            before, gain, slowest = shown.sum(), 0, 0.0
            for robot, pose in enumerate(chosen):
                now = replace(belief, pose_ids=poses)
                hidden = set(np.flatnonzero(~shown).tolist())
                assert regions[robot].ravel()[pose // n_headings]
                cells = np.flatnonzero(regions[robot].ravel())
                is_considered = (cells // 24 % STRIDE == 0) & (cells % 24 % STRIDE == 0)
                cells = cells[is_considered | (cells == poses[robot] // n_headings)]
                ids = (cells[:, None] * n_headings + np.arange(n_headings)).ravel()
                at = belief.lattice.poses([poses[robot]])[0, :2]
                ids = ids[np.linalg.norm(belief.lattice.poses(ids)[:, :2] - at, axis=1) <= 3.0]
                gains = np.array([len(view & hidden) for view in views_of(views, ids)])
                moving = np.maximum(now.motion_time(robot, ids), slowest)
                best = ((gain + gains) / np.minimum(moving + 2.0, left)).max()
                (view,) = views_of(views, [pose])
                slowest = max(slowest, float(now.motion_time(robot, [pose])[0]))
                gain += len(view & hidden)
                is_best = gain / min(slowest + 2.0, left) >= best - 1e-12
                assert is_best or played.shown[scan:].max() > gains.max()  # it goes far
                shown.ravel()[list(view)] = True
            assert shown.sum() - before == played.shown[scan]
            poses, left = chosen, left - slowest - 2.0
        assert left <= 0


def test_counting_seconds_shows_more_where_motions_are_slow(monkeypatch):
    settings = replace(SETTINGS, speed=0.5)
    env = small_world(max_scans=50, max_time=40.0, settings=settings, report_shown=True)
    timed = [
        [play(env, POLICIES[name](env), seed)[1][-1] for seed in range(8)] for name in POLICIES
    ]
    monkeypatch.setattr(policy_module, "_worth", lambda belief, robot, poses, counts, step: counts)
    blind = [play(env, ClairvoyantGreedy(env), seed)[1][-1] for seed in range(8)]
    greedy, ahead = np.mean(timed, axis=1)
    assert ahead > greedy > np.mean(blind)


def goes_far(played, scan, best):
    """Whether later scans of a plan show more than one that shows the best near view each time."""
    return played.shown[scan + 1 :].max(initial=0) > best


def test_the_first_plan_comes_true_without_noise():
    """What is left of a plan is played again, so that later decisions only improve on it."""
    env = small_world(max_scans=6, report_shown=True, settings=replace(SETTINGS, noise=NO_NOISE))
    policy = ClairvoyantLookAhead(env, LookAhead(n_scans=6, n_tried=2))
    for seed in range(4):
        env.reset(seed=seed)
        known = env.shown_mask.sum()
        policy.reset(np.random.default_rng(0))
        policy._n_scans = 1
        policy._start_from(env.belief())
        planned = policy._first_plan(env.belief()).rank[0]
        assert play(env, policy, seed)[1][-1] >= known + planned


def test_only_planar_environments_have_clairvoyant_policies():
    with pytest.raises(ValueError, match="needs a planar environment, got"):
        ClairvoyantGreedy(object())


@pytest.mark.parametrize("field", ["n_scans", "n_tried", "block"])
def test_looking_ahead_needs_sensible_numbers(field):
    with pytest.raises(ValueError, match=rf"LookAhead.{field}"):
        LookAhead(**{field: 0})
