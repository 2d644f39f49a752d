"""Whether a map's surface covariances are as large as its errors: too small is over-confident.

A merged surface point m with covariance C should lie about as far from the true surface as C says.
With v the way from m to the nearest point of the surface,

    chi2 = (v . v)**2 / (v^T C v)

is the squared distance in standard deviations of m along v. On a plane, v is its normal, and this
is the least squared Mahalanobis distance of m to any point of the plane. Where on the surface m
lies does not enter.

If m is normally distributed with C about a surface that is flat there, chi2 has one degree of
freedom: its median is 0.455, and 5 % of the points are beyond 3.84. This is the consistency test of
a filter (Bar-Shalom, Li and Kirubarajan 2001, 5.4) along one direction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.kernels import PlainTuple, kernel
from coopmap_env.core.linear_algebra import product
from coopmap_env.mapping import VoxelGrid

HONEST_MEDIAN, TAIL_BEGINS = 0.455, 3.84
"""Median and 95 % point of chi square with one degree of freedom."""


@dataclass(frozen=True)
class SurfaceConsistency:
    """Summary of the chi2 of a map's surface points; NaN without points."""

    n_points: int
    median: float
    """0.455 if the covariances are right."""
    tail: float
    """Fraction beyond 3.84, 0.05 if they are."""

    @classmethod
    def from_chi2(cls, chi2: NDArray[np.float64]) -> SurfaceConsistency:
        """Summarize values (k,) of `surface_chi2`."""
        if not len(chi2):
            return cls(0, float("nan"), float("nan"))
        return cls(len(chi2), float(np.median(chi2)), float((chi2 > TAIL_BEGINS).mean()))


def surface_chi2(offsets: ArrayLike, covariances: ArrayLike) -> NDArray[np.float64]:
    """Squared distances (k,) of surface points from the true surface in standard deviations.

    Parameters
    ----------
    offsets : array_like, shape (k, D)
        From the map's points to the nearest points of the true surface, metres.
    covariances : array_like, shape (k, D, D)
        Those of the map's points, square metres.

    Returns
    -------
    ndarray
        Zero on the surface; infinite off it where there is no uncertainty.

    Raises
    ------
    ValueError
        If there is not one covariance (D, D) for each offset.
    """
    v, C = np.asarray(offsets, dtype=np.float64), np.asarray(covariances, dtype=np.float64)
    if v.ndim != 2 or C.shape != (*v.shape, v.shape[1]):
        raise ValueError(f"offsets {v.shape} and covariances {C.shape} do not fit together")
    square = (v * v).sum(axis=1)
    variance = (v * product(C, v[:, :, None])[:, :, 0]).sum(axis=1)
    chi2 = np.full(len(v), np.inf)
    np.divide(square * square, variance, out=chi2, where=variance > 0)
    return np.where(square > 0, chi2, 0.0)


def cell_face_offsets(
    points: ArrayLike, occupied: NDArray[np.bool_], grid: VoxelGrid
) -> NDArray[np.float64]:
    """The way (k, 2) from points (k, 2) to the nearest face between a free and an occupied cell.

    Metres. These faces are the true surface of a planar world, whose cells are the obstacles.

    Raises
    ------
    ValueError
        If the grid is not planar, the truth has another shape, or no cell has such a face.
    """
    if grid.dimension != 2 or occupied.shape != grid.shape:
        raise ValueError(f"expected a planar grid and its truth, got {grid} and {occupied.shape}")
    faces = occupied[1:] != occupied[:-1], occupied[:, 1:] != occupied[:, :-1]
    if not any(between.any() for between in faces):
        raise ValueError("the world has no face between a free and an occupied cell")
    position = np.ascontiguousarray(grid.to_cell_units(points))
    offsets = np.empty_like(position)
    _nearest_faces(position, occupied, offsets)
    return offsets * grid.resolution


@kernel
def _nearest_faces(
    points: NDArray[np.float64], occupied: NDArray[np.bool_], offsets: NDArray[np.float64]
) -> None:
    """Write the way from each point to the nearest face, all in cells, ring by ring of cells."""
    nx, ny = occupied.shape
    for n in range(len(points)):
        x, y = points[n, 0], points[n, 1]
        i, j = int(min(max(x, 0.0), nx - 1.0)), int(min(max(y, 0.0), ny - 1.0))
        best = np.inf
        for ring in range(max(nx, ny)):
            # faces of this ring's cells are at least this far away
            distance = max(ring - 1.0, 0.0)
            if best <= distance * distance:
                break
            for a in range(max(i - ring, 0), min(i + ring, nx - 1) + 1):
                step = 1 if abs(a - i) == ring else max(2 * ring, 1)
                for b in range(j - ring, j + ring + 1, step):
                    if 0 <= b < ny and occupied[a, b]:
                        best = _nearest_face_of_cell(x, y, (a, b), occupied, best, offsets[n])


@kernel
def _nearest_face_of_cell(
    x: float,
    y: float,
    cell: PlainTuple,
    occupied: NDArray[np.bool_],
    best: float,
    offset: NDArray[np.float64],
) -> float:
    """Least squared distance: `best`, or that of a free neighbour's face; then write the way."""
    a, b = cell
    nx, ny = occupied.shape
    for axis in range(2):
        for side in range(2):
            i = a + (2 * side - 1 if axis == 0 else 0)
            j = b + (2 * side - 1 if axis == 1 else 0)
            if not (0 <= i < nx and 0 <= j < ny) or occupied[i, j]:
                continue
            dx = (a + side if axis == 0 else min(max(x, float(a)), a + 1.0)) - x
            dy = (b + side if axis == 1 else min(max(y, float(b)), b + 1.0)) - y
            if dx * dx + dy * dy < best:
                best = dx * dx + dy * dy
                offset[0], offset[1] = dx, dy
    return best
