"""Pixel by pixel: what a look says of a hypothesis, and in which direction it pulls it.

The images that a camera would see of the target tells for every pixel which of the target's planes
is there (projective association, Blais & Levine 1995), so a measured point has one plane to lie on:

    r = n . (T p - q),    sigma^2 = n^T R diag(sigma_depth^2, sigma_lateral^2, ...) R^T n

with the range noise of Eq. 1. Its derivative by a displacement [dt, dw] of the base in the target's
frame is [n, (T p - t) x n].
"""

from __future__ import annotations

import numpy as np
from numba import njit

AGREES, OCCLUDED, SEEN_THROUGH, UNDECIDED = 1, 2, 3, 0
"""A pixel where the target is expected sees it there, sees something in front of it, sees through
it, or tells none of these: it lies at an edge, for instance."""


@njit(cache=True, nogil=True)
def pixel_residuals(
    points, hit, ranges, min_ranges, expected, triangle_index, normals, plane_points, R_camera, t_camera, R, t,
    noise, sigma_floor, gate_sigmas, depth_margin, max_range_residual, verdict, H, b, patches, origin, patch_size,
):  # fmt: skip
    """Fill the verdict (n,) of each pixel where the target is expected; add to H (6, 6), b (6,).

    Patches of the target that a pixel agrees on are marked too.

    Parameters
    ----------
    points, hit, ranges, around
        One look, see `ViewBatch`.
    expected, seen : (n,)
        What `render_depth` fills.
    normals, corners : (m, 3)
        Planes of the triangles in the target's frame: a normal and a corner each.
    R_camera, t_camera, R, t
        T_base_camera and T_target_base.
    noise : (S, T depth, T lateral, n)
        Of Eq. 1.
    floor : float
        Metres added to sigma in square: what association and the pose still lack.
    gate : float
        Sigmas within which a point agrees with its plane.
    margin : float
        Metres by which a range must differ to be in front of the surface, or beyond it.
    jump : float
        Metres along the beam within which a point can agree.
    patches : (nx, ny, nz)
        Cells of the target's box, from `origin` (3,) on and `patch_size` metres wide.

    Returns
    -------
    chi2 : float
        Sum of squares of the residuals of pixels that agree, over their variances.
    """
    intrinsic, depth_factor, lateral_factor, exponent = noise
    J = np.empty(6)
    p = np.empty(3)
    d = np.empty(3)
    axis = np.empty(3)
    chi2 = 0.0
    for i in range(3):
        axis[i] = R[i, 0] * R_camera[0, 0] + R[i, 1] * R_camera[1, 0] + R[i, 2] * R_camera[2, 0]
    for k in range(len(points)):
        verdict[k] = UNDECIDED
        m = triangle_index[k]
        if m < 0:
            continue
        if ranges[k] == 0.0:
            verdict[k] = OCCLUDED
            continue
        for i in range(3):
            d[i] = (
                R_camera[i, 0] * points[k, 0]
                + R_camera[i, 1] * points[k, 1]
                + R_camera[i, 2] * points[k, 2]
                + t_camera[i]
            )
        r = 0.0
        along = 0.0
        for i in range(3):
            p[i] = R[i, 0] * d[0] + R[i, 1] * d[1] + R[i, 2] * d[2]  # T p - t
            r += normals[m, i] * (p[i] + t[i] - plane_points[m, i])
            along += normals[m, i] * axis[i]
        # points lie on their beams: range and depth grow alike
        surface = expected[k] * ranges[k] / points[k, 0]
        scale = intrinsic * ranges[k] ** exponent
        variance = scale * scale * (
            lateral_factor * lateral_factor
            + along * along * (depth_factor * depth_factor - lateral_factor * lateral_factor)
        )  # fmt: skip
        variance += sigma_floor * sigma_floor
        if (
            hit[k]
            and abs(ranges[k] - surface) < max_range_residual
            and r * r < gate_sigmas * gate_sigmas * variance
        ):
            verdict[k] = AGREES
            chi2 += r * r / variance
            for i in range(3):
                J[i] = normals[m, i]
            J[3] = p[1] * normals[m, 2] - p[2] * normals[m, 1]
            J[4] = p[2] * normals[m, 0] - p[0] * normals[m, 2]
            J[5] = p[0] * normals[m, 1] - p[1] * normals[m, 0]
            # where the beam meets the surface, not where noise puts the point
            fraction = surface / ranges[k]
            cell = [0, 0, 0]
            for i in range(3):
                camera_position = (
                    R[i, 0] * t_camera[0] + R[i, 1] * t_camera[1] + R[i, 2] * t_camera[2] + t[i]
                )
                at = camera_position + fraction * (p[i] + t[i] - camera_position) - origin[i]
                cell[i] = min(max(int(at / patch_size), 0), patches.shape[i] - 1)
            patches[cell[0], cell[1], cell[2]] = True
            for i in range(6):
                b[i] -= J[i] * r / variance
                for j in range(6):
                    H[i, j] += J[i] * J[j] / variance
            continue
        tolerance = depth_margin + 3.0 * intrinsic * depth_factor * surface**exponent
        if ranges[k] < surface - tolerance or (not hit[k] and ranges[k] < surface + tolerance):
            verdict[k] = OCCLUDED  # or the beam was not followed as far
        elif min_ranges[k] > surface + tolerance:
            verdict[k] = SEEN_THROUGH
    return chi2


@njit(cache=True, nogil=True)
def count_off_surface(
    points, hit, R_camera, t_camera, R, t, surface_distances, origin, cell, low, high, noise, tolerance
):  # fmt: skip
    """How many points of a look lie in the target's box, but not on it.

    `surface_distances` (nx, ny, nz) are distances to the surface in cells from `origin` that hold the box from
    `low` to `high` (3,). A point is on the target within a tolerance and three sigma of Eq. 1.
    """
    intrinsic, depth_factor, _, exponent = noise
    d = np.empty(3)
    q = np.empty(3)
    count = 0
    for k in range(len(points)):
        if not hit[k]:
            continue
        for i in range(3):
            d[i] = (
                R_camera[i, 0] * points[k, 0]
                + R_camera[i, 1] * points[k, 1]
                + R_camera[i, 2] * points[k, 2]
                + t_camera[i]
            )
        inside = True
        for i in range(3):
            q[i] = R[i, 0] * d[0] + R[i, 1] * d[1] + R[i, 2] * d[2] + t[i]
            inside = inside and low[i] < q[i] < high[i]
        if not inside:
            continue
        x = int((q[0] - origin[0]) / cell)
        y = int((q[1] - origin[1]) / cell)
        z = int((q[2] - origin[2]) / cell)
        square = points[k, 0] ** 2 + points[k, 1] ** 2 + points[k, 2] ** 2
        if surface_distances[x, y, z] > tolerance + 3.0 * intrinsic * depth_factor * square ** (
            0.5 * exponent
        ):
            count += 1
    return count
