"""Small matrices: as numpy has them, without BLAS."""

import math

import numpy as np
import pytest

from coopmap_env.core.linear_algebra import cholesky, eigh, inverse, length, product, solve

RNG = np.random.default_rng(0)


@pytest.mark.parametrize(
    ("a", "b"),
    [
        ((3, 3), (3, 3)), ((3, 3), (3,)), ((3,), (3, 3)), ((3,), (3,)), ((10, 3), (3, 3)),
        ((5, 3, 3), (5, 3, 3)), ((5, 3, 3), (3, 3)), ((3, 3), (5, 3, 3)), ((5, 4, 3), (3,)),
        ((2, 5, 6, 4), (4, 7)), ((2, 5, 6, 4), (2, 5, 4, 7)), ((6, 6), (5, 6, 6)),
        ((5, 1, 3), (5, 3, 3)), ((0, 3), (3, 3)), ((0, 4, 3, 3), (3, 3)), ((6,), (5, 6, 6)),
    ],
)  # fmt: skip
def test_products_have_the_shapes_and_values_of_numpys(a, b):
    A, B = RNG.normal(size=a), RNG.normal(size=b)
    found = product(A, B)
    assert found.shape == np.shape(A @ B)
    np.testing.assert_allclose(found, A @ B, rtol=1e-13, atol=1e-13)


def test_a_product_adds_in_the_order_of_the_indices():
    # (1 + 1e16) - 1e16 is 0 in this order, and 1 in others
    assert product([[1.0, 1.0, 1.0]], [[1.0], [1e16], [-1e16]]) == 0.0
    assert product([1.0, 1.0, 1.0, 1.0], [1.0, 1e16, -1e16, 1.0]) == 1.0


def test_a_product_does_not_fuse_multiplication_and_addition():
    x = 1.0 + 2.0**-30
    # x * x = 1 + 2^-29 + 2^-60 is rounded to 1 + 2^-29 before the rest is subtracted
    for n in (2, 3, 4):
        a = np.array([-(1.0 + 2.0**-29), x, *(0.0,) * (n - 2)])
        b = np.array([1.0, x, *(0.0,) * (n - 2)])
        assert product(a, b) == 0.0


@pytest.mark.parametrize(
    ("a", "b"), [((3,), (4,)), ((3, 3), (4, 3)), ((2, 3, 3), (5, 3, 3)), ((5, 3), (3, 4, 4))]
)
def test_shapes_that_do_not_fit_are_named(a, b):
    with pytest.raises(ValueError, match="do not fit together"):
        product(np.zeros(a), np.zeros(b))


@pytest.mark.parametrize("n", [1, 2, 3, 6, 12])
def test_solutions_inverses_and_eigenvectors_satisfy_their_equations(n):
    A, B = RNG.normal(size=(4, n, n)), RNG.normal(size=(4, n, 5))
    np.testing.assert_allclose(A @ solve(A, B), B, atol=1e-9)
    np.testing.assert_allclose(A[0] @ solve(A[0], B[0, :, 0]), B[0, :, 0], atol=1e-9)
    np.testing.assert_allclose(A @ inverse(A), np.broadcast_to(np.eye(n), A.shape), atol=1e-9)
    S = A @ A.transpose(0, 2, 1)
    values, vectors = eigh(S)
    assert (np.diff(values, axis=-1) >= 0).all()
    np.testing.assert_allclose(S @ vectors, vectors * values[:, None, :], atol=1e-9)
    np.testing.assert_allclose(
        vectors.transpose(0, 2, 1) @ vectors, np.broadcast_to(np.eye(n), A.shape), atol=1e-12
    )
    np.testing.assert_allclose(cholesky(S[0]), np.linalg.cholesky(S[0]), rtol=1e-7)


def test_eigenvalues_of_a_hand_made_matrix():
    values, vectors = eigh([[2.0, 1.0], [1.0, 2.0]])
    np.testing.assert_allclose(values, [1.0, 3.0], rtol=1e-15)
    np.testing.assert_allclose(vectors[:, 1], [math.sqrt(0.5)] * 2, rtol=1e-15)


def test_eigenvalues_are_those_of_the_lower_triangle():
    values, vectors = eigh([[2.0, 99.0], [1.0, 2.0]])
    np.testing.assert_allclose(values, [1.0, 3.0], rtol=1e-15)
    np.testing.assert_allclose(np.abs(vectors), math.sqrt(0.5), rtol=1e-15)


def test_singular_and_indefinite_matrices_are_refused():
    with pytest.raises(np.linalg.LinAlgError, match="singular"):
        inverse([[1.0, 2.0], [2.0, 4.0]])
    with pytest.raises(np.linalg.LinAlgError, match="positive definite"):
        cholesky([[1.0, 2.0], [2.0, 1.0]])


def test_the_length_of_a_vector():
    assert length([3.0, 4.0]) == 5.0
    assert length([]) == 0.0
