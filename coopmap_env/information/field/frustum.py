"""The frustum of a depth camera, and the voxel columns that it cuts out of a grid.

Everything is in *cells*: lengths divided by the resolution, positions from the grid's lower corner.
A voxel belongs to a view if its center lies in the field of view, not nearer than `near` and not
further than `far`. The flat index of a voxel runs along z, so a view is a set of runs, one for
each vertical column: what the four planes and the two spheres leave of it follows from one division
each, and a walk along a run needs no further test.

Image coordinates are linear in the position: with (X, Y, Z) a point in the camera frame,
U = w/2 (X + Y / tan(h/2)) and V = h/2 (X + Z / tan(v/2)), so that U / X and V / X are pixels, and
the frustum's planes are U >= 0, V >= 0, U <= w X, V <= h X.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.elementary import tan
from coopmap_env.core.kernels import kernel
from coopmap_env.geometry import RigidTransform
from coopmap_env.sensing import DepthCamera

MAX_PIXEL_ANGLE = math.radians(2.5)
"""Largest angle of a pixel of the depth buffer: two and a half default voxels at the default depth
of field. Much larger pixels let a view pass through a known ground plane."""
MIN_DISTANCE = 1e-6
"""Cells: nearer centers are never seen, so that a depth is never zero."""
MIN_SLOPE = 1e-12
"""A plane with a smaller slope along z counts as vertical."""


class FrustumGeometry(NamedTuple):
    """A `Frustum` as kernels take it; lengths in cells."""

    tan_x: float
    """Tangent of half the horizontal field of view."""
    tan_y: float
    """Tangent of half the vertical field of view."""
    near: float
    far: float
    width: int
    """Pixels of the depth buffer along U."""
    height: int
    """Pixels of the depth buffer along V."""


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


@dataclass(frozen=True)
class Frustum:
    """What a camera could see in empty space, on cells of one size."""

    tangents: tuple[float, float]
    """Tangents of half the horizontal and half the vertical field of view."""
    near: float
    """Cells, distance from the camera."""
    far: float
    """Cells, distance from the camera."""
    pixels: tuple[int, int]
    """Width and height of the depth buffer."""

    @classmethod
    def from_camera(
        cls, camera: DepthCamera, resolution: float, pixel: float = MAX_PIXEL_ANGLE
    ) -> Frustum:
        """Frustum of a camera on cells of `resolution` metres; `pixel` radians at most."""
        fields = (camera.horizontal_field_of_view, camera.vertical_field_of_view)
        w, h = (math.ceil(field / pixel - 1e-9) for field in fields)
        a, b = (tan(field / 2) for field in fields)
        near = max(camera.near / resolution, MIN_DISTANCE)
        return cls((a, b), near, camera.far / resolution, (w, h))

    @cached_property
    def max_visible_cells(self) -> int:
        """N of Eq. 7: the voxels that the camera can see in empty space; a constant.

        The volume of the frustum in voxels: solid angle times (far^3 - near^3) / 3. How many
        centers it holds depends on the pose, by a few in a thousand.
        """
        a, b = self.tangents
        solid_angle = 4 * math.atan(a * b / math.sqrt(1 + a * a + b * b))
        return round(solid_angle * (self.far**3 - self.near**3) / 3)

    @cached_property
    def directions(self) -> NDArray[np.float64]:
        """Unit vectors (w h, 3) in the camera frame through the middle of each pixel, V fastest."""
        (a, b), (w, h) = self.tangents, self.pixels
        y = a * (2 * (np.arange(w) + 0.5) / w - 1)
        z = b * (2 * (np.arange(h) + 0.5) / h - 1)
        rays = np.stack(np.broadcast_arrays(1.0, y[:, None], z), axis=-1).reshape(-1, 3)
        return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))

    @property
    def geometry(self) -> FrustumGeometry:
        """The frustum as kernels take it."""
        return FrustumGeometry(*self.tangents, self.near, self.far, *self.pixels)

    def max_runs(self, shape: tuple[int, ...]) -> int:
        """Largest number of runs of a view on a grid."""
        nx, ny = (min(n, 2 * math.ceil(self.far) + 1) for n in shape[:2])
        return nx * ny + (2 * math.ceil(self.near) + 1) ** 2


@kernel
def projection_rows(rotation: NDArray[np.float64], frustum: FrustumGeometry) -> NDArray[np.float64]:
    """X, U and V as linear forms of a point relative to the camera: rows of a matrix (3, 3)."""
    rows = np.empty((3, 3))
    for k in range(3):
        rows[0, k] = rotation[k, 0]
        rows[1, k] = 0.5 * frustum.width * (rotation[k, 0] + rotation[k, 1] / frustum.tan_x)
        rows[2, k] = 0.5 * frustum.height * (rotation[k, 0] + rotation[k, 2] / frustum.tan_y)
    return rows


@kernel
def _ground_corners(
    pose: RigidTransform, frustum: FrustumGeometry
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Apex and corners of the frustum's pyramid, projected along z: x (5,) and y (5,)."""
    R, position, far = pose.rotation, pose.translation, frustum.far
    xs, ys = np.empty(5), np.empty(5)
    xs[0], ys[0] = position[0], position[1]
    for corner in range(4):
        y = frustum.tan_x if corner % 2 else -frustum.tan_x
        z = frustum.tan_y if corner < 2 else -frustum.tan_y
        xs[corner + 1] = position[0] + far * (R[0, 0] + y * R[0, 1] + z * R[0, 2])
        ys[corner + 1] = position[1] + far * (R[1, 0] + y * R[1, 1] + z * R[1, 2])
    return xs, ys


