"""Exact grid traversal: every cell that a ray crosses, once, in order.

The ray goes from cell face to cell face (Amanatides & Woo 1987, "A fast voxel traversal algorithm
for ray tracing"), so no corner is skipped, as fixed-step sampling would. Everything is in *cells*:
lengths divided by the resolution, positions measured from the grid's lower corner. A planar grid is
one layer of a 3-D grid. Cells are flat (row-major) numbers, which a step changes by one axis's
stride.

Each kernel that follows rays writes the same loop around its own work::

    ray, position = start_ray(origin, direction, shape)
    while position.distance < ray.end:
        ...  # position.cell is entered at position.distance
        position = step_ray(ray, position)
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.kernels import inlined_kernel, kernel

BORDER_FACTOR = 1.0 - 1e-9
"""Factor of the distance to the grid's border: entry distances are sums and carry rounding errors
of 1e-13, which must not carry a ray out of the grid."""

Vector = tuple[float, float, float] | NDArray[np.float64]
"""Three numbers."""


class Ray(NamedTuple):
    """What stays the same along a ray."""

    strides: tuple[int, int, int]
    """Change of the flat cell index at a step along each axis."""
    deltas: tuple[float, float, float]
    """Distance between two faces across each axis, cells."""
    end: float
    """Distance at which the ray leaves the grid, cells."""


class RayPosition(NamedTuple):
    """A position on a ray: the current cell and the faces ahead."""

    cell: int
    """Flat index of the current cell; valid while `distance` is below `Ray.end`."""
    next_x: float
    """Distance at which the ray crosses the next face across x, cells; `next_y`, `next_z` alike."""
    next_y: float
    next_z: float
    distance: float
    """Distance at which the current cell is entered, cells."""


@inlined_kernel
def _init_axis(
    position: float, direction: float, size: int, stride: int
) -> tuple[int, int, float, float, float]:
    """One axis of a ray that starts inside the grid.

    Returns the first cell's part of the flat cell index, the change of it at each step, and the
    distances to the first face, between faces, and to the border of the grid.
    """
    cell = math.floor(position)
    if direction > 0.0:
        first, delta = (cell + 1.0 - position) / direction, 1.0 / direction
        end = (first + (size - 1 - cell) * delta) * BORDER_FACTOR
        return cell * stride, stride, first, delta, end
    if direction < 0.0:
        first, delta = (cell - position) / direction, -1.0 / direction
        return cell * stride, -stride, first, delta, (first + cell * delta) * BORDER_FACTOR
    return cell * stride, 0, math.inf, math.inf, math.inf


@inlined_kernel
def start_ray(
    origin: Vector, direction: Vector, shape: tuple[int, int, int]
) -> tuple[Ray, RayPosition]:
    """A ray from a point inside a grid of `shape` cells along a unit vector, at its first cell."""
    nx, ny, nz = shape
    cell_x, stride_x, next_x, delta_x, end_x = _init_axis(origin[0], direction[0], nx, ny * nz)
    cell_y, stride_y, next_y, delta_y, end_y = _init_axis(origin[1], direction[1], ny, nz)
    cell_z, stride_z, next_z, delta_z, end_z = _init_axis(origin[2], direction[2], nz, 1)
    strides, deltas = (stride_x, stride_y, stride_z), (delta_x, delta_y, delta_z)
    return (
        Ray(strides, deltas, min(end_x, end_y, end_z)),
        RayPosition(cell_x + cell_y + cell_z, next_x, next_y, next_z, 0.0),
    )


@inlined_kernel
def step_ray(ray: Ray, position: RayPosition) -> RayPosition:
    """Step over the nearest face into the next cell; of equally near faces, x before y before z.

    The nested form is faster than `x <= y and x <= z`: a planar ray never asks about z.
    """
    cell, x, y, z, _ = position
    stride_x, stride_y, stride_z = ray.strides
    delta_x, delta_y, delta_z = ray.deltas
    if x <= y:
        if x <= z:
            return RayPosition(cell + stride_x, x + delta_x, y, z, x)
        return RayPosition(cell + stride_z, x, y, z + delta_z, z)
    if y <= z:
        return RayPosition(cell + stride_y, x, y + delta_y, z, y)
    return RayPosition(cell + stride_z, x, y, z + delta_z, z)


@kernel
def _traverse(
    origin: NDArray[np.float64],
    direction: NDArray[np.float64],
    length: float,
    shape: tuple[int, int, int],
    cells: NDArray[np.int64],
    entries: NDArray[np.float64],
) -> int:
    """Write the crossed cells and their entry distances; return how many."""
    ray, position = start_ray(origin, direction, shape)
    end = min(length, ray.end)
    count = 0
    while position.distance < end:
        cells[count] = position.cell
        entries[count] = position.distance
        count += 1
        position = step_ray(ray, position)
    return count


@dataclass(frozen=True)
class Traversal:
    """Cells that a ray crosses, in order, and the distances at which it enters each."""

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
    norm = float(np.linalg.norm(u, axis=-1))  # without an axis, it calls BLAS
    if not (np.isfinite(p).all() and math.isfinite(norm) and math.isfinite(length)) or norm == 0:
        raise ValueError(f"a ray needs finite values: {p}, {u}, length {length}")
    if (p < 0).any() or (p >= shape).any():
        raise ValueError(f"ray origin {p} lies outside the grid of {shape} cells")
    pad = 3 - dimension
    p3, u3 = np.pad(p, (0, pad), constant_values=0.5), np.pad(u / norm, (0, pad))
    nx, ny, nz = (*shape, 1)[:3]
    cells = np.empty(nx + ny + nz + 3, dtype=np.int64)
    entries = np.empty(len(cells))
    n = _traverse(p3, u3, float(length), (nx, ny, nz), cells, entries)
    return Traversal(np.stack(np.unravel_index(cells[:n], shape), axis=-1), entries[:n].copy())
