"""Gaussian observations and their fusion: Eqs. 2 and 4, and the information form of both."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.elementary import exp_array
from coopmap_env.core.kernels import borrowing_kernel
from coopmap_env.core.linear_algebra import inverse, product, solve
from coopmap_env.mapping.arrays import SurfaceArrays


def gaussian_density(x: ArrayLike, mean: ArrayLike, covariance: ArrayLike) -> NDArray[np.float64]:
    """Eq. 2: N(x; mean, C) of points (..., D); the exponent is the Mahalanobis distance."""
    delta = np.asarray(x, dtype=np.float64) - np.asarray(mean, dtype=np.float64)
    C = np.asarray(covariance, dtype=np.float64)
    mahalanobis = (product(delta, inverse(C)) * delta).sum(axis=-1)
    normaliser = math.sqrt((2 * math.pi) ** C.shape[0] * np.linalg.det(C))
    return exp_array(-0.5 * mahalanobis) / normaliser


def merge_gaussians(
    mean_1: ArrayLike, C_1: ArrayLike, mean_2: ArrayLike, C_2: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Merge two Gaussian observations of one point by multiplying their densities (Eq. 4).

    C_m = C1 - C1 (C1 + C2)^-1 C1, mean_m = mean_1 + C1 (C1 + C2)^-1 (mean_2 - mean_1).
    Symmetric and associative: any order gives the same result. The map keeps the same product in
    information form, where merging is a sum.

    Parameters
    ----------
    mean_1, mean_2 : array_like, shape (D,)
    C_1, C_2 : array_like, shape (D, D)
        Covariances, positive definite.

    Returns
    -------
    mean : ndarray, shape (D,)
    covariance : ndarray, shape (D, D)

    Raises
    ------
    numpy.linalg.LinAlgError
        If C1 + C2 is singular.
    """
    mean_1, C_1 = np.asarray(mean_1, dtype=np.float64), np.asarray(C_1, dtype=np.float64)
    gain = solve(C_1 + np.asarray(C_2), C_1).T
    return mean_1 + product(gain, np.asarray(mean_2) - mean_1), C_1 - product(gain, C_1)


@borrowing_kernel
def add_observation(
    surfaces: SurfaceArrays,
    row: int,
    C: NDArray[np.float64],
    deviation: NDArray[np.float64],
    floor: float,
) -> None:
    """Merge one observation into a row's information form: two sums (Eqs. 2 and 4).

    ``precision[row] += Lambda`` and ``information_vector[row] += Lambda @ deviation`` with
    Lambda = (C + floor I)^-1. The deviation is the point minus the cell's center, so that no digits
    cancel far from the origin.
    """
    precision, vector = surfaces.precision, surfaces.information_vector
    xx, xy, yy = C[0, 0] + floor, C[0, 1], C[1, 1] + floor
    if C.shape[0] == 2:
        scale = 1.0 / (xx * yy - xy * xy)
        precision[row, 0, 0] += yy * scale
        precision[row, 0, 1] -= xy * scale
        precision[row, 1, 0] -= xy * scale
        precision[row, 1, 1] += xx * scale
        vector[row, 0] += (yy * deviation[0] - xy * deviation[1]) * scale
        vector[row, 1] += (xx * deviation[1] - xy * deviation[0]) * scale
        return
    xz, yz, zz = C[0, 2], C[1, 2], C[2, 2] + floor
    a, b, c = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    d, e, f = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
    scale = 1.0 / (xx * a + xy * b + xz * c)
    P, v = precision[row], vector[row]
    x, y, z = deviation[0], deviation[1], deviation[2]
    # written out: faster than loops over rows
    a, b, c, d, e, f = a * scale, b * scale, c * scale, d * scale, e * scale, f * scale
    P[0, 0] += a
    P[0, 1] += b
    P[0, 2] += c
    P[1, 0] += b
    P[1, 1] += d
    P[1, 2] += e
    P[2, 0] += c
    P[2, 1] += e
    P[2, 2] += f
    v[0] += a * x + b * y + c * z
    v[1] += b * x + d * y + e * z
    v[2] += c * x + e * y + f * z
