"""Exact distances to triangles."""

import numpy as np
import pytest
from plain import true_surfaces as plain

from coopmap_env.evaluation.metrics._triangle_distance import TriangleBins, squared_distance
from coopmap_env.mapping import VoxelGrid

GRID = VoxelGrid((20, 20, 20), 0.1, (-1, -1, -1))
WAY = np.empty(3)
"""Buffer for the way to the nearest point."""
RIGHT = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])


@pytest.mark.parametrize(
    ("point", "distance"),
    [
        ((0.25, 0.25, 0.5), 0.5),  # over the face
        ((0.25, 0.25, -0.5), 0.5),  # under it
        ((0.5, -0.3, 0.4), 0.5),  # beside an edge
        ((1.0, 1.0, 0.0), np.sqrt(0.5)),  # beside the longest edge
        ((-0.3, -0.4, 1.2), 1.3),  # at a corner
        ((0.2, 0.3, 0.0), 0.0),
    ],
)
def test_distance_of_a_point_to_a_triangle(point, distance):
    point = np.array(point)
    for k in range(3):  # whichever corner comes first, on whichever side
        turned = np.roll(RIGHT, k, axis=0)
        for corners in (turned, turned[::-1]):
            found = np.sqrt(squared_distance(point, corners, WAY))
            assert found == pytest.approx(distance, abs=1e-12)


def test_a_triangle_may_be_a_line_or_a_point():
    line = np.array([[0.0, 0, 0], [0.5, 0, 0], [1, 0, 0]])
    assert squared_distance(np.array([0.7, 0.3, 0.4]), line, WAY) == pytest.approx(0.25)
    assert squared_distance(np.array([0.0, 0.3, 0.4]), np.zeros((3, 3)), WAY) == pytest.approx(0.25)


def random_triangles(rng, n):
    middles = rng.uniform(-1.1, 1.1, (n, 1, 3))
    return middles + rng.uniform(-1, 1, (n, 3, 3)) * rng.choice([0.02, 0.3, 1.0], (n, 1, 1))


@pytest.mark.parametrize("n", [1, 5, 60])
def test_bins_agree_with_every_point_against_every_triangle(n):
    rng = np.random.default_rng(n)
    bins = TriangleBins.from_triangles(random_triangles(rng, n), GRID)
    points = rng.uniform(-1.6, 1.6, (120, 3))  # beyond the grid as well
    expected = plain.nearest_distances(points, bins.triangles)
    np.testing.assert_allclose(bins.distances(points), expected, rtol=1e-9, atol=1e-9)


def test_distances_agree_with_trimesh():
    triangles_of = pytest.importorskip("trimesh").triangles
    rng = np.random.default_rng(3)
    triangles, points = random_triangles(rng, 200), rng.uniform(-1, 1, (200, 3))
    nearest = triangles_of.closest_point(triangles, points)
    expected = np.linalg.norm(nearest - points, axis=1)
    found = [np.sqrt(squared_distance(p, t, WAY)) for p, t in zip(points, triangles, strict=True)]
    np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-9)


def test_order_of_points_and_triangles_does_not_matter():
    rng = np.random.default_rng(4)
    triangles, points = random_triangles(rng, 40), rng.uniform(-1, 1, (50, 3))
    expected = TriangleBins.from_triangles(triangles, GRID).distances(points)
    shuffle = rng.permutation(50)
    turned = np.roll(rng.permutation(triangles), 1, axis=1)
    found = TriangleBins.from_triangles(turned, GRID).distances(points[shuffle])
    np.testing.assert_allclose(found, expected[shuffle], rtol=1e-9, atol=1e-12)


def test_nothing_is_infinitely_far():
    bins = TriangleBins.from_triangles(RIGHT[None] + 9, GRID)
    assert np.isinf(bins.distances([[0, 0, 0]])).all()
    assert bins.distances(np.empty((0, 3))).shape == (0,)


def test_wrong_arguments_are_rejected():
    bins = TriangleBins.from_triangles(RIGHT[None], GRID)
    with pytest.raises(ValueError, match=r"must be \(n, 3\), got shape \(1, 2\)"):
        bins.distances([[0, 0]])
    with pytest.raises(ValueError, match=r"must be finite, got \[0.0, nan, 0.0\] at 1"):
        bins.distances([[0, 0, 0], [0, np.nan, 0]])
    with pytest.raises(ValueError, match=r"no triangles inside the grid VoxelGrid\(.* to lead to"):
        TriangleBins.from_triangles(RIGHT[None] + 9, GRID).offsets([[0, 0, 0]])
    with pytest.raises(ValueError, match="3 axes"):
        TriangleBins.from_triangles(RIGHT[None], VoxelGrid((4, 4)))
