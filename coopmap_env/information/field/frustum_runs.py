"""The voxel columns that a frustum cuts out of a grid.

The flat index of a voxel runs along z, so a view is a set of runs, one for each vertical column:
what the four planes and the two spheres leave of it follows from one division each, and a walk
along a run needs no further test. Everything is in cells, see `frustum`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import borrowing_kernel, inlined_kernel, kernel
from coopmap_env.geometry import RigidTransform
from coopmap_env.information.field.frustum import (
    FrustumGeometry,
    LinearForm,
    ground_corners,
    linear_forms,
)

MIN_SLOPE = 1e-12
"""A plane with a smaller slope along z counts as vertical."""
HULL_MARGIN = 1e-6
"""Cells by which a frustum's projection along z is wider than it is, for rounding errors; which
voxels belong to it follows from its planes."""


Plane = tuple[float, float, float, float]
"""A plane through the camera: a linear form, >= 0 inside, and one over its slope along z."""


class FrustumRuns(NamedTuple):
    """Voxel runs of a frustum, each along z; arrays (max_runs,).

    ``half_height**2 + horizontal_quarters``, rounded down, is the squared distance of a voxel in
    quarters of a squared cell: tables by distance are indexed by it.
    """

    first: NDArray[np.int64]
    """Flat index of the first voxel."""
    length: NDArray[np.int64]
    """Number of voxels."""
    x: NDArray[np.float64]
    """X of the first voxel's center: its depth along the optical axis, cells."""
    u: NDArray[np.float64]
    """U of the first voxel's center."""
    v: NDArray[np.float64]
    """V of the first voxel's center."""
    half_height: NDArray[np.float64]
    """Height of the first voxel's center above the camera, half cells."""
    horizontal_quarters: NDArray[np.float64]
    """Squared horizontal distance from the camera, quarters of a squared cell."""


