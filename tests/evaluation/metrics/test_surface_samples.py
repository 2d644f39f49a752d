"""Samples of the true surface: on it, evenly, inside of the grid."""

import numpy as np
import pytest

from coopmap_env.evaluation.metrics._surface_samples import clip_triangles, sample_surface
from coopmap_env.evaluation.metrics._triangle_distance import TriangleBins
from coopmap_env.geometry import Pose
from coopmap_env.mapping import VoxelGrid
from coopmap_env.simulation.scenes.field import (
    FieldWorld,
    Solid,
    box_corners,
    make_ground,
    solid_from_boxes,
)

GRID = VoxelGrid((40, 40, 20), 0.1, (-2.0, -2.0, -0.35))
BASE = Pose(np.array([1.5, 0.0, 0.0]), np.eye(3))


def world(*solids, grid=GRID):
    return FieldWorld("test", solids, "target", grid, (BASE,))


def box(name="box", size=(1, 1, 1), center=(0, 0, 0.5), is_target=True):
    return solid_from_boxes(name, [box_corners(size, center)], is_target=is_target)


def areas(triangles):
    a, b, c = np.moveaxis(triangles, 1, 0)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


def test_samples_lie_on_the_triangles_and_inside_of_the_grid():
    made = world(make_ground(GRID), box(), box("far", center=(1.9, 1.9, 0.5), is_target=False))
    samples = sample_surface(made, np.random.default_rng(0), 500)
    assert len(samples) == 500
    assert GRID.contains(GRID.index(samples.points)).all()
    bins = TriangleBins.from_triangles(made.triangles, GRID)
    np.testing.assert_allclose(bins.distances(samples.points), 0, atol=1e-12)


def test_samples_of_each_solid_are_proportional_to_its_area():
    # 16 m2 of ground in the grid, two boxes with 6 m2 and 1.5 m2
    small = box("small", (0.5, 0.5, 0.5), (1.5, 1.5, 0.5), is_target=False)
    samples = sample_surface(world(make_ground(GRID), box(), small), np.random.default_rng(0), 2350)
    assert samples.area == pytest.approx(23.5)
    counts = np.bincount(samples.solid_index)
    np.testing.assert_allclose(counts, [1600, 600, 150], atol=1.0)
    np.testing.assert_array_equal(samples.is_target, samples.solid_index == 1)


def test_samples_are_even_over_a_triangle():
    corners = np.array([[0.0, 0.0, 0.1], [1.2, 0.0, 0.1], [0.0, 0.9, 0.6]])
    made = world(Solid("one", corners, np.array([[0, 1, 2]]), is_target=True))
    n = 20_000
    points = sample_surface(made, np.random.default_rng(0), n).points
    # a triangle's centroid, and its second moment: sum of (corner - centroid)^2 / 12
    off = corners - corners.mean(axis=0)
    covariance = off.T @ off / 12
    error = 4 * np.sqrt(np.diag(covariance).max() / n)
    np.testing.assert_allclose(points.mean(axis=0), corners.mean(axis=0), atol=error)
    np.testing.assert_allclose(np.cov(points.T), covariance, atol=0.02 * covariance.max())


def test_normals_of_a_box_point_outward():
    samples = sample_surface(world(box()), np.random.default_rng(0), 600)
    np.testing.assert_allclose(np.linalg.norm(samples.normals, axis=1), 1)
    out = samples.points - (0, 0, 0.5)
    np.testing.assert_allclose(np.einsum("nk,nk->n", out, samples.normals), 0.5)


def test_the_underside_of_the_ground_has_no_samples():
    samples = sample_surface(world(make_ground(GRID), box()), np.random.default_rng(0), 400)
    assert samples.points[:, 2].min() >= 0


def test_the_same_generator_draws_the_same_samples():
    made = world(box())
    one, two = (sample_surface(made, np.random.default_rng(7), 50) for _ in range(2))
    np.testing.assert_array_equal(one.points, two.points)
    other = sample_surface(made, np.random.default_rng(8), 50)
    assert (one.points != other.points).any()


def test_a_triangle_is_cut_off_at_the_grid():
    grid = VoxelGrid((10, 10, 10), 0.1, (0, 0, 0))
    # half of the square [-1, 1]^2 at z = 0.5; x + y <= 0 but for (0, 0) is outside
    below = np.array([[[-1.0, -1, 0.5], [1, -1, 0.5], [-1, 1, 0.5]]])
    assert areas(clip_triangles(below, grid)[0]).sum() == pytest.approx(0)
    above = np.array([[[1.0, 1, 0.5], [-1, 1, 0.5], [1, -1, 0.5]]])
    pieces, source = clip_triangles(np.concatenate([below, above]), grid)
    assert areas(pieces).sum() == pytest.approx(1)
    inside = areas(pieces) > 0
    np.testing.assert_array_equal(source[inside], 1)
    a, b, c = np.moveaxis(pieces[inside], 1, 0)
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()  # turned as before


def test_the_parts_in_eight_grids_add_up_to_the_whole():
    triangles = np.random.default_rng(0).uniform(0, 2, (60, 3, 3))
    parts = [
        clip_triangles(triangles, VoxelGrid((10, 10, 10), 0.1, (x, y, z)))[0]
        for x in (0, 1)
        for y in (0, 1)
        for z in (0, 1)
    ]
    assert areas(np.concatenate(parts)).sum() == pytest.approx(areas(triangles).sum())


def test_a_world_without_a_surface_in_its_grid_is_rejected():
    outside = box(center=(9, 9, 0.5))
    with pytest.raises(ValueError, match="no surface of 'test' lies inside"):
        sample_surface(world(outside), np.random.default_rng(0))
    with pytest.raises(ValueError, match="at least 1, got 0"):
        sample_surface(world(box()), np.random.default_rng(0), 0)