@kernel
def _hull_interval(
    x: float, xs: NDArray[np.float64], ys: NDArray[np.float64]
) -> tuple[float, float]:
    """Lowest and highest y at which the line of this x meets the hull of the points."""
    low, high = math.inf, -math.inf
    for e in range(len(xs)):
        for f in range(e):
            if (xs[e] <= x) != (xs[f] <= x):
                y = ys[e] + (x - xs[e]) * (ys[f] - ys[e]) / (xs[f] - xs[e])
                low, high = min(low, y), max(high, y)
    return low, high


@kernel
def _side_planes(
    rows: NDArray[np.float64], frustum: FrustumGeometry
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The four side planes as linear forms (4, 3), and one over their slopes along z (4,)."""
    planes, inverse = np.empty((4, 3)), np.empty(4)
    for k in range(3):
        planes[0, k], planes[1, k] = rows[1, k], frustum.width * rows[0, k] - rows[1, k]
        planes[2, k], planes[3, k] = rows[2, k], frustum.height * rows[0, k] - rows[2, k]
    for q in range(4):
        slope = planes[q, 2]
        inverse[q] = 1.0 / slope if abs(slope) > MIN_SLOPE else 1.0 / MIN_SLOPE
    return planes, inverse


@kernel
def _write_run(
    runs: FrustumRuns,
    n: int,
    cell: int,
    length: int,
    offset: tuple[float, float, float],
    rows: NDArray[np.float64],
) -> None:
    """Write run n: its first voxel is `cell`, with its center at `offset` from the camera."""
    dx, dy, dz = offset
    runs.first[n], runs.length[n] = cell, length
    runs.x[n] = rows[0, 0] * dx + rows[0, 1] * dy + rows[0, 2] * dz
    runs.u[n] = rows[1, 0] * dx + rows[1, 1] * dy + rows[1, 2] * dz
    runs.v[n] = rows[2, 0] * dx + rows[2, 1] * dy + rows[2, 2] * dz
    runs.half_height[n], runs.horizontal_quarters[n] = 2.0 * dz, 4.0 * (dx * dx + dy * dy)


@kernel
def frustum_runs(
    shape: tuple[int, int, int],
    pose: RigidTransform,
    rows: NDArray[np.float64],
    frustum: FrustumGeometry,
    runs: FrustumRuns,
) -> int:
    """Write the runs of a frustum; return how many there are. `rows` are `projection_rows`."""
    nx, ny, nz = shape
    near, far = frustum.near, frustum.far
    px, py, pz = pose.translation[0], pose.translation[1], pose.translation[2]
    # each plane bounds z from below or from above, at a height that is linear in x and y
    planes, inverse = _side_planes(rows, frustum)
    xs, ys = _ground_corners(pose, frustum)
    count = 0
    first_x = max(0, math.ceil(max(xs.min(), px - far) - 0.5))
    last_x = min(nx - 1, math.floor(min(xs.max(), px + far) - 0.5))
    dz = 0.5 - pz
    for i in range(first_x, last_x + 1):
        dx = i + 0.5 - px
        low, high = _hull_interval(i + 0.5, xs, ys)
        half = math.sqrt(max(far * far - dx * dx, 0.0))
        low, high = max(low, py - half), min(high, py + half)
        if low > high:
            continue
        for j in range(max(0, math.ceil(low - 0.5)), min(ny - 1, math.floor(high - 0.5)) + 1):
            dy = j + 0.5 - py
            bottom, top = 0.0, nz - 1.0
            for q in range(4):
                base = planes[q, 0] * dx + planes[q, 1] * dy + planes[q, 2] * dz
                height = -base * inverse[q]
                if inverse[q] > 0.0:
                    bottom = max(bottom, height)
                else:
                    top = min(top, height)
            horizontal = dx * dx + dy * dy
            if bottom > top or horizontal > far * far:
                continue
            half = math.sqrt(far * far - horizontal)
            lower, upper = math.ceil(max(bottom, -half - dz)), math.floor(min(top, half - dz))
            gap = math.sqrt(near * near - horizontal) if horizontal < near * near else 0.0
            # the ball that is too near cuts a column in two
            end = min(upper, math.floor(-gap - dz)) if gap > 0.0 else upper
            for _ in range(2):
                if lower <= end:
                    cell = (i * ny + j) * nz + lower
                    _write_run(runs, count, cell, end - lower + 1, (dx, dy, lower + dz), rows)
                    count += 1
                if gap == 0.0:
                    break
                lower, end = max(lower, math.ceil(gap - dz)), upper
    return count
