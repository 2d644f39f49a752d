"""Whether surface covariances are as large as their errors."""

import numpy as np
import pytest
from scipy.stats import chi2 as chi_square

from coopmap_env.evaluation.metrics import SurfaceConsistency, cell_face_offsets, surface_chi2
from coopmap_env.evaluation.metrics._triangle_distance import TriangleBins
from coopmap_env.evaluation.metrics.surface_consistency import HONEST_MEDIAN, TAIL_BEGINS
from coopmap_env.mapping import VoxelGrid


def test_the_constants_are_those_of_chi_square_with_one_degree_of_freedom():
    assert chi_square(1).median() == pytest.approx(HONEST_MEDIAN, abs=5e-4)
    assert chi_square(1).ppf(0.95) == pytest.approx(TAIL_BEGINS, abs=5e-3)


def test_a_distance_of_two_sigma_gives_four_whatever_the_other_direction():
    C = np.diag([0.01, 5.0])
    assert surface_chi2([[0.2, 0.0], [-0.2, 0.0], [0.0, 0.0]], [C] * 3) == pytest.approx([4, 4, 0])


def test_on_a_plane_it_is_the_least_mahalanobis_distance():
    rng = np.random.default_rng(0)
    for _ in range(20):
        A = rng.normal(size=(3, 3))
        C = A @ A.T + 0.1 * np.eye(3)
        normal = rng.normal(size=3)
        normal /= np.linalg.norm(normal)
        (found,) = surface_chi2([0.3 * normal], [C])
        # Lagrange: the least (v^T C^-1 v) over v . normal = d is d**2 / (normal^T C normal)
        v = 0.3 * C @ normal / (normal @ C @ normal)
        assert v @ normal == pytest.approx(0.3)
        assert found == pytest.approx(v @ np.linalg.solve(C, v))


def test_honest_points_have_the_honest_summary_and_half_the_sigma_does_not():
    rng = np.random.default_rng(1)
    sigma = rng.uniform(0.01, 0.1, 20_000)
    offsets = np.column_stack([sigma * rng.normal(size=20_000), np.zeros(20_000)])
    C = sigma[:, None, None] ** 2 * np.eye(2)
    honest = SurfaceConsistency.from_chi2(surface_chi2(offsets, C))
    assert honest.n_points == 20_000
    assert honest.median == pytest.approx(HONEST_MEDIAN, abs=0.02)
    assert honest.tail == pytest.approx(0.05, abs=0.006)
    confident = SurfaceConsistency.from_chi2(surface_chi2(offsets, C / 4))
    assert confident.median == pytest.approx(4 * honest.median)
    assert confident.tail > 0.3


def test_no_points_have_no_summary_and_no_uncertainty_off_the_surface_is_infinite():
    empty = SurfaceConsistency.from_chi2(surface_chi2(np.zeros((0, 2)), np.zeros((0, 2, 2))))
    assert empty.n_points == 0
    assert np.isnan([empty.median, empty.tail]).all()
    assert surface_chi2([[0.1, 0.0]], np.zeros((1, 2, 2))) == np.inf


def test_shapes_that_do_not_fit_are_rejected():
    with pytest.raises(ValueError, match="do not fit together"):
        surface_chi2(np.zeros((3, 2)), np.zeros((2, 2, 2)))


def plain_offset(point, occupied):
    """By the distance to every face."""
    best = None
    for i, j in np.argwhere(occupied):
        for axis, side in ((0, 0), (0, 1), (1, 0), (1, 1)):
            other = np.array([i, j])
            other[axis] += 2 * side - 1
            inside = (other >= 0).all() and (other < occupied.shape).all()
            if not inside or occupied[tuple(other)]:
                continue
            nearest = np.clip(point, [i, j], [i + 1, j + 1])
            nearest[axis] = (i, j)[axis] + side
            if best is None or np.linalg.norm(nearest - point) < np.linalg.norm(best - point):
                best = nearest
    return best - point


def test_offsets_to_faces_are_those_of_the_plain_search():
    rng = np.random.default_rng(2)
    grid = VoxelGrid((13, 9), 0.5, (-2.0, 1.0))
    for density in (0.03, 0.2, 0.8):
        occupied = rng.random(grid.shape) < density
        points = rng.uniform([-1, -1], [14, 10], (100, 2))
        offsets = cell_face_offsets(grid.origin + 0.5 * points, occupied, grid)
        wanted = np.array([plain_offset(point, occupied) for point in points])
        # of two faces at the same distance either is right
        assert np.hypot(*offsets.T) == pytest.approx(0.5 * np.hypot(*wanted.T), abs=1e-12)
        assert np.mean(np.abs(offsets - 0.5 * wanted).max(axis=1) < 1e-9) > 0.97


def test_a_world_without_faces_or_a_truth_of_another_shape_is_rejected():
    grid = VoxelGrid((4, 4))
    for occupied in (np.zeros((4, 4), bool), np.ones((4, 4), bool)):
        with pytest.raises(ValueError, match="no face"):
            cell_face_offsets([[1.0, 1.0]], occupied, grid)
    with pytest.raises(ValueError, match="planar grid"):
        cell_face_offsets([[1.0, 1.0]], np.zeros((3, 4), bool), grid)


def test_offsets_to_triangles_lead_to_the_nearest_point():
    rng = np.random.default_rng(3)
    triangles = rng.uniform(0.2, 1.8, (30, 3, 3))
    bins = TriangleBins.from_triangles(triangles, VoxelGrid((10, 10, 10), 0.2))
    points = rng.uniform(0, 2, (200, 3))
    offsets = bins.offsets(points)
    assert np.linalg.norm(offsets, axis=1) == pytest.approx(bins.distances(points), abs=1e-12)
    assert bins.distances(points + offsets) == pytest.approx(np.zeros(200), abs=1e-7)


def test_without_triangles_there_is_nowhere_to_lead_to():
    bins = TriangleBins.from_triangles(np.zeros((0, 3, 3)), VoxelGrid((4, 4, 4)))
    with pytest.raises(ValueError, match="no triangles"):
        bins.offsets(np.zeros((1, 3)))
