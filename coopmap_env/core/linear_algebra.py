"""Products, solutions and eigenvectors of small matrices, with the same bits on every processor.

``@`` and `numpy.linalg` call BLAS and LAPACK, which choose their kernels by the processor: with or
without fused multiply-add, in blocks of one size or another. Their results differ in the last bits,
and so would trajectories. Here each sum is taken in the order of its indices.

All functions take stacks (..., m, n), as those of numpy do, and are made for matrices of at most
some tens of rows; a number of rows that only counts points, (k, 3) times (3, 3), may be large.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.kernels import kernel

Array = NDArray[np.float64]
MAX_SWEEPS = 50
"""Of Jacobi's method, which takes 4 to 8."""


def product(A: ArrayLike, B: ArrayLike) -> Array:
    """``A @ B``, of matrices, vectors and stacks of matrices, by the same rules.

    Stacks have the same shape, or one of both factors is a single matrix or vector.

    Raises
    ------
    ValueError
        If the shapes do not fit together.
    """
    a, b = np.ascontiguousarray(A, np.float64), np.ascontiguousarray(B, np.float64)
    right = b if b.ndim > 1 else b[:, None]
    if a.ndim == right.ndim == 2 and a.shape[1] == len(right):
        single = np.empty((len(a), right.shape[1]))
        multiply(a, right, single)
        return single if b.ndim > 1 else single.ravel()
    left = a if a.ndim > 1 else a[None, :]
    stack = left.shape[:-2] or right.shape[:-2]
    (m, n), (inner, p) = left.shape[-2:], right.shape[-2:]
    if n != inner or right.shape[:-2] not in ((), stack):
        raise ValueError(f"shapes {a.shape} and {b.shape} do not fit together")
    if right.ndim == 2 and left.ndim > 2:  # one matrix more: the rows of all
        stack, m, left = (), math.prod(left.shape[:-1]), left.reshape(-1, n)
    out = np.empty((math.prod(stack), m, p))
    _product(
        left.reshape((math.prod(left.shape[:-2]), m, n)),
        right.reshape((math.prod(right.shape[:-2]), inner, p)),
        out,
    )
    kept = a.shape[:-2] or b.shape[:-2]
    rows = a.shape[-2:-1] if a.ndim > 1 else ()
    columns = (p,) if b.ndim > 1 else ()
    return out.reshape((*kept, *rows, *columns))


@kernel
def multiply(a: Array, b: Array, out: Array) -> None:
    """Write the product of a (m, n) and b (n, p) to out (m, p); for kernels."""
    m, n = a.shape
    p = b.shape[1]
    if n == 3:
        for i in range(m):
            x, y, z = a[i, 0], a[i, 1], a[i, 2]
            for j in range(p):
                out[i, j] = x * b[0, j] + y * b[1, j] + z * b[2, j]
        return
    out[:] = 0.0
    for i in range(m):
        for s in range(n):
            x = a[i, s]
            for j in range(p):
                out[i, j] += x * b[s, j]


@kernel
def _product(A: Array, B: Array, out: Array) -> None:
    """Products of A (k or 1, m, n) and B (k or 1, n, p), written to out (k, m, p)."""
    for k in range(len(out)):
        multiply(A[k if len(A) > 1 else 0], B[k if len(B) > 1 else 0], out[k])


@kernel
def are_finite(values: Array) -> bool:
    """Whether all values (n,) are finite; numpy takes ten times as long for so few numbers."""
    finite = True
    for k in range(len(values)):
        finite &= math.isfinite(values[k])
    return finite


def total(values: Iterable[float]) -> float:
    """The sum, rounded after each value; from Python 3.12 on, `sum` makes up for the rounding."""
    result = 0.0
    for value in values:
        result += value
    return result


def length(v: ArrayLike) -> float:
    """Euclidean length of a vector (n,)."""
    return math.sqrt(total([x * x for x in np.asarray(v, dtype=np.float64).tolist()]))


def solve(A: ArrayLike, B: ArrayLike) -> Array:
    """X with ``A @ X = B``: A (..., n, n), B (..., n, p) or, of a single A, (n,).

    By Gaussian elimination with partial pivoting.

    Raises
    ------
    numpy.linalg.LinAlgError
        If a matrix is singular.
    """
    a, b = np.asarray(A, dtype=np.float64), np.asarray(B, dtype=np.float64)
    n = a.shape[-1]
    right = b if b.ndim > 1 else b[:, None]
    p = right.shape[-1]
    stack = a.shape[:-2] or right.shape[:-2]
    k = math.prod(stack)
    x = np.empty((k, n, p))
    x[:] = right.reshape((-1, n, p)) if right.ndim > 2 else right
    factors = np.empty((k, n, n))
    factors[:] = a.reshape((-1, n, n)) if a.ndim > 2 else a
    if not _solve(factors, x):
        raise np.linalg.LinAlgError("singular matrix")
    return x.reshape((*stack, n, p)) if b.ndim > 1 else x.reshape(n)


