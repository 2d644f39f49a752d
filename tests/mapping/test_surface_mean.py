"""The surface of a cell as the mean of its points: hand numbers, plain reference, honesty."""

import itertools
import math

import numpy as np
import pytest
from plain.random_scans import random_scan

from coopmap_env.core.linear_algebra import smallest_eigenvalue
from coopmap_env.mapping import BeamModel, OccupancyMap, VoxelGrid
from coopmap_env.sensing import Scan

MODEL = BeamModel(surface_fusion="mean")
FLOOR = 1e-4
"""Variance of a hundredth of a cell of one metre."""
ROOM = VoxelGrid((8, 8, 8))
CAMERA = np.array([0.5, 3.5, 3.5])


def scan_of(points, covariances, origin, pose_covariance=None):
    points = np.array(points, dtype=float)
    n, d = points.shape
    matrices = np.broadcast_to(np.asarray(covariances, dtype=float), (n, d, d)).copy()
    return Scan(np.array(origin, float), points, matrices, np.ones(n, bool), pose_covariance)


def skew(q):
    return np.array([[0, -q[2], q[1]], [q[2], 0, -q[0]], [-q[1], q[0], 0]])


class PlainSurfaces:
    """Points of each cell with the scans that they come from."""

    def __init__(self, grid):
        self.grid, self.points = grid, {}

    def add(self, scan, cells):
        floor = (0.01 * self.grid.resolution) ** 2 * np.eye(self.grid.dimension)
        for k in np.flatnonzero(cells >= 0):
            row = (scan, scan.points[k], scan.covariances[k] + floor)
            self.points.setdefault(int(cells[k]), []).append(row)

    def gaussian(self, cell):
        rows, D = self.points[cell], self.grid.dimension
        n = len(rows)
        center = self.grid.center(np.array(np.unravel_index(cell, self.grid.shape)))
        x = np.array([point for *_, point, _ in rows])
        C = sum(C for *_, C in rows)
        for scan, *_ in rows:
            if scan.pose_covariance is not None:
                J = np.hstack([np.eye(3), -skew(center - scan.origin)])
                C = C + (n - 1) * J @ scan.pose_covariance @ J.T
        C = C / n**2
        deviations = x - x.mean(axis=0)
        scatter = deviations.T @ deviations / n - sum(C for *_, C in rows) / n + C
        if n > D:
            C = C + max(np.linalg.eigvalsh(scatter)[0], 0) * n / (n - D) * np.eye(D)
        return x.mean(axis=0), C


def test_the_mean_of_two_points_of_one_scan_by_hand():
    """Sigma 0.1 and 0.3 along x; the camera's pose adds 0.02 to both, which does not average."""
    pose_covariance = np.zeros((6, 6))
    pose_covariance[0, 0] = 0.02
    covariances = [np.diag([variance + 0.02, 0, 0]) for variance in (0.01, 0.09)]
    map_ = OccupancyMap(ROOM, MODEL)
    map_.integrate(
        scan_of([[4.1, 3.4, 3.5], [4.2, 3.6, 3.5]], covariances, CAMERA, pose_covariance)
    )
    cells, means, C = map_.surfaces()
    assert cells.tolist() == [ROOM.flat_index([4, 3, 3])]
    assert means[0] == pytest.approx([4.15, 3.5, 3.5])
    assert C[0] == pytest.approx(np.diag([0.1 / 4 + 0.02, 0, 0]) + FLOOR / 2 * np.eye(3), abs=1e-12)


def test_points_of_two_scans_halve_the_noise_but_not_the_error_of_the_pose():
    pose_covariance = np.zeros((6, 6))
    pose_covariance[0, 0] = 0.02
    map_ = OccupancyMap(ROOM, MODEL)
    for y in (3.4, 3.6):
        map_.integrate(scan_of([[4.1, y, 3.5]], np.diag([0.03, 0, 0]), CAMERA, pose_covariance))
    _, _, C = map_.surfaces()
    expected = np.diag([0.01 / 2 + 0.02, 0, 0]) + FLOOR / 2 * np.eye(3)
    assert C[0] == pytest.approx(expected, abs=1e-12)


def test_a_common_pose_error_does_not_shrink_with_the_number_of_points():
    """A thousand points of one scan: what is left is the error of the camera."""
    rng = np.random.default_rng(0)
    A = 0.01 * rng.normal(size=(6, 6))
    sigma = A @ A.T
    center = np.array([4.5, 3.5, 3.5])
    J = np.hstack([np.eye(3), -skew(center - CAMERA)])
    shared = J @ sigma @ J.T
    points = center + np.column_stack([np.zeros(1000), rng.uniform(-0.4, 0.4, (1000, 2))])
    map_ = OccupancyMap(ROOM, MODEL)
    map_.integrate(scan_of(points, shared + 1e-4 * np.eye(3), CAMERA, sigma))
    _, _, C = map_.surfaces()
    assert C[0] == pytest.approx(shared, rel=1e-2, abs=1e-6)


