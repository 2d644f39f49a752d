"""Kernels of what a camera can see of a grid; lengths in cells, positions from its lower corner."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import kernel
from coopmap_env.mapping import MapArrays

Array = NDArray[np.float64]
Cells = NDArray[np.int64]

HALF_DIAGONAL = math.sqrt(3.0) / 2.0
"""Cells: half the diagonal of a voxel, by which its surface point may lie off its center."""


class Frustum(NamedTuple):
    """What a camera can see: a pyramid between two spheres."""

    rotation: Array
    """Shape (3, 3): of the camera, x is the optical axis."""
    position: Array
    """Shape (3,): cells."""
    tan_x: float
    tan_y: float
    """Tangents of half the fields of view."""
    near: float
    far: float
    """Cells from the camera."""


@kernel
def write_surface_voxels(
    occupancy: MapArrays,
    precision: Array,
    rows: NDArray[np.int32],
    frustum: Frustum,
    min_log_odds: int,
    cells: Cells,
) -> int:
    """Write the likely voxels with surface points around a frustum, ascending; return how many.

    `precision` has a row for each cell with points, `rows` (n_cells,) says which, -1 for none.
    """
    log_odds, _, (nx, ny, nz), _ = occupancy
    position, reach = frustum.position, frustum.far + HALF_DIAGONAL
    planes, low, high = np.empty((4, 3)), position.copy(), position.copy()
    _side_planes(frustum, reach, planes, low, high)
    count = 0
    for i in range(
        _first_column(low, position, reach, 0), _end_column(high, position, reach, 0, nx)
    ):
        dx = i + 0.5 - position[0]
        for j in range(
            _first_column(low, position, reach, 1), _end_column(high, position, reach, 1, ny)
        ):
            dy = j + 0.5 - position[1]
            rest = reach * reach - dx * dx - dy * dy
            if rest < 0.0:
                continue
            bottom, top = -math.sqrt(rest), math.sqrt(rest)
            for q in range(4):
                inside = planes[q, 0] * dx + planes[q, 1] * dy + HALF_DIAGONAL
                slope = planes[q, 2]
                if abs(slope) < 1e-9:
                    if inside < 0.0:
                        top = -math.inf
                elif slope > 0.0:
                    bottom = max(bottom, -inside / slope)
                else:
                    top = min(top, -inside / slope)
            if top < bottom:
                continue
            first = max(0, math.ceil(bottom + position[2] - 0.5))
            last = min(nz - 1, math.floor(top + position[2] - 0.5))
            column = (i * ny + j) * nz
            for cell in range(column + first, column + last + 1):
                if log_odds[cell] < min_log_odds or rows[cell] < 0:
                    continue
                if precision[rows[cell], 0, 0] > 0.0:
                    cells[count] = cell
                    count += 1
    return count


@kernel
def _side_planes(frustum: Frustum, reach: float, planes: Array, low: Array, high: Array) -> None:
    """Fill the inward normals (4, 3) of the sides; extend the box (3,), (3,) to their corners."""
    R, position = frustum.rotation, frustum.position
    a, b = frustum.tan_x, frustum.tan_y
    for q in range(4):
        s, t = 1.0 - 2.0 * (q % 2), 1.0 - 2.0 * (q // 2)
        for axis in range(3):
            corner = position[axis] + reach * (R[axis, 0] + s * a * R[axis, 1] + t * b * R[axis, 2])
            low[axis], high[axis] = min(low[axis], corner), max(high[axis], corner)
            side = s * R[axis, 1] if q < 2 else s * R[axis, 2]
            tangent = a if q < 2 else b
            planes[q, axis] = (tangent * R[axis, 0] + side) / math.sqrt(1.0 + tangent * tangent)


@kernel
def _first_column(low: Array, position: Array, reach: float, axis: int) -> int:
    """First column whose center is inside the frustum's box and sphere along an axis."""
    return max(0, math.ceil(max(low[axis] - HALF_DIAGONAL, position[axis] - reach) - 0.5))


@kernel
def _end_column(high: Array, position: Array, reach: float, axis: int, n: int) -> int:
    """One past the last such column."""
    return min(n, math.floor(min(high[axis] + HALF_DIAGONAL, position[axis] + reach) - 0.5) + 1)


@kernel
def distance_in_view(point: Array, frustum: Frustum, border: float) -> float:
    """Distance to a point in the field of view less its border, and in range; else infinity."""
    R, position, tan_x, tan_y, near, far = frustum
    dx, dy, dz = point[0] - position[0], point[1] - position[1], point[2] - position[2]
    x = R[0, 0] * dx + R[1, 0] * dy + R[2, 0] * dz
    y = R[0, 1] * dx + R[1, 1] * dy + R[2, 1] * dz
    z = R[0, 2] * dx + R[1, 2] * dy + R[2, 2] * dz
    distance = math.sqrt(dx * dx + dy * dy + dz * dz)
    width = (1.0 - border) * x
    in_view = x > 0.0 and abs(y) <= tan_x * width and abs(z) <= tan_y * width
    return distance if in_view and near <= distance <= far else math.inf
