"""Gaussian observations and their fusion: Eqs. 2 and 4."""

import functools
import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import multivariate_normal

from coopmap_env.mapping import gaussian_density, merge_gaussians
from coopmap_env.mapping.arrays import SurfaceArrays
from coopmap_env.mapping.gaussian import add_observation


def random_gaussians(rng, n, dimension):
    """Means of order 10 and covariances with eigenvalues between 0.1 and some 10."""
    A = rng.normal(size=(n, dimension, dimension))
    return rng.uniform(-9, 9, (n, dimension)), A @ A.transpose(0, 2, 1) + 0.1 * np.eye(dimension)


def merge_all(means, covariances):
    return functools.reduce(
        lambda one, two: merge_gaussians(*one, *two), zip(means, covariances, strict=True)
    )


def test_the_density_at_the_mean_of_a_unit_gaussian_is_one_over_two_pi_eq_2():
    assert gaussian_density([1, 2], [1, 2], np.eye(2)) == pytest.approx(1 / (2 * math.pi))


def test_two_mahalanobis_units_away_the_density_falls_by_e_to_the_two_eq_2():
    # 4 m at a standard deviation of 2 m
    C = np.diag([4.0, 1.0])
    ratio = gaussian_density([4, 0], [0, 0], C) / gaussian_density([0, 0], [0, 0], C)
    assert ratio == pytest.approx(math.exp(-2))


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_density_is_that_of_scipy_eq_2(dimension):
    rng = np.random.default_rng(0)
    (mean,), (C,) = random_gaussians(rng, 1, dimension)
    x = rng.normal(size=(4, 6, dimension)) + mean
    assert gaussian_density(x, mean, C) == pytest.approx(multivariate_normal(mean, C).pdf(x))


def test_merging_by_hand_eq_4():
    # x: (1/4 + 1/4)^-1 = 2, halfway; y: (1/1 + 1/3)^-1 = 3/4, a quarter of the way from 0 to 4
    mean, C = merge_gaussians([0, 0], np.diag([4.0, 1.0]), [2, 4], np.diag([4.0, 3.0]))
    assert mean == pytest.approx([1, 1])
    assert np.diag([2, 0.75]) == pytest.approx(C)


@pytest.mark.parametrize("n", [2, 3, 10])
def test_merging_n_equal_gaussians_divides_covariance_by_n_eq_4(n):
    (mean,), (C,) = random_gaussians(np.random.default_rng(n), 1, 3)
    merged, C_merged = merge_all([mean] * n, [C] * n)
    assert merged == pytest.approx(mean)
    assert pytest.approx(C / n) == C_merged


@pytest.mark.parametrize("dimension", [2, 3])
def test_merged_covariance_is_the_inverse_of_summed_inverses_eq_4(dimension):
    rng = np.random.default_rng(1)
    for _ in range(50):
        (m1, m2), (C1, C2) = random_gaussians(rng, 2, dimension)
        mean, C = merge_gaussians(m1, C1, m2, C2)
        P1, P2 = np.linalg.inv(C1), np.linalg.inv(C2)
        # eigenvalues 0.1 to 30: inverses lose three of sixteen digits
        assert pytest.approx(np.linalg.inv(P1 + P2), abs=1e-10) == C
        assert mean == pytest.approx(np.linalg.solve(P1 + P2, P1 @ m1 + P2 @ m2), abs=1e-9)


def test_merging_multiplies_densities_eqs_2_and_4():
    rng = np.random.default_rng(2)
    (m1, m2), (C1, C2) = random_gaussians(rng, 2, 3)
    mean, C = merge_gaussians(m1, C1, m2, C2)
    x = mean + rng.normal(size=(20, 3))
    product = gaussian_density(x, m1, C1) * gaussian_density(x, m2, C2)
    ratio = product / gaussian_density(x, mean, C)
    assert ratio == pytest.approx(np.full(20, ratio[0]))


@pytest.mark.parametrize("dimension", [2, 3])
def test_merging_is_symmetric_and_associative_eq_4(dimension):
    rng = np.random.default_rng(3)
    for _ in range(50):
        means, covariances = random_gaussians(rng, 4, dimension)
        mean, C = merge_all(means, covariances)
        for order in ([3, 2, 1, 0], [1, 3, 0, 2]):
            other, C_other = merge_all(means[order], covariances[order])
            assert other == pytest.approx(mean, abs=1e-9)
            assert pytest.approx(C, abs=1e-10) == C_other
        left = merge_gaussians(
            *merge_gaussians(means[0], covariances[0], means[1], covariances[1]),
            *merge_gaussians(means[2], covariances[2], means[3], covariances[3]),
        )
        assert left[0] == pytest.approx(mean, abs=1e-9)