def random_scans(grid, n, rng):
    for _ in range(n):
        scan = random_scan(rng, grid)
        if grid.dimension == 2:
            yield scan
            continue
        A = 0.05 * rng.normal(size=(6, 6))
        covariances = scan.covariances + 0.02 * np.eye(3)
        yield Scan(scan.origin, scan.points, covariances, scan.hit, A @ A.T)


GRIDS = [
    pytest.param(VoxelGrid((9, 7), 0.5, (-2.0, 1.0)), id="2-D"),
    pytest.param(VoxelGrid((5, 4, 6), 0.25, (0.5, -1.0, 2.0)), id="3-D"),
]


def hit_cells_of(scan, grid):
    """Cells of the points of a scan, beam by beam."""
    cells = np.full(len(scan.points), -1)
    for k in np.flatnonzero(scan.hit):
        map_ = OccupancyMap(grid, MODEL)
        rows = (scan.points, scan.covariances, scan.hit)
        map_.integrate(Scan(scan.origin, *(row[k : k + 1] for row in rows)))
        cells[k] = next(iter(map_.hit_cells), -1)
    return cells


@pytest.mark.parametrize("grid", GRIDS)
def test_surfaces_are_those_of_the_plain_loops(grid):
    rng = np.random.default_rng(1)
    map_, plain = OccupancyMap(grid, MODEL), PlainSurfaces(grid)
    for scan in random_scans(grid, 30, rng):
        map_.integrate(scan)
        plain.add(scan, hit_cells_of(scan, grid))
    cells, means, covariances = map_.surfaces()
    assert cells.tolist() == sorted(plain.points)
    assert max(map(len, plain.points.values())) > grid.dimension
    for cell, mean, C in zip(cells.tolist(), means, covariances, strict=True):
        mean_, C_ = plain.gaussian(cell)
        assert mean == pytest.approx(mean_, abs=1e-12)
        assert pytest.approx(C_, abs=1e-12) == C


@pytest.mark.parametrize("grid", GRIDS)
def test_the_order_of_scans_does_not_matter(grid):
    scans = list(random_scans(grid, 3, np.random.default_rng(2)))
    results = []
    for order in itertools.permutations(scans):
        map_ = OccupancyMap(grid, MODEL)
        map_.integrate(order)
        results.append(map_.surfaces())
    for result in results[1:]:
        for mine, theirs in zip(result, results[0], strict=True):
            assert mine == pytest.approx(theirs, abs=1e-12)


@pytest.mark.parametrize("grid", GRIDS)
def test_the_sums_of_a_scan_can_be_taken_away_again(grid):
    first, second = random_scans(grid, 2, np.random.default_rng(3))
    both, one, other = (OccupancyMap(grid, MODEL) for _ in range(3))
    both.integrate([first, second])
    one.integrate(first)
    other.integrate(second)
    of_cells = []
    for map_ in (both, other, one):
        rows = map_.surface_rows(both.hit_cells)  # empty ones for cells of the other scan
        of_cells.append([sums[rows] for sums in map_.surface_sums])
    for mine, theirs, wanted in zip(*of_cells, strict=True):
        assert mine - theirs == pytest.approx(wanted, abs=1e-12)


def test_the_mean_of_exact_points_of_a_plane_lies_in_it_wherever_they_are():
    """Eq. 4 puts it off the plane: two lines of sight that are only known across do not meet there.

    The plane is that of x = 4.3 + y / 5; each point is exact across its own line of sight.
    """
    rng = np.random.default_rng(4)
    normal = np.array([5.0, -1.0, 0.0]) / math.sqrt(26)
    distances = {}
    for fusion in ("mean", "eq_4"):
        map_ = OccupancyMap(ROOM, BeamModel(surface_fusion=fusion))
        for origin in ([0.5, 0.5, 3.5], [0.5, 7.5, 3.5], [1.5, 3.5, 0.5]):
            y, z = rng.uniform(3.05, 3.3, 6), rng.uniform(3.1, 3.9, 6)
            points = np.column_stack([3.5 + y / 5, y, z])
            u = points - np.array(origin)
            u /= np.linalg.norm(u, axis=1, keepdims=True)
            C = 1e-2 * u[:, :, None] * u[:, None, :] + 1e-6 * np.eye(3)
            map_.integrate(scan_of(points, C, origin))
        cells, means, C = map_.surfaces()
        k = cells.tolist().index(ROOM.flat_index([4, 3, 3]))
        distances[fusion] = abs(float((means[k] - [3.5, 0, 0]) @ normal))
        if fusion == "mean":
            # no roughness: their scatter along the normal is 0
            assert normal @ C[k] @ normal < 1e-2 / len(y) + FLOOR
    assert distances["mean"] < 1e-12
    assert distances["eq_4"] > 0.005


