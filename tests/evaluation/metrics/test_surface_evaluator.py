"""The surface evaluator of a worksite."""

import dataclasses

import numpy as np
import pytest
from plain import true_surfaces as plain

from coopmap_env.evaluation.metrics.surface import SurfaceEvaluator
from coopmap_env.mapping import OccupancyMap
from coopmap_env.robots import Vehicle
from coopmap_env.sensing import DepthCamera
from coopmap_env.simulation.scenes.field import make_field_scene

pytest.importorskip("embreex")
pytest.importorskip("trimesh")


@pytest.fixture(scope="module")
def world():
    return make_field_scene("worksite").world(np.random.default_rng(0), 2)


def evaluator_of(world, n_poses=60, **settings):
    vehicles = [Vehicle.from_mount("mast", base) for base in world.base_poses]
    rng = np.random.default_rng(5)
    return SurfaceEvaluator(world, vehicles, DepthCamera(), rng, 3000, n_poses, **settings)


@pytest.fixture(scope="module")
def evaluator(world):
    return evaluator_of(world)


def true_map(world):
    map_ = OccupancyMap(world.grid)
    map_.mark_occupied(np.flatnonzero(world.occupied))
    return map_


def test_part_of_the_surface_and_of_the_target_is_visible(evaluator):
    assert 0.5 < evaluator.visible.mean() < 0.99
    assert 0.3 < evaluator.visible[evaluator.samples.is_target].mean() < 0.99


def test_points_under_the_ground_or_far_from_all_robots_are_not_visible(world, evaluator):
    points = evaluator.samples.points[evaluator.visible]
    assert points[:, 2].min() > -1e-9
    bases = np.array([base.translation for base in world.base_poses])
    nearest = np.linalg.norm(points[:, None] - bases, axis=2).min(axis=1)
    assert nearest.max() < DepthCamera().far + 2.6  # a mast is that long


def test_more_poses_and_more_robots_see_more(world, evaluator):
    more = evaluator_of(world, 200)
    np.testing.assert_array_equal(more.samples.points, evaluator.samples.points)
    assert more.visible.mean() > evaluator.visible.mean()
    one = dataclasses.replace(world, base_poses=world.base_poses[:1])
    assert evaluator_of(one).visible.mean() < evaluator.visible.mean()


def test_an_empty_map_covers_nothing_and_the_truth_everything(world, evaluator):
    empty, truth = OccupancyMap(world.grid), true_map(world)
    assert evaluator.coverage(empty) == evaluator.target_coverage(empty) == 0
    assert evaluator.coverage(truth) == evaluator.target_coverage(truth) == 1
    scores = evaluator.scores(empty)
    assert (scores.f_score, scores.precision, scores.recall) == (0, 0, 0)
    assert np.isfinite(scores.chamfer)


def test_coverage_is_that_of_the_visible_samples(world, evaluator):
    map_ = OccupancyMap(world.grid)
    rng = np.random.default_rng(1)
    occupied = np.flatnonzero(world.occupied)
    map_.mark_occupied(rng.choice(occupied, len(occupied) // 20, replace=False))
    covered = plain.covered_mask(map_, evaluator.samples.points)
    assert evaluator.coverage(map_) == covered[evaluator.visible].mean()
    on_target = evaluator.visible & evaluator.samples.is_target
    assert evaluator.target_coverage(map_) == covered[on_target].mean()
    assert evaluator.scores(map_).coverage == evaluator.coverage(map_)


def test_the_same_generator_gives_the_same_evaluator(world, evaluator):
    np.testing.assert_array_equal(evaluator_of(world).visible, evaluator.visible)


def test_tau_is_one_voxel_unless_given(world, evaluator):
    assert evaluator.tau == world.grid.resolution
    assert evaluator_of(world, 1, tau=0.25).tau == 0.25