def test_merging_never_increases_the_variance_in_any_direction_eq_4():
    rng = np.random.default_rng(4)
    for _ in range(50):
        (m1, m2), (C1, C2) = random_gaussians(rng, 2, 3)
        _, C = merge_gaussians(m1, C1, m2, C2)
        assert np.linalg.eigvalsh(C1 - C).min() > -1e-12
        assert np.linalg.eigvalsh(C2 - C).min() > -1e-12


def test_principal_axes_of_two_crossed_ellipses_bisect_them_eq_4():
    """Two ellipses 60 degrees apart: the merged one is longest on the line in between."""

    def ellipse(angle):
        c, s = math.cos(angle), math.sin(angle)
        R = np.array([[c, -s], [s, c]])
        return R @ np.diag([9.0, 1.0]) @ R.T

    _, C = merge_gaussians([0, 0], ellipse(0.0), [0, 0], ellipse(math.radians(60)))
    values, vectors = np.linalg.eigh(C)
    axis = np.degrees(math.atan2(vectors[1, 1], vectors[0, 1])) % 180
    assert axis == pytest.approx(30)
    # precisions along and across it: 2 (cos^2 30 / 9 + sin^2 30) = 2 / 3 and 14 / 9
    assert values == pytest.approx([9 / 14, 3 / 2])


@pytest.mark.parametrize("dimension", [2, 3])
def test_merging_is_the_same_in_every_frame_eqs_3_and_4(dimension):
    rng = np.random.default_rng(5)
    for _ in range(20):
        (m1, m2), (C1, C2) = random_gaussians(rng, 2, dimension)
        R = Rotation.random(random_state=rng).as_matrix()
        if dimension == 2:
            c, s = math.cos(rng.uniform(0, 6)), 0.0
            s = math.sqrt(1 - c * c)
            R = np.array([[c, -s], [s, c]])
        t = rng.uniform(-5, 5, dimension)
        mean, C = merge_gaussians(m1, C1, m2, C2)
        moved, C_moved = merge_gaussians(R @ m1 + t, R @ C1 @ R.T, R @ m2 + t, R @ C2 @ R.T)
        assert moved == pytest.approx(R @ mean + t, abs=1e-9)
        assert pytest.approx(R @ C @ R.T, abs=1e-10) == C_moved


def test_two_certain_observations_cannot_be_merged():
    with pytest.raises(np.linalg.LinAlgError):
        merge_gaussians([0, 0], np.zeros((2, 2)), [1, 1], np.zeros((2, 2)))


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_information_form_adds_the_inverse_and_its_product_with_the_deviation(dimension):
    rng = np.random.default_rng(6)
    for _ in range(50):
        (deviation,), (C,) = random_gaussians(rng, 1, dimension)
        precision = rng.normal(size=(3, dimension, dimension))
        vector = rng.normal(size=(3, dimension))
        before = precision.copy(), vector.copy()
        add_observation(SurfaceArrays.of_eq_4(precision, vector), 1, C, deviation, 0.25)
        P = np.linalg.inv(C + 0.25 * np.eye(dimension))
        # the closed form and LAPACK agree to the rounding of numbers of order 10
        assert precision[1] - before[0][1] == pytest.approx(P, abs=1e-12)
        assert vector[1] - before[1][1] == pytest.approx(P @ deviation, abs=1e-11)
        assert (precision[[0, 2]] == before[0][[0, 2]]).all()
        assert (vector[[0, 2]] == before[1][[0, 2]]).all()


@pytest.mark.parametrize("dimension", [2, 3])
def test_an_observation_without_uncertainty_weighs_as_much_as_the_floor_allows(dimension):
    precision, vector = np.zeros((1, dimension, dimension)), np.zeros((1, dimension))
    surfaces = SurfaceArrays.of_eq_4(precision, vector)
    add_observation(surfaces, 0, np.zeros((dimension,) * 2), np.ones(dimension), 0.01)
    assert precision[0] == pytest.approx(100 * np.eye(dimension))
    assert vector[0] == pytest.approx(np.full(dimension, 100.0))
