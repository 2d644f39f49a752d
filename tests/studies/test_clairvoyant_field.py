"""Field policies that know the truth: they keep the constraints, and cover what they can."""

from dataclasses import replace

import numpy as np
import pytest
from plain.field_worlds import GRID, crate, flat_world

pytest.importorskip("pybullet")
pytest.importorskip("embreex")

from coopmap_env import field_v1
from coopmap_env.core.kernels import make_plain
from coopmap_env.evaluation import rollout
from coopmap_env.evaluation.bounds import PoseSets
from coopmap_env.evaluation.rollout import policy_rng
from coopmap_env.sensing import DepthCamera
from coopmap_env.studies.clairvoyant import (
    ClairvoyantFieldGreedy,
    ClairvoyantFieldLookAhead,
    FieldLookAhead,
    surface_views,
    true_pose_sets,
)
from coopmap_env.studies.clairvoyant._true_views import (
    BASE,
    TrueViews,
    best_limit,
    choose_step,
    play_on,
)

SETTINGS = field_v1.FieldSettings(
    camera=DepthCamera(width=24, height=18), crop_cells=(8, 4), max_grid_poses=40
)


def few(env, n_drawn=20):
    return lambda rng: surface_views(env, rng, n_drawn)


POLICIES = {
    "greedy": lambda env: ClairvoyantFieldGreedy(env, few(env)),
    "look-ahead": lambda env: ClairvoyantFieldLookAhead(env, few(env), FieldLookAhead(n_tried=4)),
}
INF = float("inf")


def field(**arguments):
    return field_v1.parallel_env(**{"settings": SETTINGS, "max_scans": 3, **arguments})


def random_views(rng, n_poses=(4, 5), n_samples=30, n_joints=2):
    """Few poses of two robots that cover random samples."""
    own = [
        np.flatnonzero(rng.random(n_samples) < 0.3).astype(np.int32) for _ in range(sum(n_poses))
    ]
    sets = PoseSets(np.cumsum([0, *map(len, own)]), np.concatenate(own))
    joints = tuple(rng.integers(4, size=(k, n_joints)).astype(float) for k in n_poses)
    speeds = [np.ones(n_joints), np.full(n_joints, 0.5)]
    views = TrueViews.from_sets(sets, n_samples, joints, speeds, 2.0)
    return views, [set(one.tolist()) for one in own]


def gains_of(own, covered):
    return np.array([len(one - covered) for one in own])


def times_of(views, at):
    robots = np.repeat(np.arange(2), np.diff(views.first))
    return (np.abs(views.joints - at[robots]) / views.speeds[robots]).max(axis=1)


def plain_limit(views, possible, times, gains, given, left):
    """The motion time with the most samples per second, by trying all."""
    ranges = [range(views.first[r], views.first[r + 1]) for r in range(2)]
    least = max([0.0, *(times[p] for p in given if p != BASE)])
    rates = []
    for limit in sorted({least, *times[possible]}):
        best = []
        for own, pose in zip(ranges, given, strict=True):
            usable = [gains[p] for p in own if possible[p] and times[p] <= limit]
            if pose != BASE:
                usable = [gains[pose]]
            elif not possible[list(own)].any():
                usable = [0]
            best.append(max(usable, default=None))
        if None not in best and limit >= least:
            rates.append((sum(best) / min(limit + 2.0, left), -limit))
    return -max(rates)[1] if rates else INF


def plain_step(views, own, possible, times, covered, given, left):
    """Poses of a step, and the samples newly covered."""
    limit = INF
    if left < INF:
        limit = plain_limit(views, possible, times, gains_of(own, covered), given, left)
    chosen, before = list(given), len(covered)
    for robot in range(2):
        if chosen[robot] == BASE:
            usable = [
                p
                for p in range(views.first[robot], views.first[robot + 1])
                if possible[p] and times[p] <= limit
            ]
            if usable:
                gains = gains_of(own, covered)
                chosen[robot] = min(usable, key=lambda p: (-gains[p], times[p]))
        if chosen[robot] != BASE:
            covered |= own[chosen[robot]]
    return chosen, len(covered) - before


