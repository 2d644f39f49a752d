"""Views in the field: what robots show from poses of a set, and bounds of what they can show."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

pytest.importorskip("pybullet")
pytest.importorskip("embreex")

from coopmap_env import field_v1
from coopmap_env.evaluation import make_policy, make_surface_evaluator, rollout
from coopmap_env.evaluation.bounds import (
    BoundFileError,
    BoundSearch,
    Certificate,
    FieldViews,
    bound_shown,
    load_bound,
    save_bound,
)
from coopmap_env.evaluation.bounds.field_views import list_samples_beside
from coopmap_env.mapping import OccupancyMap
from coopmap_env.robots import make_mount
from coopmap_env.sensing import DepthCamera

SETTINGS = field_v1.FieldSettings(
    camera=DepthCamera(width=16, height=12), crop_cells=(8, 4), max_grid_poses=40
)
EXACT_MAST = replace(make_mount("mast"), encoder_noise=0.0, calibration_error=0.0)
QUICK = BoundSearch(n_exchanges=100, n_rounds=4)


def field(**arguments):
    return field_v1.parallel_env(
        **{"settings": SETTINGS, "max_scans": 2, "report_shown": True, **arguments}
    )


def voxels_of(views, pose):
    sets = views.pose_sets(np.array([pose]))
    return set(views.voxels[sets.cells].tolist())


def random_joints(env, k, rng):
    return [space.sample(k, rng) for space in env.belief().joint_spaces]


@pytest.mark.parametrize("mount", [EXACT_MAST, "mast"])
def test_what_a_robot_shows_from_a_pose_of_the_set_is_in_the_view(mount):
    """Besides what its own body hides; encoders that err move the camera by millimetres."""
    env = field(n_robots=1, mount=mount, max_scans=1)
    rng = np.random.default_rng(0)
    n_shown = n_viewed = n_beside = 0
    for seed in range(3):
        env.reset(seed=seed)
        poses = env.belief().random_poses(0, 3, rng)
        views = FieldViews.from_env(env, joints=[poses])
        known = env.shown_mask.ravel()
        for k, q in enumerate(poses):
            env.reset(seed=seed)
            *_, infos = env.step({"robot_0": env.belief().action_for(0, q)})
            assert not infos["robot_0"]["collided"]
            shown = set(np.flatnonzero(env.shown_mask.ravel() & ~known).tolist())
            view = voxels_of(views, k)
            n_shown, n_viewed = n_shown + len(shown), n_viewed + len(view)
            n_beside += len(shown - view)
    env.close()
    assert n_shown > 1_000
    assert n_beside <= (0.001 if mount is EXACT_MAST else 0.15) * n_shown
    assert n_viewed <= 1.15 * n_shown


def test_surface_views_are_what_a_map_covers_that_has_the_voxels_shown():
    """One robot that scans once, whose encoders do not err: the voxels that it truly shows."""
    env = field(n_robots=1, mount=EXACT_MAST, max_scans=1)
    rng, n_exact = np.random.default_rng(3), 0
    env.reset(seed=0)
    evaluator = make_surface_evaluator(env, 0)
    poses = env.belief().random_poses(0, 4, rng)
    views = FieldViews.of_surface(env, evaluator, joints=[poses])
    assert len(views.voxels) == evaluator.visible.sum()
    assert not views.known.any()
    for k, q in enumerate(poses):
        env.reset(seed=0)
        env.step({"robot_0": env.belief().action_for(0, q)})
        shown = OccupancyMap(env.truth.grid)
        shown.mark_occupied(np.flatnonzero(env.shown_mask & env.truth.occupied))
        cells = views.pose_sets(np.array([k])).cells
        assert len(set(cells.tolist())) == len(cells)
        covered = evaluator.coverage(shown)
        assert len(cells) / len(views.voxels) == pytest.approx(covered, abs=1e-3)
        n_exact += len(cells) / len(views.voxels) == pytest.approx(covered, abs=1e-9)
    assert n_exact >= 3  # a ray along the border of a voxel may differ
    env.close()


@pytest.mark.parametrize("seed", range(3))
def test_samples_in_the_voxels_around_are_listed_once(seed):
    rng = np.random.default_rng(seed)
    shape = (5, 4, 3)
    counts = rng.integers(3, size=np.prod(shape))
    first = np.concatenate([[0], np.cumsum(counts)])
    shown = [np.flatnonzero(rng.random(len(counts)) < 0.05).astype(np.int32) for _ in range(4)]
    start = np.cumsum([0, *map(len, shown)])
    out_start, cells = np.zeros(5, dtype=np.int64), np.concatenate(shown)
    list_samples_beside(start, cells, shape, first, out_start, np.empty(0, np.int32))
    samples = np.empty(out_start[-1], dtype=np.int32)
    list_samples_beside(start, cells, shape, first, out_start, samples)
    index = np.indices(shape).reshape(3, -1).T
    for pose, own in enumerate(shown):
        found = samples[out_start[pose] : out_start[pose + 1]].tolist()
        wanted = []
        for voxel, count in enumerate(counts):
            is_near = (np.abs(index[own] - index[voxel]).max(axis=1, initial=0) <= 1).any()
            wanted += list(range(first[voxel], first[voxel] + count)) if is_near else []
        assert sorted(found) == wanted


def test_no_choice_of_poses_shows_more_than_the_bound():
    """All choices of two scans of two robots, of four poses each."""
    env = field()
    rng = np.random.default_rng(1)
    for seed, surfaces_only in product(range(2), [False, True]):
        env.reset(seed=seed)
        views = FieldViews.from_env(
            env, joints=random_joints(env, 4, rng), surfaces_only=surfaces_only
        )
        known = set(views.voxels[views.known].tolist())
        own = [voxels_of(views, pose) for pose in range(8)]
        choices = product(range(4), range(4), range(4, 8), range(4, 8))
        most = max(len(known.union(*(own[pose] for pose in choice))) for choice in choices)
        found = bound_shown(views, 2, QUICK)
        assert found.choice_shown[-1] <= most <= found.bounds[-1] <= 1.1 * most
        assert found.bounds[0] == len(known)
        one_each = max(len(known | own[a] | own[b]) for a, b in product(range(4), range(4, 8)))
        assert found.bounds[1] >= one_each
        assert {pose // 4 for pose in found.choice[:, 1].tolist()} == {1}
        for weight in (0, 1_000, 4_096):
            certificate = Certificate(np.full(len(views.known), weight, dtype=np.uint16))
            assert certificate.bounds(views, 2)[-1] >= most
    env.close()


@pytest.mark.parametrize("spec", ["random", "coverage"])
def test_candidates_of_the_joint_space_show_less_than_the_bound_of_its_grid(spec):
    env = field(action_mode="candidates", n_candidates=8, max_scans=3)
    policy = make_policy(spec)
    for seed in range(3):
        env.reset(seed=seed)
        occupied = env.truth.occupied
        bounds = [
            bound_shown(FieldViews.from_env(env, surfaces_only=only), 3, QUICK).bounds
            for only in (False, True)
        ]
        for scan, _ in enumerate(rollout(env, policy, seed), start=1):
            assert env.shown_mask.sum() <= bounds[0][scan]
            assert (env.shown_mask & occupied).sum() <= bounds[1][scan]
    env.close()


def test_the_set_is_home_and_the_grid_and_near_poses_share_a_block():
    env = field(n_robots=2)
    env.reset(seed=0)
    views, spaces = FieldViews.from_env(env), env.belief().joint_spaces
    for own, space, mount in zip(views.joints, spaces, env.mounts, strict=True):
        np.testing.assert_array_equal(own, np.vstack([mount.home, space.grid()]))
    k = len(views.joints[0])
    assert len(views.blocks) == 2 * k
    assert not set(views.blocks[:k]) & set(views.blocks[k:])
    np.testing.assert_array_equal(views.earliest[0], np.repeat([1, 3], k))
    np.testing.assert_array_equal(views.earliest[1], np.repeat([3, 1], k))
    weights = np.random.default_rng(0).integers(100, size=len(views.known))
    best = views.best(weights)
    for pose in (0, 5, k + 3):
        cells = views.pose_sets(np.array([pose])).cells
        assert best.scores[pose] == weights[cells].sum()
        assert not views.known[cells].any()
    env.close()


def test_a_choice_is_what_exchanges_of_single_views_cannot_improve(tmp_path):
    env = field()
    env.reset(seed=0)
    views = FieldViews.from_env(env, joints=random_joints(env, 12, np.random.default_rng(2)))
    choice = views.choose(2, 10_000)
    assert views.can_take(choice)
    assert not views.can_take(choice[:, ::-1])  # poses of the other robot
    assert not views.can_take(choice + 24)

    def count(poses):
        return len(set().union(*(voxels_of(views, pose) for pose in poses)))

    most = count(choice.ravel().tolist())
    for scan, robot in product(range(2), range(2)):
        for pose in range(12 * robot, 12 * robot + 12):
            other = choice.copy()
            other[scan, robot] = pose
            assert count(other.ravel().tolist()) <= most
    found = bound_shown(views, 2, QUICK)
    save_bound(tmp_path / "bound.npz", found, views)
    np.testing.assert_array_equal(load_bound(tmp_path / "bound.npz", views).bounds, found.bounds)
    env.reset(seed=1)
    with pytest.raises(BoundFileError, match="belongs to another world"):
        load_bound(tmp_path / "bound.npz", FieldViews.from_env(env))
    env.close()


def test_what_no_views_are_made_of():
    with pytest.raises(ValueError, match="need a field environment, got"):
        FieldViews.from_env(object())
    env = field(n_robots=1, max_scans=3)
    env.reset(seed=0)
    (good,) = random_joints(env, 2, np.random.default_rng(0))
    with pytest.raises(ValueError, match="one set of poses for each of 1 robots is needed, got 2"):
        FieldViews.from_env(env, joints=[good, good])
    with pytest.raises(ValueError, match=r"\(k, n\) with at least one, got \(0, "):
        FieldViews.from_env(env, joints=[good[:0]])
    with pytest.raises(ValueError, match="outside of its limits"):
        FieldViews.from_env(env, joints=[good + 100.0])
    with pytest.raises(ValueError, match="n_scans must be an integer of at least 1"):
        FieldViews.from_env(env, 0)
    env.step({"robot_0": env.belief().action_for(0, good[0])})
    with pytest.raises(ValueError, match="reset it"):
        FieldViews.from_env(env)
    env.close()
