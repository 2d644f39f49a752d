"""Uncertainty of range observations: Eqs. 1 and 3."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from coopmap_env.sensing import RangeNoise, rotate_covariances


def test_stereo_noise_at_ten_metres_by_hand_eq_1():
    noise = RangeNoise(intrinsic=0.002, depth=1.0, lateral=0.25, exponent=2.0)
    # 0.002 * 10 ** 2 = 0.2 m in depth, a quarter of it across
    assert noise.standard_deviations(10.0, 3) == pytest.approx([0.2, 0.05, 0.05])
    assert noise.standard_deviations(10.0, 2) == pytest.approx([0.2, 0.05])


def test_default_noise_is_0_15_m_at_10_m_and_a_cell_at_the_depth_of_field_eq_1():
    sigma = RangeNoise().standard_deviations([10.0, 25.0], 2)
    assert sigma[:, 0] == pytest.approx([0.15, 0.9375])


@pytest.mark.parametrize(("exponent", "growth"), [(0.0, 1.0), (1.0, 2.0), (2.0, 4.0), (3.0, 8.0)])
def test_twice_the_distance_is_two_to_the_n_times_the_noise_eq_1(exponent, growth):
    noise = RangeNoise(exponent=exponent)
    near, far = noise.standard_deviations([3.0, 6.0], 3)
    assert far == pytest.approx(growth * near)


def test_a_laser_is_as_uncertain_at_no_distance_as_at_any_eq_1():
    noise = RangeNoise(intrinsic=0.03, exponent=0.0)
    assert noise.standard_deviations([0.0, 1.0, 20.0], 2)[:, 0] == pytest.approx([0.03] * 3)


def test_depth_is_the_worst_axis_eq_1():
    sigma = RangeNoise(lateral=0.9).standard_deviations(np.linspace(0.1, 30, 50), 3)
    assert (sigma[:, :1] > sigma[:, 1:]).all()


def test_standard_deviations_keep_the_shape_of_the_distances():
    assert RangeNoise().standard_deviations(np.ones((4, 5)), 3).shape == (4, 5, 3)


@pytest.mark.parametrize("name", ["intrinsic", "depth", "lateral", "exponent"])
@pytest.mark.parametrize("value", [-0.1, math.nan, math.inf])
def test_noise_that_is_negative_or_not_finite_is_rejected(name, value):
    with pytest.raises(ValueError, match=rf"RangeNoise\.{name} .* {value}"):
        RangeNoise(**{name: value})


def test_noise_that_is_larger_across_than_in_depth_is_rejected():
    with pytest.raises(
        ValueError, match=r"RangeNoise\.lateral must not exceed depth, got 1\.5 > 1\.0"
    ):
        RangeNoise(lateral=1.5)


def test_a_quarter_turn_swaps_the_axes_eq_3():
    R = np.array([[0.0, -1.0], [1.0, 0.0]])
    rotated = rotate_covariances(np.diag([0.04, 0.01]), R)
    assert rotated == pytest.approx(np.diag([0.01, 0.04]))


def test_an_eighth_of_a_turn_mixes_the_axes_eq_3():
    c = math.sqrt(0.5)
    rotated = rotate_covariances(np.diag([4.0, 1.0]), np.array([[c, -c], [c, c]]))
    assert rotated == pytest.approx(np.array([[2.5, 1.5], [1.5, 2.5]]))


def test_rotation_keeps_eigenvalues_and_rotates_the_axes_eq_3():
    rng = np.random.default_rng(0)
    C = np.diag([9.0, 4.0, 1.0])
    for R in Rotation.random(20, random_state=rng).as_matrix():
        rotated = rotate_covariances(C, R)
        assert np.linalg.eigvalsh(rotated) == pytest.approx([1, 4, 9])
        assert rotated @ R == pytest.approx(R @ C)


def test_a_stack_of_covariances_rotates_as_each_one_does_eq_3():
    rng = np.random.default_rng(1)
    A = rng.normal(size=(5, 3, 3))
    covariances, R = A @ A.transpose(0, 2, 1), Rotation.random(random_state=rng).as_matrix()
    together = rotate_covariances(covariances, R)
    for C, rotated in zip(covariances, together, strict=True):
        assert rotated == pytest.approx(R @ C @ R.T)