@pytest.mark.parametrize("left", [INF, 1.5, 6.0, 40.0])
def test_a_step_is_what_a_plain_reference_chooses(left):
    rng = np.random.default_rng(0)
    for _ in range(30):
        views, own = random_views(rng)
        possible, at = rng.random(9) < 0.7, rng.integers(4, size=(2, 2)).astype(float)
        start = set(np.flatnonzero(rng.random(30) < 0.3).tolist())
        given = [BASE if rng.random() < 0.7 else int(views.first[r]) for r in range(2)]
        times, gains = times_of(views, at), gains_of(own, start)
        covered = np.isin(np.arange(30), list(start))
        chosen = np.array(given)
        wanted_limit = plain_limit(views, possible, times, gains, given, left)
        if left < INF and wanted_limit < INF:
            limit = best_limit(views.first, possible, times, gains, chosen, 2.0, left)
            assert possible[times <= limit].tolist().count(True) >= 1 or BASE not in given
        n = choose_step(make_plain(views), possible, times, covered, gains, left, chosen)
        wanted, n_wanted = plain_step(views, own, possible, times, start, given, left)
        assert chosen.tolist() == wanted
        assert n == n_wanted
        assert set(np.flatnonzero(covered).tolist()) == start
        np.testing.assert_array_equal(gains, gains_of(own, start))  # kept up to date


def test_the_time_of_a_step_is_what_brings_most_per_second():
    """By hand: one robot covers 4 samples after 1 s, or 5 after 3 s; a scan takes 2 s."""
    first, times = np.array([0, 2]), np.array([1.0, 3.0])
    gains, given, possible = np.array([4, 5]), np.array([BASE]), np.ones(2, dtype=np.bool_)
    assert best_limit(first, possible, times, gains, given, 2.0, 100.0) == 1.0  # 4 / 3 > 5 / 5
    assert best_limit(first, possible, times, gains, given, 2.0, 3.0) == 3.0  # 4 / 3 < 5 / 3
    gains = np.array([2, 5])
    assert best_limit(first, possible, times, gains, given, 2.0, 100.0) == 3.0  # 2 / 3 < 5 / 5


def test_robots_do_not_cover_the_same_samples_and_of_equal_poses_take_the_nearest():
    """By hand: both could cover 0, 1 and 2; the second one covers 3 instead, at its nearer pose."""
    own = [[0, 1, 2], [3], [0, 1, 2], [0, 3], [3]]
    sets = PoseSets(np.cumsum([0, *map(len, own)]), np.concatenate(own).astype(np.int32))
    joints = (np.array([[1.0], [0.0]]), np.array([[0.0], [3.0], [2.0]]))
    views = TrueViews.from_sets(sets, 4, joints, [np.ones(1), np.ones(1)], 2.0)
    chosen, covered = np.full(2, BASE), np.zeros(4, dtype=np.bool_)
    gains = np.array([3, 1, 3, 2, 1])
    times = np.array([1.0, 0.0, 0.0, 3.0, 2.0])
    n = choose_step(
        make_plain(views), np.ones(5, dtype=np.bool_), times, covered, gains, INF, chosen
    )
    assert chosen.tolist() == [0, 4]
    assert (n, gains.tolist()) == (4, [0, 0, 0, 0, 0])


@pytest.mark.parametrize("left", [INF, 9.0])
def test_a_plan_is_played_step_by_step(left):
    rng = np.random.default_rng(1)
    for _ in range(20):
        views, own = random_views(rng)
        now, at = rng.random(9) < 0.7, rng.integers(4, size=(2, 2)).astype(float)
        later = np.ones(9, dtype=np.bool_)
        plan = np.full((4, 2), BASE)
        plan[0] = [0, BASE]
        plan[2] = [1, 5]
        played, shown = plan.copy(), np.zeros(4, dtype=np.int64)
        covered, gains = np.zeros(30, dtype=np.bool_), gains_of(own, set())
        n = play_on(make_plain(views), (now, later), at, covered, gains, left, played, shown)
        samples, seconds, wanted_n = set(), left, 0
        for scan in range(4):
            possible, times = later if scan else now, times_of(views, at)
            given = [p if p == BASE or possible[p] else BASE for p in plan[scan].tolist()]
            chosen, count = plain_step(views, own, possible, times, samples, given, seconds)
            assert played[scan].tolist() == chosen
            assert shown[scan] == count
            moved = [times[p] for p in chosen if p != BASE]
            at = np.array([
                views.joints[p] if p != BASE else q for p, q in zip(chosen, at, strict=True)
            ])  # fmt: skip
            seconds, wanted_n = seconds - max(moved, default=0.0) - 2.0, scan + 1
            if seconds <= 0:
                break
        assert n == wanted_n