@kernel
def _solve(A: Array, X: Array) -> bool:
    """Replace X (k, n, p) by A^-1 X, and A by what elimination leaves; whether it could be done."""
    _, n, p = X.shape
    for k in range(len(A)):
        a, x = A[k], X[k]
        for i in range(n):
            pivot = i
            for r in range(i + 1, n):
                if abs(a[r, i]) > abs(a[pivot, i]):
                    pivot = r
            if a[pivot, i] == 0.0:
                return False
            if pivot != i:
                for j in range(n):
                    a[i, j], a[pivot, j] = a[pivot, j], a[i, j]
                for j in range(p):
                    x[i, j], x[pivot, j] = x[pivot, j], x[i, j]
            for r in range(i + 1, n):
                factor = a[r, i] / a[i, i]
                for j in range(i + 1, n):
                    a[r, j] -= factor * a[i, j]
                for j in range(p):
                    x[r, j] -= factor * x[i, j]
        for i in range(n - 1, -1, -1):
            for s in range(i + 1, n):
                for j in range(p):
                    x[i, j] -= a[i, s] * x[s, j]
            for j in range(p):
                x[i, j] /= a[i, i]
    return True


def inverse(A: ArrayLike) -> Array:
    """A^-1 of (..., n, n).

    Raises
    ------
    numpy.linalg.LinAlgError
        If a matrix is singular.
    """
    return solve(A, np.eye(np.shape(A)[-1]))


def cholesky(A: ArrayLike) -> Array:
    """Lower triangular L (n, n) with ``L @ L.T = A`` of a symmetric matrix.

    Raises
    ------
    numpy.linalg.LinAlgError
        If it is not positive definite.
    """
    a = np.asarray(A, dtype=np.float64)
    L = np.zeros_like(a)
    for i in range(len(a)):
        for j in range(i + 1):
            rest = float(a[i, j]) - total((L[i, :j] * L[j, :j]).tolist())
            if i > j:
                L[i, j] = rest / L[j, j]
            elif rest > 0.0:
                L[i, i] = math.sqrt(rest)
            else:
                raise np.linalg.LinAlgError("matrix is not positive definite")
    return L


def eigh(A: ArrayLike) -> tuple[Array, Array]:
    """Eigenvalues (..., n), ascending, and eigenvectors (..., n, n), in columns, of symmetric A.

    By Jacobi's method. The largest component of each eigenvector is positive. As in numpy, only the
    lower triangle of A is read.
    """
    lower = np.tril(np.asarray(A, dtype=np.float64))
    a = lower + np.swapaxes(np.tril(lower, -1), -1, -2)
    n = a.shape[-1]
    V = np.empty_like(a)
    k = math.prod(a.shape[:-2])
    _diagonalise(a.reshape((k, n, n)), V.reshape((k, n, n)))
    values = np.diagonal(a, axis1=-2, axis2=-1)
    order = np.argsort(values, axis=-1, kind="stable")
    values = np.take_along_axis(values, order, axis=-1)
    V = np.take_along_axis(V, order[..., None, :], axis=-1)
    largest = np.take_along_axis(V, np.abs(V).argmax(axis=-2)[..., None, :], axis=-2)
    return values, V * np.copysign(1.0, largest)


@kernel
def smallest_eigenvalue(A: Array) -> float:
    """That of a symmetric matrix A (n, n); for kernels. By Jacobi's method."""
    n = len(A)
    diagonal = np.empty((1, n, n))
    diagonal[0] = A
    _diagonalise(diagonal, np.empty((1, n, n)))
    smallest = diagonal[0, 0, 0]
    for k in range(1, n):
        smallest = min(smallest, diagonal[0, k, k])
    return smallest


@kernel
def _diagonalise(A: Array, V: Array) -> None:
    """Rotate symmetric matrices A (k, n, n) to diagonal ones; V (k, n, n) receives the rotations.

    Each rotation makes one entry zero; sweeps over all entries go on until none is left.
    """
    n = A.shape[1]
    for k in range(len(A)):
        a, v = A[k], V[k]
        v[:] = np.eye(n)
        for _ in range(MAX_SWEEPS):
            rotated = False
            for p in range(n - 1):
                for q in range(p + 1, n):
                    if abs(a[p, q]) <= 1e-17 * math.sqrt(abs(a[p, p] * a[q, q])) or not (
                        abs(a[p, q]) > 1e-300
                    ):
                        a[p, q] = a[q, p] = 0.0
                        continue
                    rotated = True
                    tau = (a[q, q] - a[p, p]) / (2.0 * a[p, q])
                    t = math.copysign(1.0, tau) / (abs(tau) + math.sqrt(1.0 + tau * tau))
                    c = 1.0 / math.sqrt(1.0 + t * t)
                    s = t * c
                    for i in range(n):
                        x, y = a[i, p], a[i, q]
                        a[i, p], a[i, q] = c * x - s * y, s * x + c * y
                    for i in range(n):
                        x, y = a[p, i], a[q, i]
                        a[p, i], a[q, i] = c * x - s * y, s * x + c * y
                        x, y = v[i, p], v[i, q]
                        v[i, p], v[i, q] = c * x - s * y, s * x + c * y
                    a[p, q] = a[q, p] = 0.0
            if not rotated:
                break