@kernel
def _hull_segments(xs: NDArray[np.float64], ys: NDArray[np.float64]) -> NDArray[np.float64]:
    """Segments between all points, rows of first x, last x, y at the first x, and slope."""
    segments = np.empty((len(xs) * (len(xs) - 1) // 2, 4))
    n = 0
    for e in range(len(xs)):
        for f in range(e):
            a, b = (e, f) if xs[e] < xs[f] else (f, e)
            segments[n, 0], segments[n, 1], segments[n, 2] = xs[a], xs[b], ys[a]
            segments[n, 3] = (ys[b] - ys[a]) / (xs[b] - xs[a]) if xs[a] < xs[b] else 0.0
            n += 1
    return segments


@borrowing_kernel
def _hull_interval(x: float, segments: NDArray[np.float64]) -> tuple[float, float]:
    """Lowest and highest y at which the line of this x meets the hull of the points."""
    low, high = math.inf, -math.inf
    for n in range(len(segments)):
        if segments[n, 0] <= x < segments[n, 1]:
            y = segments[n, 2] + (x - segments[n, 0]) * segments[n, 3]
            low, high = min(low, y), max(high, y)
    return low - HULL_MARGIN, high + HULL_MARGIN


@inlined_kernel
def _side_plane(x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """A side plane as a linear form, and one over its slope along z."""
    return x, y, z, 1.0 / (z if abs(z) > MIN_SLOPE else MIN_SLOPE)


@borrowing_kernel
def _side_planes(rows: NDArray[np.float64], frustum: FrustumGeometry) -> tuple[Plane, ...]:
    """The four side planes: U >= 0, U <= w X, V >= 0, V <= h X."""
    x, u, v = rows[0], rows[1], rows[2]
    w, h = frustum.width, frustum.height
    return (
        _side_plane(u[0], u[1], u[2]),
        _side_plane(w * x[0] - u[0], w * x[1] - u[1], w * x[2] - u[2]),
        _side_plane(v[0], v[1], v[2]),
        _side_plane(h * x[0] - v[0], h * x[1] - v[1], h * x[2] - v[2]),
    )


@inlined_kernel
def _cut(
    plane: Plane, dx: float, dy: float, dz: float, bottom: float, top: float
) -> tuple[float, float]:
    """What a plane leaves of a column: it bounds z from below or from above.

    The height at which it does is linear in x and y.
    """
    height = -(plane[0] * dx + plane[1] * dy + plane[2] * dz) * plane[3]
    is_floor = plane[3] > 0.0
    return max(bottom, height if is_floor else bottom), min(top, top if is_floor else height)


@borrowing_kernel
def _column_spans(
    column: tuple[float, float, float],
    n: int,
    nz: int,
    planes: tuple[Plane, ...],
    far: float,
    spans: NDArray[np.float64],
) -> None:
    """Write the lowest and the highest voxel of n columns along y to the rows of `spans`.

    `column` is the center of the first one's lowest voxel, from the camera. Where the frustum
    leaves nothing, the highest lies below the lowest one. There is no branch in the loop, so that
    the compiler uses vector registers.
    """
    dx, first_dy, dz = column
    left, right, lower, upper = planes
    low, high = spans[0], spans[1]
    for k in range(n):
        dy = first_dy + k
        bottom, top = _cut(left, dx, dy, dz, 0.0, nz - 1.0)
        bottom, top = _cut(right, dx, dy, dz, bottom, top)
        bottom, top = _cut(lower, dx, dy, dz, bottom, top)
        bottom, top = _cut(upper, dx, dy, dz, bottom, top)
        horizontal = dx * dx + dy * dy
        half = math.sqrt(max(far * far - horizontal, 0.0))
        is_empty = (bottom > top) | (horizontal > far * far)
        low[k] = np.ceil(max(bottom, -half - dz))
        high[k] = -1.0 if is_empty else np.floor(min(top, half - dz))


@inlined_kernel
def _write_run(
    runs: FrustumRuns,
    n: int,
    cell: int,
    length: int,
    offset: tuple[float, float, float],
    forms: tuple[LinearForm, LinearForm, LinearForm],
) -> None:
    """Write run n: its first voxel is `cell`, with its center at `offset` from the camera."""
    dx, dy, dz = offset
    (x0, x1, x2), (u0, u1, u2), (v0, v1, v2) = forms
    at = np.uint64(n)
    runs.first[at], runs.length[at] = cell, length
    runs.x[at] = x0 * dx + x1 * dy + x2 * dz
    runs.u[at] = u0 * dx + u1 * dy + u2 * dz
    runs.v[at] = v0 * dx + v1 * dy + v2 * dz
    runs.half_height[at], runs.horizontal_quarters[at] = 2.0 * dz, 4.0 * (dx * dx + dy * dy)


@kernel
def frustum_runs(
    shape: tuple[int, int, int],
    pose: RigidTransform,
    rows: NDArray[np.float64],
    frustum: FrustumGeometry,
    runs: FrustumRuns,
) -> int:
    """Write the runs of a frustum; return how many there are. `rows` are `projection_rows`."""
    xs, ys = ground_corners(pose, frustum)
    segments, spans = _hull_segments(xs, ys), np.empty((2, shape[1]))
    return _write_runs(shape, pose, rows, frustum, (xs.min(), xs.max()), segments, spans, runs)


@borrowing_kernel
def _write_runs(
    shape: tuple[int, int, int],
    pose: RigidTransform,
    rows: NDArray[np.float64],
    frustum: FrustumGeometry,
    x_range: tuple[float, float],
    segments: NDArray[np.float64],
    spans: NDArray[np.float64],
    runs: FrustumRuns,
) -> int:
    nx, ny, nz = shape
    near, far = frustum.near, frustum.far
    px, py, pz = pose.translation[0], pose.translation[1], pose.translation[2]
    planes, forms = _side_planes(rows, frustum), linear_forms(rows)
    count = 0
    first_x = max(0, math.ceil(max(x_range[0], px - far) - 0.5))
    last_x = min(nx - 1, math.floor(min(x_range[1], px + far) - 0.5))
    dz = 0.5 - pz
    for i in range(first_x, last_x + 1):
        dx = i + 0.5 - px
        low, high = _hull_interval(i + 0.5, segments)
        half = math.sqrt(max(far * far - dx * dx, 0.0))
        low, high = max(low, py - half), min(high, py + half)
        if low > high:
            continue
        first_y = max(0, math.ceil(low - 0.5))
        n = min(ny - 1, math.floor(high - 0.5)) + 1 - first_y
        _column_spans((dx, first_y + 0.5 - py, dz), n, nz, planes, far, spans)
        for k in range(n):
            if spans[0, k] > spans[1, k]:
                continue
            lower, upper = int(spans[0, k]), int(spans[1, k])
            column, dy = (i * ny + first_y + k) * nz, first_y + k + 0.5 - py
            squared_gap = near * near - (dx * dx + dy * dy)
            if squared_gap > 0.0:  # the ball that is too near cuts the column in two
                gap = math.sqrt(squared_gap)
                end = min(upper, math.floor(-gap - dz))
                if lower <= end:
                    offset = (dx, dy, lower + dz)
                    _write_run(runs, count, column + lower, end - lower + 1, offset, forms)
                    count += 1
                lower = max(lower, math.ceil(gap - dz))
                if lower > upper:
                    continue
            offset = (dx, dy, lower + dz)
            _write_run(runs, count, column + lower, upper - lower + 1, offset, forms)
            count += 1
    return count
