"""Depth images of a target, by scan conversion of its triangles.

A hypothesis of the target's pose is compared with a measured depth image pixel by pixel: each pixel
sees the target there, something in front of it, or through it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import kernel
from coopmap_env.geometry import RigidTransform
from coopmap_env.sensing import PinholeIntrinsics

Array = NDArray[np.float64]

NEAR_PLANE = 0.05
"""Metres in front of the camera. Triangles that reach nearer are not drawn."""


class DepthImage(NamedTuple):
    """What a camera would see of a target; n pixels, row by row."""

    depth: Array
    """Shape (n,): metres along the optical axis, infinity where no triangle is seen."""
    triangle_index: NDArray[np.int64]
    """Shape (n,): the triangle that is seen, -1 for none."""

    @classmethod
    def empty(cls, n_pixels: int) -> DepthImage:
        """An image to be filled by `render_depth`."""
        return cls(np.empty(n_pixels), np.empty(n_pixels, dtype=np.int64))


@kernel
def render_depth(
    triangles: Array,
    T_camera_target: RigidTransform,
    intrinsics: PinholeIntrinsics,
    image: DepthImage,
) -> None:
    """Fill an image with triangles (m, 3, 3) of the target's frame.

    In the image the inverse depth of a plane is an affine function, so each pixel's depth is exact.
    """
    R, t = T_camera_target
    width, height, tan_x, tan_y = intrinsics
    image.depth[:] = np.inf
    image.triangle_index[:] = -1
    p = np.empty((3, 3))
    col = np.empty(3)
    row = np.empty(3)
    for m in range(len(triangles)):
        crosses_near_plane = False
        for i in range(3):
            for k in range(3):
                p[i, k] = (
                    R[k, 0] * triangles[m, i, 0]
                    + R[k, 1] * triangles[m, i, 1]
                    + R[k, 2] * triangles[m, i, 2]
                    + t[k]
                )
            if p[i, 0] < NEAR_PLANE:
                crosses_near_plane = True
                break
            col[i] = 0.5 * width * (1.0 - p[i, 1] / (p[i, 0] * tan_x)) - 0.5
            row[i] = 0.5 * height * (1.0 - p[i, 2] / (p[i, 0] * tan_y)) - 0.5
        if not crosses_near_plane:
            _fill_triangle(p, col, row, m, intrinsics, image)


@kernel
def _fill_triangle(
    p: Array, col: Array, row: Array, index: int, intrinsics: PinholeIntrinsics, image: DepthImage
) -> None:
    """Draw one triangle: corners `p` (3, 3) in the camera frame, their image coordinates (3,)."""
    width, height = intrinsics.width, intrinsics.height
    first, last = math.ceil(max(row.min(), 0.0)), math.floor(min(row.max(), height - 1.0))
    start, stop = math.ceil(max(col.min(), 0.0)), math.floor(min(col.max(), width - 1.0))
    if first > last or start > stop:
        return
    double_area = (col[1] - col[0]) * (row[2] - row[0]) - (col[2] - col[0]) * (row[1] - row[0])
    if abs(double_area) < 1e-12:
        return
    for r in range(first, last + 1):
        for c in range(start, stop + 1):
            w1 = ((c - col[0]) * (row[2] - row[0]) - (col[2] - col[0]) * (r - row[0])) / double_area
            w2 = ((col[1] - col[0]) * (r - row[0]) - (c - col[0]) * (row[1] - row[0])) / double_area
            w0 = 1.0 - w1 - w2
            if w0 < 0.0 or w1 < 0.0 or w2 < 0.0:
                continue
            x = 1.0 / (w0 / p[0, 0] + w1 / p[1, 0] + w2 / p[2, 0])
            k = r * width + c
            if x < image.depth[k]:
                image.depth[k] = x
                image.triangle_index[k] = index


@kernel
def min_neighbour_range(ranges: Array, width: int, height: int, out: Array) -> None:
    """Fill the least range (n,) of each pixel and its eight neighbours; 0 at the image's border.

    Ranges beyond the border are unknown, so a pixel there never sees through anything.
    """
    out[:] = 0.0
    for r in range(1, height - 1):
        for c in range(1, width - 1):
            least = np.inf
            for i in range(r - 1, r + 2):
                for j in range(c - 1, c + 2):
                    least = min(least, ranges[i * width + j])
            out[r * width + c] = least
