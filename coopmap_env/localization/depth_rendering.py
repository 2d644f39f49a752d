"""What a camera would see of a target alone: a depth image of its triangles, by scan conversion.

An image is all that a hypothesis of where the target stands can be held against: pixel by pixel the
camera sees the target there, something in front of it, or through it.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from coopmap_env.sensing.depth_camera import DepthCamera

NEAR_PLANE = 0.05
"""Metres in front of the camera: triangles that reach nearer or behind it are left out."""

PinholeIntrinsics = tuple[int, int, float, float]
"""Width and height in pixels, and the tangents of half the fields of view."""


def pinhole_intrinsics(camera: DepthCamera) -> PinholeIntrinsics:
    """The numbers of a camera that kernels need."""
    return (
        int(camera.width), int(camera.height),
        math.tan(camera.horizontal_field_of_view / 2), math.tan(camera.vertical_field_of_view / 2),
    )  # fmt: skip


@njit(cache=True, nogil=True)
def render_depth(triangles, R, t, intrinsics, depth, triangle_index):
    """Fill depths along the optical axis (n,) and the triangle seen (n,) by each pixel.

    Pixels through which no triangle is seen keep depth infinity and triangle -1. `R`, `t` lead from
    the triangles' frame into the camera's, `intrinsics` is `pinhole_intrinsics`'s. In the image, the inverse depth
    of a plane is an affine function, so every pixel's depth is exact.
    """
    width, height, left, top = intrinsics
    depth[:] = np.inf
    triangle_index[:] = -1
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
            col[i] = 0.5 * width * (1.0 - p[i, 1] / (p[i, 0] * left)) - 0.5
            row[i] = 0.5 * height * (1.0 - p[i, 2] / (p[i, 0] * top)) - 0.5
        if crosses_near_plane:
            continue
        first, last = math.ceil(max(row.min(), 0.0)), math.floor(min(row.max(), height - 1.0))
        start, stop = math.ceil(max(col.min(), 0.0)), math.floor(min(col.max(), width - 1.0))
        if first > last or start > stop:
            continue
        double_area = (col[1] - col[0]) * (row[2] - row[0]) - (col[2] - col[0]) * (row[1] - row[0])
        if abs(double_area) < 1e-12:
            continue
        for r in range(first, last + 1):
            for c in range(start, stop + 1):
                w1 = (
                    (c - col[0]) * (row[2] - row[0]) - (col[2] - col[0]) * (r - row[0])
                ) / double_area
                w2 = (
                    (col[1] - col[0]) * (r - row[0]) - (c - col[0]) * (row[1] - row[0])
                ) / double_area
                w0 = 1.0 - w1 - w2
                if w0 < 0.0 or w1 < 0.0 or w2 < 0.0:
                    continue
                x = 1.0 / (w0 / p[0, 0] + w1 / p[1, 0] + w2 / p[2, 0])
                k = r * width + c
                if x < depth[k]:
                    depth[k] = x
                    triangle_index[k] = m


@njit(cache=True, nogil=True)
def min_neighbour_range(ranges, width, height, out):
    """Fill the least range (n,) of each pixel and its eight neighbours; 0 at the image's border.

    What lies beyond the border is not known, so a pixel there never sees through anything.
    """
    out[:] = 0.0
    for r in range(1, height - 1):
        for c in range(1, width - 1):
            least = np.inf
            for i in range(r - 1, r + 2):
                for j in range(c - 1, c + 2):
                    least = min(least, ranges[i * width + j])
            out[r * width + c] = least