def test_in_a_corner_the_covariance_covers_the_distance_to_both_faces():
    """Exact points on both legs of an L of length 0.9: their mean is 0.225 from each leg."""
    grid = VoxelGrid((12, 12))
    t = 5.05 + 0.9 * (np.arange(20) + 0.5) / 20
    leg = np.column_stack([np.full(20, 5.05), t])
    map_ = OccupancyMap(grid, BeamModel(surface="anywhere", surface_fusion="mean"))
    map_.integrate(scan_of(np.concatenate([leg, leg[:, ::-1]]), 1e-8 * np.eye(2), [1.5, 1.5]))
    cells, means, C = map_.surfaces()
    assert cells.tolist() == [grid.flat_index([5, 5])]
    assert means[0] == pytest.approx([5.275, 5.275])
    # along (1, 1) / sqrt 2 a point at t has t / sqrt 2, a variance of 0.81 / 24; 40 points of 38
    assert np.linalg.eigvalsh(C[0])[0] == pytest.approx(0.81 / 24 * 40 / 38, rel=0.01)
    assert 0.225**2 / C[0, 0, 0] < 3.84


def test_few_points_tell_nothing_about_roughness():
    map_ = OccupancyMap(ROOM, MODEL)
    points = np.array([4.5, 3.5, 3.5]) + 0.3 * np.eye(3)
    map_.integrate(scan_of(points, np.zeros((3, 3)), CAMERA))
    _, _, C = map_.surfaces()
    assert C[0] == pytest.approx(FLOOR / 3 * np.eye(3))


@pytest.mark.parametrize("moves", [False, True])
def test_the_covariance_is_that_of_simulated_means(moves):
    """Range noise and a pose error drawn again and again: the mean's error has the covariance.

    It has if the mount stays. If both scans have errors of their own, the covariance is too large.
    """
    rng = np.random.default_rng(5)
    true = np.array([4.5, 3.5, 3.5]) + 0.2 * (rng.random((5, 3)) - 0.5) * [0, 1, 1]
    pose = np.diag([4e-4, 1e-4, 1e-4, 1e-6, 1e-5, 2e-5])
    center = np.array([4.5, 3.5, 3.5])
    J = np.hstack([np.eye(3), -skew(center - CAMERA)])
    noise = np.diag([4e-4, 1e-4, 1e-4])
    squares = []
    for _ in range(1000):
        map_ = OccupancyMap(ROOM, MODEL)
        error = J @ rng.multivariate_normal(np.zeros(6), pose)
        for _ in range(2):
            points = true + error + rng.multivariate_normal(np.zeros(3), noise, len(true))
            covariances = noise + J @ pose @ J.T
            map_.integrate(scan_of(points, covariances, CAMERA, pose))
            if moves:
                error = J @ rng.multivariate_normal(np.zeros(6), pose)
        cells, means, C = map_.surfaces()
        k = cells.tolist().index(ROOM.flat_index([4, 3, 3]))
        squares.append((means[k, 0] - 4.5) ** 2 / C[k, 0, 0])
    # chi square of one degree of freedom: mean 1, standard deviation sqrt 2; the rest is roughness
    assert np.mean(squares) == pytest.approx(0.6 if moves else 1, abs=0.15)
    assert np.mean(np.array(squares) > 3.84) < 0.07


@pytest.mark.parametrize("n", [2, 3, 5])
def test_the_smallest_eigenvalue_is_that_of_numpy(n):
    rng = np.random.default_rng(6)
    for _ in range(50):
        A = rng.normal(size=(n, n))
        A = A + A.T
        before = A.copy()
        assert smallest_eigenvalue(A) == pytest.approx(np.linalg.eigvalsh(A)[0], abs=1e-12)
        assert (before == A).all()


def test_a_scan_whose_pose_covariance_has_another_shape_or_is_not_finite_is_rejected():
    with pytest.raises(ValueError, match=r"pose_covariance must be \(6, 6\)"):
        scan_of([[4.5, 3.5, 3.5]], np.eye(3), CAMERA, np.zeros((3, 3)))
    scan = scan_of([[4.5, 3.5, 3.5]], np.eye(3), CAMERA, np.full((6, 6), np.nan))
    with pytest.raises(ValueError, match="pose_covariance must be finite"):
        OccupancyMap(ROOM, MODEL).integrate(scan)