@pytest.mark.parametrize("name", POLICIES)
def test_no_constraint_is_broken_and_the_same_seed_gives_the_same_episode(name):
    for n_played, clock in ((1, {"max_scans": 2}), (2, {"max_time": 5.0, "max_scans": 30})):
        env = field(**clock)
        policy, ends = POLICIES[name](env), []
        for _ in range(n_played):
            for step in rollout(env, policy, 3):
                for info in step.infos.values():
                    assert info["rejected_reason"] == 0
                    assert not info["collided"]
            ends.append([q.tolist() for q in env.belief().joints])
            assert 0.2 < policy._covered(env.belief()).mean() < 1
        assert ends[0] == ends[-1]
        env.close()


@pytest.mark.parametrize("clock", [{}, {"max_time": 5.0}])
def test_greedy_is_what_trying_all_poses_says(clock):
    """Beside sets of samples, at every step: what is in the team's map is covered already."""
    env = field(settings=replace(SETTINGS, max_grid_poses=1), max_scans=2, **clock)
    policy = ClairvoyantFieldGreedy(env, few(env, 9))
    observations, _ = env.reset(seed=1)
    policy.reset(policy_rng(1))
    views = policy._views
    own = [
        set(views.cells[views.start[p] : views.start[p + 1]].tolist())
        for p in range(len(views.joints))
    ]
    while env.agents:
        belief = env.belief()
        feasible, times = [], []
        for robot, poses in enumerate(policy._joints):
            feasible += [not belief.infeasibility_reason(robot, q) for q in poses]
            times += belief.motion_time(robot, poses).tolist()
        covered = set(np.flatnonzero(policy._covered(belief)).tolist())
        wanted, _ = plain_step(
            views, own, np.array(feasible), np.array(times), covered, [BASE, BASE],
            belief.budget.time,
        )  # fmt: skip
        actions = policy.act(belief, observations)
        for robot, agent in enumerate(env.agents):
            pose = belief.actions.decode(agent, actions[agent], belief).pose
            np.testing.assert_array_equal(pose, views.joints[wanted[robot]])
        observations, *_ = env.step(actions)
    env.close()


def test_what_the_first_scans_cover_is_nearly_what_was_expected():
    """Some voxels that rays graze are not occupied on the map; no own body hides a view."""
    env = field()
    policy = ClairvoyantFieldGreedy(env, few(env))
    for seed in range(2):
        observations, _ = env.reset(seed=seed)
        policy.reset(policy_rng(seed))
        belief, (start, cells) = env.belief(), policy._views[:2]
        covered = policy._covered(belief)
        assert not covered.any()
        for pose in policy._choose(belief):
            covered[cells[start[pose] : start[pose + 1]]] = True
        env.step(policy.act(belief, observations))
        assert 0.7 < policy._covered(env.belief()).mean() / covered.mean() < 1.02
    env.close()


class Stall:
    """A mast between two crates, higher than it is."""

    name, grid = "stall", GRID

    def world(self, rng, n_robots, footprint=1.2):
        sides = [crate(f"side_{y}", 0.0, y, 1.2, (0.6, 0.4, 2.4)) for y in (-0.9, 0.9)]
        return flat_world(*sides)


def test_poses_of_the_set_touch_nothing_in_the_true_world_and_can_be_actions():
    env = field(scene=Stall(), n_robots=1)
    env.reset(seed=0)
    (poses,) = true_pose_sets(env, np.random.default_rng(0), 100)
    (again,) = true_pose_sets(env, np.random.default_rng(0), 100)
    np.testing.assert_array_equal(poses, again)
    space, (vehicle,) = env.belief().joint_spaces[0], env.diagnostics.true_vehicles
    np.testing.assert_array_equal(space.denormalize(space.normalize(poses)), poses)
    assert 10 < len(poses) < 1 + len(space.grid()) + 100
    y = vehicle.camera_poses(poses)[1][:, 1]
    z = vehicle.camera_poses(poses)[1][:, 2]
    assert (np.abs(y[z < 2.3]) < 0.7).all()  # the crates begin there
    env.close()


def test_only_field_environments_with_poses_have_these_policies():
    with pytest.raises(ValueError, match="needs a field environment, got"):
        ClairvoyantFieldGreedy(object())
    env = field(action_mode="candidates", n_candidates=4)
    with pytest.raises(ValueError, match=r"FieldLookAhead.n_tried"):
        FieldLookAhead(n_tried=0)
    observations, _ = env.reset(seed=0)
    policy = ClairvoyantFieldGreedy(env, few(env, 0))
    policy.reset(policy_rng(0))
    with pytest.raises(ValueError, match="acts in 'pose' mode, not on candidates"):
        policy.act(env.belief(), observations)
    env.close()
