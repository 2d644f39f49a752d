"""The frustum of a depth camera.

Everything is in *cells*: lengths divided by the resolution, positions from the grid's lower corner.
A voxel belongs to a view if its center lies in the field of view, not nearer than `near` and not
further than `far`.

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
from coopmap_env.core.kernels import inlined_kernel, kernel
from coopmap_env.geometry import RigidTransform
from coopmap_env.sensing import DepthCamera

MAX_PIXEL_ANGLE = math.radians(2.5)
"""Largest angle of a pixel of the depth buffer: two and a half default voxels at the default depth
of field. Much larger pixels let a view pass through a known ground plane."""
MIN_DISTANCE = 1e-6
"""Cells: nearer centers are never seen, so that a depth is never zero."""
LinearForm = tuple[float, float, float]
"""Factors of x, y and z."""


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

    def max_columns(self, n: int) -> int:
        """Largest number of n columns in a row that a view touches."""
        return min(n, 2 * math.ceil(self.far) + 3)

    def max_runs(self, shape: tuple[int, ...]) -> int:
        """Largest number of runs of a view on a grid."""
        nx, ny = (self.max_columns(n) for n in shape[:2])
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


@inlined_kernel
def linear_forms(rows: NDArray[np.float64]) -> tuple[LinearForm, LinearForm, LinearForm]:
    """The rows of `projection_rows` as numbers, which registers hold."""
    return (
        (rows[0, 0], rows[0, 1], rows[0, 2]),
        (rows[1, 0], rows[1, 1], rows[1, 2]),
        (rows[2, 0], rows[2, 1], rows[2, 2]),
    )


@kernel
def ground_corners(
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
