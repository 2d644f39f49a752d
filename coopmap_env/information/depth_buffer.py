"""The depth buffer of a view: how deep each pixel looks into the known map.

Occluders are sampled voxels with P >= 1/2, and the spheres that cover the other robots; unknown
voxels let the view pass. The voxel that holds the camera hides nothing.
"""

from __future__ import annotations

import math

from numba import njit

from coopmap_env.geometry.traversal import advance, begin

THICKNESS = math.sqrt(3.0) / 2.0
"""Cells by which the centre of a visible voxel may lie behind the surface that a pixel saw: half
the diagonal of a voxel, so that an occluder's own voxels count as seen whichever way it faces."""


@njit(cache=True, nogil=True)
def is_outside(shape, position):
    """Whether a position is in no cell of the grid; such a camera sees nothing."""
    inside = 0
    for axis in range(3):
        inside += 0.0 <= position[axis] < shape[axis]
    return inside < 3


@njit(cache=True, nogil=True)
def _first_occluder(levels, sampled, shape, position, ux, uy, uz, far):
    """Distance at which a ray enters the first occluding voxel, or infinity."""
    nx, ny, nz = shape
    cx, sx, tx, dx, end_x = begin(position[0], ux, nx, ny * nz)
    cy, sy, ty, dy, end_y = begin(position[1], uy, ny, nz)
    cz, sz, tz, dz, end_z = begin(position[2], uz, nz, 1)
    cell = cx + cy + cz
    end = min(far, end_x, end_y, end_z)
    while True:
        cell, tx, ty, tz, t = advance(cell, sx, sy, sz, tx, ty, tz, dx, dy, dz)
        if t >= end:
            return math.inf
        if levels[cell] >= 0:  # noqa: SIM102 - nested is faster
            if sampled[cell]:
                return t


@njit(cache=True, nogil=True)
def _pixel_span(center, radius, depth, tangent, n):
    """First and last pixel, along one image axis, that a sphere in front may cover."""
    low, high = center - radius, center + radius
    low /= depth + radius if low > 0.0 else depth - radius
    high /= depth - radius if high > 0.0 else depth + radius
    half = 0.5 * n
    # half a pixel of slack: only rays through the middle of pixels are asked
    first = max(0.0, math.floor(half * (1.0 + low / tangent) - 0.5))
    last = min(n - 1.0, math.ceil(half * (1.0 + high / tangent) - 0.5))
    return int(first), int(last)


@njit(cache=True, nogil=True)
def add_spheres(position, R, lens, directions, spheres, radii, distances):
    """Shorten the distances (w h,) along rays that meet a sphere."""
    a, b, _, far, w, h = lens
    for s in range(len(radii)):
        dx, dy, dz = (
            spheres[s, 0] - position[0],
            spheres[s, 1] - position[1],
            spheres[s, 2] - position[2],
        )
        r = radii[s]
        d2 = dx * dx + dy * dy + dz * dz
        x = R[0, 0] * dx + R[1, 0] * dy + R[2, 0] * dz
        # around the camera, behind it, or too far
        if d2 <= r * r or x <= -r or d2 >= (far + r) * (far + r):
            continue
        y = R[0, 1] * dx + R[1, 1] * dy + R[2, 1] * dz
        z = R[0, 2] * dx + R[1, 2] * dy + R[2, 2] * dz
        u0, u1, v0, v1 = 0, w - 1, 0, h - 1
        if x > r:
            u0, u1 = _pixel_span(y, r, x, a, w)
            v0, v1 = _pixel_span(z, r, x, b, h)
        for u in range(u0, u1 + 1):
            for v in range(v0, v1 + 1):
                p = u * h + v
                along = directions[p, 0] * x + directions[p, 1] * y + directions[p, 2] * z
                inside = along * along - (d2 - r * r)
                if along > 0.0 and inside >= 0.0:
                    distances[p] = min(distances[p], along - math.sqrt(inside))


@njit(cache=True, nogil=True)
def depth_limits(
    levels, sampled, shape, position, R, lens, directions, spheres, radii, distances, limits
):
    """Write the depth X down to which each pixel sees, tolerance included.

    `distances` (w h,) is scratch. `limits` ((w + 1)(h + 1),) has one more row and column, copies of
    the last: a voxel on the very border of the image need not be told apart.
    """
    _, _, _, far, w, h = lens
    for p in range(w * h):
        x, y, z = directions[p, 0], directions[p, 1], directions[p, 2]
        distances[p] = _first_occluder(
            levels, sampled, shape, position,
            R[0, 0] * x + R[0, 1] * y + R[0, 2] * z,
            R[1, 0] * x + R[1, 1] * y + R[1, 2] * z,
            R[2, 0] * x + R[2, 1] * y + R[2, 2] * z, far,
        )  # fmt: skip
    add_spheres(position, R, lens, directions, spheres, radii, distances)
    for u in range(w + 1):
        for v in range(h + 1):
            p = min(u, w - 1) * h + min(v, h - 1)
            limits[u * (h + 1) + v] = (distances[p] + THICKNESS) * directions[p, 0]
