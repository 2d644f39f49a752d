"""The occluding voxels that may hide something from a camera: those that its frustum touches.

All lengths are in cells. A voxel is a cube: it touches the frustum if its center is at most half
its width along the normal of each plane outside of it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import borrowing_kernel, kernel
from coopmap_env.core.words import lowest_bit
from coopmap_env.geometry import RigidTransform
from coopmap_env.information.field.frustum import FrustumGeometry, LinearForm, ground_corners
from coopmap_env.mapping.occluders import WORD

TOLERANCE = 1e-9
"""Cells; for rounding errors."""
BATCH = 64
"""Candidates from which on it pays to sort out those that the frustum does not touch."""


class ColumnBox(NamedTuple):
    """Columns of voxels: first and last index along x and y."""

    first_x: int
    last_x: int
    first_y: int
    last_y: int


@kernel
def touched_columns(
    shape: tuple[int, int, int], pose: RigidTransform, frustum: FrustumGeometry
) -> ColumnBox:
    """The box of all columns that a frustum touches; empty if a last one is below the first."""
    far, (px, py, _) = frustum.far, pose.translation
    xs, ys = ground_corners(pose, frustum)
    return ColumnBox(
        max(0, math.floor(max(xs.min(), px - far) - TOLERANCE)),
        min(shape[0] - 1, math.floor(min(xs.max(), px + far) + TOLERANCE)),
        max(0, math.floor(max(ys.min(), py - far) - TOLERANCE)),
        min(shape[1] - 1, math.floor(min(ys.max(), py + far) + TOLERANCE)),
    )


@borrowing_kernel
def list_bits(
    words: NDArray[np.uint64], first: int, end: int, cells: NDArray[np.int32], n: int
) -> int:
    """Append, to n cells, those of the bits from `first` to `end`; return how many there are then.

    The bits of a word are taken together, so that a few before and after are among them.
    """
    one = np.uint64(1)
    for w in range(np.uint64(first // WORD), np.uint64((end - 1) // WORD) + one):
        word, start = words[w], np.int64(w) * WORD
        while word != 0:
            cells[np.uint64(n)] = start + lowest_bit(word)
            word &= word - one
            n += 1
    return n


@borrowing_kernel
def keep_touched(
    cells: NDArray[np.int32],
    n: int,
    shape: tuple[int, int, int],
    position: NDArray[np.float64],
    forms: tuple[LinearForm, LinearForm, LinearForm],
    frustum: FrustumGeometry,
) -> int:
    """Move the cells that the frustum touches to the front; return how many there are.

    `forms` are X, U and V as linear forms. The first loop has no branch, so that the compiler uses
    vector registers: the index of a cell follows from products, not from divisions.
    """
    px, py, pz = position[0], position[1], position[2]
    ny, nz = float(shape[1]), float(shape[2])
    columns_per_cell, rows_per_column = 1.0 / nz, 1.0 / ny
    w, h, far = float(frustum.width), float(frustum.height), frustum.far
    (x0, x1, x2), (u0, u1, u2), (v0, v1, v2) = forms
    half_x = _half_width(x0, x1, x2)
    half_left = _half_width(u0, u1, u2)
    half_right = _half_width(w * x0 - u0, w * x1 - u1, w * x2 - u2)
    half_lower = _half_width(v0, v1, v2)
    half_upper = _half_width(h * x0 - v0, h * x1 - v1, h * x2 - v2)
    for m in range(n):
        cell = float(cells[m])
        column = np.floor((cell + 0.5) * columns_per_cell)
        row = np.floor((column + 0.5) * rows_per_column)
        dx, dy = row + 0.5 - px, column - row * ny + 0.5 - py
        dz = cell - column * nz + 0.5 - pz
        X = x0 * dx + x1 * dy + x2 * dz
        U = u0 * dx + u1 * dy + u2 * dz
        V = v0 * dx + v1 * dy + v2 * dz
        touched = (X + half_x > 0.0) & (X - half_x < far)
        touched &= (U + half_left > 0.0) & (w * X - U + half_right > 0.0)
        touched &= (V + half_lower > 0.0) & (h * X - V + half_upper > 0.0)
        cells[m] = cells[m] if touched else np.int32(-1)
    n_kept = 0
    for m in range(n):
        cells[n_kept] = cells[m]
        n_kept += cells[m] >= 0
    return n_kept


@borrowing_kernel
def _half_width(x: float, y: float, z: float) -> float:
    """Half the range of a linear form over a cube."""
    return 0.5 * (abs(x) + abs(y) + abs(z)) + TOLERANCE
