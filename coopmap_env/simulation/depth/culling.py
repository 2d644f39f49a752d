"""Kernels that find the rays of a camera which may meet a body, before any is traced."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

CULL_MARGIN = 1e-5
"""Of a body's size: by how much the cull is generous, since rays are traced in single precision."""


@njit(cache=True, nogil=True)
def bounding_cone(directions, axis):
    """Write the middle of directions (n, 3); return the largest angle to it.

    NaN if a direction is not of length 1.
    """
    axis[:] = 0.0
    unit = True
    for k in range(len(directions)):
        x, y, z = directions[k, 0], directions[k, 1], directions[k, 2]
        unit &= abs(x * x + y * y + z * z - 1.0) < 1e-5
        axis[0] += x
        axis[1] += y
        axis[2] += z
    if not unit:
        return math.nan
    length = math.sqrt(axis[0] ** 2 + axis[1] ** 2 + axis[2] ** 2)
    if length < 1e-9:
        return math.pi
    for i in range(3):
        axis[i] /= length
    lowest = 1.0
    for k in range(len(directions)):
        x, y, z = directions[k, 0], directions[k, 1], directions[k, 2]
        lowest = min(lowest, axis[0] * x + axis[1] * y + axis[2] * z)
    return math.acos(max(lowest, -1.0))


@njit(cache=True, nogil=True)
def rotate_rays(directions, R, origin, origins, rotated):
    """Turn directions (n, 3) by R and let all rays begin at `origin`."""
    for k in range(len(directions)):
        x, y, z = directions[k, 0], directions[k, 1], directions[k, 2]
        for i in range(3):
            origins[k, i] = origin[i]
            rotated[k, i] = R[i, 0] * x + R[i, 1] * y + R[i, 2] * z


@njit(cache=True, nogil=True, inline="always")
def ray_hits_box(ox, oy, oz, ux, uy, uz, hx, hy, hz):
    """Whether a ray from o along u meets the box [-h, h]: no axis or edge stands between them."""
    return not (
        (abs(ox) > hx and ox * ux >= 0.0)
        or (abs(oy) > hy and oy * uy >= 0.0)
        or (abs(oz) > hz and oz * uz >= 0.0)
        or abs(uy * oz - uz * oy) > hy * abs(uz) + hz * abs(uy)
        or abs(uz * ox - ux * oz) > hz * abs(ux) + hx * abs(uz)
        or abs(ux * oy - uy * ox) > hx * abs(uy) + hy * abs(ux)
    )


@njit(cache=True, nogil=True)
def cull_rays(
    directions, axis, cone_angle, R, t, Rs, ts, boxes, visible,
    first, ray_indices, origins, rotated, lengths,
):  # fmt: skip
    """Gather the rays that may meet each body, in the frame of the middle of its box.

    The first n places of `lengths` hold how far each ray goes in the static scene. Rays are
    appended behind: those of body b take places first[b] to first[b + 1], and `ray_indices` says
    which of the n rays each of them is.
    """
    n = len(directions)
    count = n
    c = np.zeros(3)
    o = np.zeros(3)
    M = np.zeros((3, 3))
    for body in range(len(boxes)):
        first[body] = count
        if not visible[body]:
            continue
        center, radius = boxes[body, :3], boxes[body, 6] * (1.0 + CULL_MARGIN)
        hx, hy, hz = boxes[body, 3:6] + radius * CULL_MARGIN
        Rb = Rs[body]
        # camera seen from the middle of the box, and that middle seen from the camera
        for i in range(3):
            o[i] = -center[i]
            for j in range(3):
                o[i] += Rb[j, i] * (t[j] - ts[body, j])
        square = o[0] * o[0] + o[1] * o[1] + o[2] * o[2]
        for i in range(3):
            for j in range(3):
                M[i, j] = Rb[0, i] * R[0, j] + Rb[1, i] * R[1, j] + Rb[2, i] * R[2, j]
        for j in range(3):
            c[j] = -(M[0, j] * o[0] + M[1, j] * o[1] + M[2, j] * o[2])
        distance = math.sqrt(square)
        tangent = square - radius * radius
        if tangent > 0.0:
            along = (c[0] * axis[0] + c[1] * axis[1] + c[2] * axis[2]) / distance
            off_axis = math.acos(min(max(along, -1.0), 1.0))
            if off_axis > cone_angle + math.asin(min(radius / distance, 1.0)) + CULL_MARGIN:
                continue
        for k in range(n):
            x, y, z = directions[k, 0], directions[k, 1], directions[k, 2]
            along = c[0] * x + c[1] * y + c[2] * z
            if tangent > 0.0 and (along <= 0.0 or along * along < tangent):
                continue
            if lengths[k] < distance - radius:
                continue
            ux = M[0, 0] * x + M[0, 1] * y + M[0, 2] * z
            uy = M[1, 0] * x + M[1, 1] * y + M[1, 2] * z
            uz = M[2, 0] * x + M[2, 1] * y + M[2, 2] * z
            if not ray_hits_box(o[0], o[1], o[2], ux, uy, uz, hx, hy, hz):
                continue
            ray_indices[count] = k
            lengths[count] = lengths[k]
            rotated[count, 0], rotated[count, 1], rotated[count, 2] = ux, uy, uz
            origins[count, 0], origins[count, 1], origins[count, 2] = o[0], o[1], o[2]
            count += 1
    first[len(boxes)] = count


@njit(cache=True, nogil=True)
def reduce_nearest(count, ray_indices, lengths, out):
    """Of all that a ray met, the nearest: fills out (n,) from the first `count` lengths."""
    n = len(out)
    for k in range(n):
        out[k] = lengths[k]
    for k in range(n, count):
        out[ray_indices[k]] = min(out[ray_indices[k]], lengths[k])
