import numpy as np
import pytest

from coopmap_env.geometry import Pose, apply_displacement, displacement_between, rotation_about_z
from coopmap_env.localization.registration._shared_pose import (
    camera_to_base_covariances,
    shared_pose,
    view_chi2,
)

NOTHING = np.zeros((6, 6)), np.zeros(6)


def some_information(rng, n):
    J = rng.standard_normal((n, 20, 6))
    return np.einsum("nki,nkj->nij", J, J)


def test_two_views_that_see_the_base_2_cm_apart_meet_in_the_middle():
    """Each with sigma 1 m of its own and 1 m of points: 2 m^2 a view, 1 m^2 together."""
    H = np.stack([np.eye(6)] * 2)
    g = H @ np.array([0.02, 0, 0, 0, 0, 0])
    g[1] = 0.0
    estimate = shared_pose(H, g, H.copy(), np.zeros((6, 6)), *NOTHING)
    assert estimate.x[0] == pytest.approx(0.01)
    np.testing.assert_allclose(estimate.covariance, np.eye(6))
    np.testing.assert_allclose(estimate.errors[:, 0], [0.005, -0.005])


def test_a_common_error_does_not_average_out():
    n = 1000
    H = np.stack([np.eye(6)] * n)
    common = 0.25 * np.eye(6)
    estimate = shared_pose(H, np.zeros((n, 6)), np.zeros((n, 6, 6)), common, *NOTHING)
    np.testing.assert_allclose(np.diag(estimate.covariance), 0.25 + 1 / n)


def test_the_estimate_is_that_of_all_unknowns_solved_at_once():
    rng = np.random.default_rng(1)
    n = 3
    H, independent = some_information(rng, n), 0.01 * some_information(rng, n)
    common, P = 0.02 * some_information(rng, 1)[0], np.eye(6)
    g, Px = rng.standard_normal((n, 6)), rng.standard_normal(6)
    size = 6 * (n + 2)  # x, e, e_1 to e_n
    A, b = np.zeros((size, size)), np.zeros(size)
    A[:6, :6], b[:6] = P, Px
    A[6:12, 6:12] = np.linalg.inv(common)
    for v in range(n):
        own_rows = slice(12 + 6 * v, 18 + 6 * v)
        M = np.zeros((6, size))
        M[:, :6] = M[:, 6:12] = M[:, own_rows] = np.eye(6)
        A += M.T @ H[v] @ M
        b += M.T @ g[v]
        A[own_rows, own_rows] += np.linalg.inv(independent[v])
    plain = np.linalg.solve(A, b)
    estimate = shared_pose(H, g, independent, common, P, Px)
    np.testing.assert_allclose(estimate.x, plain[:6], rtol=1e-6)
    np.testing.assert_allclose(estimate.covariance, np.linalg.inv(A)[:6, :6], rtol=1e-6)
    np.testing.assert_allclose(
        estimate.errors, plain[6:12] + plain[12:].reshape(n, 6), rtol=1e-6, atol=1e-9
    )


def test_a_view_that_sees_one_direction_only_adds_to_that_direction_only():
    H = np.zeros((1, 6, 6))
    H[0, 0, 0] = 4.0
    estimate = shared_pose(H, np.zeros((1, 6)), np.zeros((1, 6, 6)), np.zeros((6, 6)), np.eye(6),
                           np.zeros(6))  # fmt: skip
    np.testing.assert_allclose(np.diag(estimate.covariance), [0.2, 1, 1, 1, 1, 1])


def test_a_camera_that_errs_sees_what_it_would_see_from_a_base_displaced():
    """To first order: covariances of displacements drawn equal those carried over."""
    rng = np.random.default_rng(3)
    T_target_base = Pose(np.array([3.0, 1.0, 0.0]), rotation_about_z(2.0))
    T_base_camera = Pose(np.array([0.4, 0.1, 1.5]), rotation_about_z(0.5))
    root = 1e-3 * rng.standard_normal((6, 6))
    moves = []
    for d in rng.standard_normal((4000, 6)) @ root.T:
        seen_from = T_target_base @ apply_displacement(T_base_camera, d) @ T_base_camera.inverse()
        moves.append(displacement_between(T_target_base, seen_from))
    carried = camera_to_base_covariances(
        (root @ root.T)[None], T_base_camera.translation[None], T_target_base.rotation
    )[0]
    scale = np.sqrt(np.diag(carried))
    np.testing.assert_allclose(
        np.cov(np.array(moves).T) / np.outer(scale, scale),
        carried / np.outer(scale, scale),
        atol=0.08,
    )


def test_views_that_agree_have_a_chi_square_of_0_and_one_that_is_off_a_large_one():
    H = np.stack([1e4 * np.eye(6)] * 3)  # sigma 0.01
    independent = np.stack([1e-4 * np.eye(6)] * 3)
    chi2, dof = view_chi2(H, np.zeros((3, 6)), independent)
    np.testing.assert_allclose(chi2, 0.0, atol=1e-12)
    np.testing.assert_array_equal(dof, 6)
    g = np.zeros((3, 6))
    g[2, 0] = 1e4 * 0.1
    chi2, _ = view_chi2(H, g, independent)
    # its own variance 2e-4, and half of it that of the two others
    assert chi2[2] == pytest.approx(0.1**2 / 3e-4, rel=1e-3)


def test_views_that_determine_different_directions_cannot_disagree():
    H = np.zeros((2, 6, 6))
    H[0, 0, 0] = H[1, 1, 1] = 1e4
    g = np.zeros((2, 6))
    g[0, 0] = 1e4
    chi2, dof = view_chi2(H, g, np.zeros((2, 6, 6)))
    np.testing.assert_array_equal(chi2, 0.0)
    np.testing.assert_array_equal(dof, 0.0)
