"""Exact grid traversal: every cell that a ray crosses, once, in order.

The walk goes from cell face to cell face (Amanatides & Woo 1987, "A fast voxel traversal
algorithm for ray tracing"), so no corner is skipped, as fixed-step sampling would. Everything is
in *cells*: lengths divided by the resolution, positions measured from the grid's lower corner.
`init_axis` and `step_voxel` are the two halves of the loop that each kernel writes around its own work;
a planar grid is one layer of a 3-D grid, so the same two functions serve both. Cells are flat
(row-major) numbers, which a step changes by one axis's stride.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

BORDER_FACTOR = 1.0 - 1e-9
"""Share of the way to the grid's border: entering distances are sums and carry rounding errors of
1e-13, which must not carry a walk out of the grid."""


@njit(cache=True, nogil=True, inline="always")
def init_axis(position, direction, size, stride):
    """One axis of a ray that starts inside the grid.

    Returns the first cell's share of the flat cell number, the change of it at each step, the
    distance to the first face, between faces, and to the border of the grid.
    """
    cell = math.floor(position)
    if direction > 0.0:
        first, delta = (cell + 1.0 - position) / direction, 1.0 / direction
        return (
            cell * stride,
            stride,
            first,
            delta,
            (first + (size - 1 - cell) * delta) * BORDER_FACTOR,
        )
    if direction < 0.0:
        first, delta = (cell - position) / direction, -1.0 / direction
        return cell * stride, -stride, first, delta, (first + cell * delta) * BORDER_FACTOR
    return cell * stride, 0, math.inf, math.inf, math.inf


@njit(cache=True, nogil=True, inline="always")
def step_voxel(cell, sx, sy, sz, tx, ty, tz, dx, dy, dz):
    """Step over the nearest face: the next cell, the next faces, the distance travelled.

    The nested form is faster than `tx <= ty and tx <= tz`: a planar ray never asks about z.
    """
    if tx <= ty:
        if tx <= tz:
            return cell + sx, tx + dx, ty, tz, tx
        return cell + sz, tx, ty, tz + dz, tz
    if ty <= tz:
        return cell + sy, tx, ty + dy, tz, ty
    return cell + sz, tx, ty, tz + dz, tz


@njit(cache=True, nogil=True)
def _traverse(p, u, length, shape, cells, entries):
    """Write the crossed cells and their entry distances; return how many."""
    nx, ny, nz = shape
    cx, sx, tx, dx, end_x = init_axis(p[0], u[0], nx, ny * nz)
    cy, sy, ty, dy, end_y = init_axis(p[1], u[1], ny, nz)
    cz, sz, tz, dz, end_z = init_axis(p[2], u[2], nz, 1)
    cell = cx + cy + cz
    end = min(length, end_x, end_y, end_z)
    t = 0.0
    count = 0
    while t < end:
        cells[count] = cell
        entries[count] = t
        count += 1
        cell, tx, ty, tz, t = step_voxel(cell, sx, sy, sz, tx, ty, tz, dx, dy, dz)
    return count


@dataclass(frozen=True)
class Traversal:
    """The cells that a ray crosses, in order, and the distances at which it enters each."""

    cells: NDArray[np.int64]
    """Shape (n, D): indices."""
    entries: NDArray[np.float64]
    """Shape (n,): distance from the ray's origin to the cell's near face, in cells."""


def traverse(
    origin: ArrayLike, direction: ArrayLike, length: float, shape: tuple[int, ...]
) -> Traversal:
    """Cells crossed by a ray from `origin`, until `length` or the grid ends.

    Parameters
    ----------
    origin : array_like, shape (D,), D = 2 or 3
        In cells, inside the grid.
    direction : array_like, shape (D,)
        Normalised here.
    length : float
        In cells.
    shape : tuple of D ints
        Cells of the grid along each axis.

    Raises
    ------
    ValueError
        If the dimensions disagree, a value is not finite, the direction is zero, or the origin
        lies outside the grid.
    """
    p, u = np.asarray(origin, dtype=np.float64), np.asarray(direction, dtype=np.float64)
    dimension = len(shape)
    if dimension not in (2, 3) or p.shape != (dimension,) or u.shape != (dimension,):
        raise ValueError(f"origin {p.shape} and direction {u.shape} do not fit a grid {shape}")
    norm = float(np.linalg.norm(u))
    if not (np.isfinite(p).all() and math.isfinite(norm) and math.isfinite(length)) or norm == 0:
        raise ValueError(f"a ray needs finite values: {p}, {u}, length {length}")
    if (p < 0).any() or (p >= shape).any():
        raise ValueError(f"ray origin {p} lies outside the grid of {shape} cells")
    pad = 3 - dimension
    p3, u3 = np.pad(p, (0, pad), constant_values=0.5), np.pad(u / norm, (0, pad))
    shape_3d = (*shape, *(1,) * pad)
    cells = np.empty(sum(shape_3d) + 3, dtype=np.int64)
    entries = np.empty(len(cells))
    n = _traverse(p3, u3, float(length), shape_3d, cells, entries)
    return Traversal(np.stack(np.unravel_index(cells[:n], shape), axis=-1), entries[:n].copy())
