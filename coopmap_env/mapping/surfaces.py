"""Surface Gaussians of many cells from their sums, and the check of sums that come from outside."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.linear_algebra import inverse, product
from coopmap_env.mapping.arrays import SurfaceArrays
from coopmap_env.mapping.surface_mean import mean_gaussians


def surface_gaussians(
    sums: SurfaceArrays, rows: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Merged points of rows (k,), from the cells' centers (k, D), and covariances (k, D, D)."""
    if not sums.averaged:
        covariances = inverse(sums.precision[rows])
        return product(covariances, sums.information_vector[rows][..., None])[..., 0], covariances
    D = sums.information_vector.shape[1]
    deviations, covariances = np.empty((len(rows), D)), np.empty((len(rows), D, D))
    mean_gaussians(tuple(sums), rows, deviations, covariances)
    return deviations, covariances


def check_surfaces(
    cells: ArrayLike, sums: SurfaceArrays, like: SurfaceArrays, sampled: NDArray[Any]
) -> tuple[NDArray[Any], SurfaceArrays]:
    """Cells and their sums as arrays, if they fit a map with the sums `like`.

    Raises
    ------
    ValueError
        If a shape or a value does not fit.
    """
    cells, sums = np.asarray(cells), SurfaceArrays(*map(np.asarray, sums))
    k = len(cells) if cells.ndim else 0
    expected = [(k, *a.shape[1:]) if len(a) else a.shape for a in like]
    shapes = [a.shape for a in (cells, *sums)]
    if shapes != [(k,), *expected]:
        raise ValueError(f"surface sums of this map cannot have the shapes {shapes}")
    if cells.dtype.kind not in "iu":
        raise ValueError("hit cells must be integers")
    if not ((cells >= 0) & (cells < len(sampled))).all():
        raise ValueError(f"hit cells must lie in [0, {len(sampled)})")
    if len(np.unique(cells)) != len(cells) or not sampled[cells].all():
        raise ValueError("hit cells must be distinct and sampled")
    if any(array.dtype.kind not in "iuf" for array in sums):
        raise ValueError("surface sums must be numbers")
    sums = SurfaceArrays(*(np.ascontiguousarray(a, dtype=np.float64) for a in sums))
    if not all(np.isfinite(array).all() for array in sums):
        raise ValueError("surface information must be finite and invertible")
    _check_covariances(sums, k)
    return cells, sums


def _check_covariances(sums: SurfaceArrays, k: int) -> None:
    """Raise ValueError if a cell has no points, or a covariance no positive variances."""
    enough = not sums.averaged or bool((sums.precision >= 1.0).all())
    if enough:
        with np.errstate(all="ignore"):
            _, covariances = surface_gaussians(sums, np.arange(k))
        variances = np.diagonal(covariances, axis1=1, axis2=2)
        enough = bool(np.isfinite(covariances).all() and (variances > 0).all())
    if not enough:
        raise ValueError("surface information must be finite and invertible")
