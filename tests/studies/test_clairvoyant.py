"""Policies that know the truth: they keep the constraints, and show what they can."""

from dataclasses import replace

import numpy as np
import pytest
from plain.planar_worlds import NO_NOISE, env_with_world, world_from_text
from plain.small_worlds import SETTINGS, small_world
from scipy import ndimage

from coopmap_env.evaluation import rollout
from coopmap_env.evaluation.bounds import BoundSearch, PlanarViews, bound_shown
from coopmap_env.studies.clairvoyant import ClairvoyantGreedy, ClairvoyantLookAhead, LookAhead
from coopmap_env.studies.clairvoyant._base_choices import STRIDE
from coopmap_env.studies.clairvoyant._true_rollouts import BASE

SHORT = LookAhead(n_scans=4, n_tried=4)
MODES = ({}, {"action_mode": "candidates", "n_candidates": 12})
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


@pytest.mark.parametrize("mode", MODES, ids=["pose", "candidates"])
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
                assert info["rejected_reason"] == ""
                assert not info["collided"]
            shown = shown.union(*views_of(views, env.belief().pose_ids))
            assert len(shown) == env.shown_mask.sum() <= bounds[scan]


@pytest.mark.parametrize("mode", MODES, ids=["pose", "candidates"])
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
