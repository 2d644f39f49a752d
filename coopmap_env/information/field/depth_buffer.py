"""The depth buffer of a view: how deep each pixel looks into the known map.

Occluders are sampled voxels with P >= 1/2, and the spheres that cover the other robots; unknown
voxels let the view pass. The voxel that holds the camera hides nothing.

Most rays meet nothing. No ray is followed beyond the box that holds all occluding voxels, which
halves the way of all rays; to find the box costs as much as it saves in four views.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from coopmap_env.geometry.traversal import init_axis, step_voxel

DEPTH_TOLERANCE = math.sqrt(3.0) / 2.0
"""Cells by which the centre of a visible voxel may lie behind the surface that a pixel saw: half
the diagonal of a voxel, so that an occluder's own voxels count as seen whichever way it faces."""
BOX_MARGIN = 1e-6
"""Cells by which the box of the occluders is larger than they are: distances carry rounding
errors of 1e-13."""


@njit(cache=True, nogil=True)
def occluder_bounds(log_odds_fixed, sampled, shape, box):
    """Write the lower and the upper corner (2, 3) of a box that holds all occluding voxels.

    Without any the lower corner lies above the upper one, and every ray is outside at once.
    """
    nx, ny, nz = shape
    heights = np.zeros(nz, np.uint8)
    low_x, high_x, low_y, high_y, low_z, high_z = nx, -1, ny, -1, nz, -1
    for i in range(nx):
        for j in range(ny):
            first = (i * ny + j) * nz
            level, known = log_odds_fixed[first : first + nz], sampled[first : first + nz]
            found = np.uint8(0)
            for k in range(nz):
                occludes = known[k] * np.uint8(level[k] >= 0)  # many at once without a branch
                heights[k] |= occludes
                found |= occludes
            if found:
                low_x, high_x = min(low_x, i), i
                low_y, high_y = min(low_y, j), max(high_y, j)
    for k in range(nz):
        if heights[k]:
            low_z, high_z = min(low_z, k), k
    box[0, 0], box[0, 1], box[0, 2] = low_x - BOX_MARGIN, low_y - BOX_MARGIN, low_z - BOX_MARGIN
    box[1, 0], box[1, 1], box[1, 2] = (
        high_x + 1 + BOX_MARGIN,
        high_y + 1 + BOX_MARGIN,
        high_z + 1 + BOX_MARGIN,
    )


@njit(cache=True, nogil=True)
def is_outside(shape, position):
    """Whether a position is in no cell of the grid; such a camera sees nothing."""
    inside = 0
    for axis in range(3):
        inside += 0.0 <= position[axis] < shape[axis]
    return inside < 3


@njit(cache=True, nogil=True, inline="always")
def _exit_distance(position, direction, low, high):
    """Distance at which a ray leaves the space between two planes of an axis for good."""
    if direction > 0.0:
        return (high - position) / direction
    if direction < 0.0:
        return (low - position) / direction
    return math.inf


@njit(cache=True, nogil=True)
def _first_occluder(log_odds_fixed, sampled, shape, box, position, ux, uy, uz, far):
    """Distance at which a ray enters the first occluding voxel, or infinity."""
    nx, ny, nz = shape
    cx, sx, tx, dx, end_x = init_axis(position[0], ux, nx, ny * nz)
    cy, sy, ty, dy, end_y = init_axis(position[1], uy, ny, nz)
    cz, sz, tz, dz, end_z = init_axis(position[2], uz, nz, 1)
    cell = cx + cy + cz
    end = min(far, end_x, end_y, end_z)
    end = min(end, _exit_distance(position[0], ux, box[0, 0], box[1, 0]))
    end = min(end, _exit_distance(position[1], uy, box[0, 1], box[1, 1]))
    end = min(end, _exit_distance(position[2], uz, box[0, 2], box[1, 2]))
    while True:
        cell, tx, ty, tz, t = step_voxel(cell, sx, sy, sz, tx, ty, tz, dx, dy, dz)
        if t >= end:
            return math.inf
        index = np.uint64(cell)  # the compiler guards signed indices against negative ones
        if log_odds_fixed[index] >= 0:  # noqa: SIM102 - nested is faster
            if sampled[index]:
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
def add_spheres(position, R, projection, directions, spheres, radii, distances):
    """Shorten the distances (w h,) along rays that meet a sphere."""
    a, b, _, far, w, h = projection
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
    log_odds_fixed,
    sampled,
    shape,
    box,
    position,
    R,
    projection,
    directions,
    spheres,
    radii,
    distances,
    limits,
):
    """Write the depth X down to which each pixel sees, tolerance included.

    `box` (2, 3) holds all occluding voxels; `distances` (w h,) is scratch. `limits`
    ((w + 1)(h + 1),) has one more row and column, copies of the last: a voxel on the very border
    of the image need not be told apart.
    """
    _, _, _, far, w, h = projection
    for p in range(w * h):
        x, y, z = directions[p, 0], directions[p, 1], directions[p, 2]
        distances[p] = _first_occluder(
            log_odds_fixed, sampled, shape, box, position,
            R[0, 0] * x + R[0, 1] * y + R[0, 2] * z,
            R[1, 0] * x + R[1, 1] * y + R[1, 2] * z,
            R[2, 0] * x + R[2, 1] * y + R[2, 2] * z, far,
        )  # fmt: skip
    add_spheres(position, R, projection, directions, spheres, radii, distances)
    for u in range(w + 1):
        for v in range(h + 1):
            p = min(u, w - 1) * h + min(v, h - 1)
            limits[u * (h + 1) + v] = (distances[p] + DEPTH_TOLERANCE) * directions[p, 0]
