"""Whether a map lets one see from a point to another: one exact walk through its voxels."""

from __future__ import annotations

import math

from numba import njit

from coopmap_env.geometry.traversal import init_axis, step_voxel


@njit(cache=True, nogil=True)
def has_line_of_sight(log_odds_fixed, sampled, shape, start, end, slack):
    """Whether no occupied voxel (sampled, P >= 1/2) lies between those of two points, in cells.

    In the last `slack` cells before the end they hide nothing. From outside of the grid nothing is
    seen.
    """
    nx, ny, nz = shape
    for axis in range(3):
        if not 0.0 <= start[axis] < shape[axis]:
            return False
    ux, uy, uz = end[0] - start[0], end[1] - start[1], end[2] - start[2]
    length = math.sqrt(ux * ux + uy * uy + uz * uz)
    ux, uy, uz = ux / length, uy / length, uz / length
    cx, sx, tx, dx, end_x = init_axis(start[0], ux, nx, ny * nz)
    cy, sy, ty, dy, end_y = init_axis(start[1], uy, ny, nz)
    cz, sz, tz, dz, end_z = init_axis(start[2], uz, nz, 1)
    cell = cx + cy + cz
    goal = (int(end[0]) * ny + int(end[1])) * nz + int(end[2])
    until = min(length - slack, end_x, end_y, end_z)
    t = 0.0
    own = cell
    while t < until and cell != goal:
        if cell != own and sampled[cell] and log_odds_fixed[cell] >= 0:
            return False
        cell, tx, ty, tz, t = step_voxel(cell, sx, sy, sz, tx, ty, tz, dx, dy, dz)
    return True
