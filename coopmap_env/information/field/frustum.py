"""The frustum of a depth camera, and the voxel columns that it cuts out of a grid.

Everything is in *cells*: lengths divided by the resolution, positions from the grid's lower corner.
A voxel belongs to a view if its centre lies in the field of view, not nearer than `near` and not
further than `far`. The flat number of a voxel runs along z, so a view is a set of runs, one for
each vertical column: what the four planes and the two spheres leave of it follows from one division
each, and whoever walks along a run need not ask again whether he is inside.

Image coordinates are linear in the position: with (X, Y, Z) a point in the camera frame,
U = w/2 (X + Y / tan(h/2)) and V = h/2 (X + Z / tan(v/2)), so that U / X and V / X are pixels, and
the frustum's planes are U >= 0, V >= 0, U <= w X, V <= h X.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray

from coopmap_env.sensing import DepthCamera

MAX_PIXEL_ANGLE = math.radians(2.5)
"""Of the depth buffer, at most: two and a half default voxels at the default depth of field. Pixels
of 3.75 degrees are a quarter faster, but let a view look through a known ground plane."""
MIN_DISTANCE = 1e-6
"""Cells: nearer centres are never seen, so that a depth is never zero."""
MIN_SLOPE = 1e-12
"""A plane with a smaller slope along z counts as vertical."""


@dataclass(frozen=True)
class Frustum:
    """What a camera could see in empty space, on cells of one size."""

    tangents: tuple[float, float]
    """Of half the horizontal and half the vertical field of view."""
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
        a, b = (math.tan(field / 2) for field in fields)
        near = max(camera.near / resolution, MIN_DISTANCE)
        return cls((a, b), near, camera.far / resolution, (w, h))

    @cached_property
    def max_visible_cells(self) -> int:
        """N of Eq. 7: the voxels that the camera can see in empty space; a constant.

        The volume of the frustum in voxels: solid angle times (far^3 - near^3) / 3. How many
        centres it holds depends on the pose, by a few in a thousand.
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
    def projection(self) -> tuple[float, float, float, float, int, int]:
        """As kernels want it: both tangents, near, far, width, height."""
        return (*self.tangents, self.near, self.far, *self.pixels)

    def max_runs(self, shape: tuple[int, ...]) -> int:
        """Runs that a view can have on a grid, at most."""
        nx, ny = (min(n, 2 * math.ceil(self.far) + 1) for n in shape[:2])
        return nx * ny + (2 * math.ceil(self.near) + 1) ** 2


@njit(cache=True, nogil=True)
def projection_rows(R, projection):
    """X, U and V as linear forms of a point relative to the camera: rows of a matrix."""
    a, b, _, _, w, h = projection
    forms = np.empty((3, 3))
    for k in range(3):
        forms[0, k] = R[k, 0]
        forms[1, k] = 0.5 * w * (R[k, 0] + R[k, 1] / a)
        forms[2, k] = 0.5 * h * (R[k, 0] + R[k, 2] / b)
    return forms


@njit(cache=True, nogil=True)
def _ground_corners(position, R, projection):
    """Apex and corners of the pyramid, seen from above."""
    a, b, _, far, _, _ = projection
    xs, ys = np.empty(5), np.empty(5)
    xs[0], ys[0] = position[0], position[1]
    for corner in range(4):
        y = a if corner % 2 else -a
        z = b if corner < 2 else -b
        xs[corner + 1] = position[0] + far * (R[0, 0] + y * R[0, 1] + z * R[0, 2])
        ys[corner + 1] = position[1] + far * (R[1, 0] + y * R[1, 1] + z * R[1, 2])
    return xs, ys


@njit(cache=True, nogil=True)
def _hull_interval(x, xs, ys):
    """Lowest and highest y at which the line of this x meets the hull of the points."""
    low, high = math.inf, -math.inf
    for e in range(len(xs)):
        for f in range(e):
            if (xs[e] <= x) != (xs[f] <= x):
                y = ys[e] + (x - xs[e]) * (ys[f] - ys[e]) / (xs[f] - xs[e])
                low, high = min(low, y), max(high, y)
    return low, high


@njit(cache=True, nogil=True)
def frustum_runs(shape, position, R, forms, projection, runs, starts):
    """Write the runs of a frustum; return how many there are.

    `runs` (n, 2) receives the first voxel's flat number and the number of voxels; `starts` (n, 5)
    X, U and V of the first voxel, its height above the camera and the horizontal distance squared:
    the last two in half cells, so that their sum of squares is the distance in quarters of d^2.
    """
    nx, ny, nz = shape
    _, _, near, far, w, h = projection
    px, py, pz = position[0], position[1], position[2]
    # each plane bounds z from below or from above, at a height that is linear in x and y
    planes, inverse = np.empty((4, 3)), np.empty(4)
    for k in range(3):
        planes[0, k], planes[1, k] = forms[1, k], w * forms[0, k] - forms[1, k]
        planes[2, k], planes[3, k] = forms[2, k], h * forms[0, k] - forms[2, k]
    for q in range(4):
        slope = planes[q, 2]
        inverse[q] = 1.0 / slope if abs(slope) > MIN_SLOPE else 1.0 / MIN_SLOPE
    xs, ys = _ground_corners(position, R, projection)
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
            flat2 = dx * dx + dy * dy
            if bottom > top or flat2 > far * far:
                continue
            half = math.sqrt(far * far - flat2)
            lower, upper = math.ceil(max(bottom, -half - dz)), math.floor(min(top, half - dz))
            gap = math.sqrt(near * near - flat2) if flat2 < near * near else 0.0
            # the ball that is too near cuts a column in two
            end = min(upper, math.floor(-gap - dz)) if gap > 0.0 else upper
            for _ in range(2):
                if lower <= end:
                    runs[count, 0], runs[count, 1] = (i * ny + j) * nz + lower, end - lower + 1
                    z = lower + dz
                    for form in range(3):
                        starts[count, form] = (
                            forms[form, 0] * dx + forms[form, 1] * dy + forms[form, 2] * z
                        )
                    starts[count, 3], starts[count, 4] = 2.0 * z, 4.0 * flat2
                    count += 1
                if gap == 0.0:
                    break
                lower, end = max(lower, math.ceil(gap - dz)), upper
    return count
