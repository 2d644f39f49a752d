"""Kernels that select the rays of a camera that may meet a body, before any ray is traced."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import PlainTuple, inlined_kernel, kernel
from coopmap_env.geometry import RigidTransform

CULL_MARGIN = 1e-5
"""Fraction of a body's size by which the selection is too large, as rays are traced in single
precision."""


class Rays(NamedTuple):
    """Rays to trace. The first n belong to the n pixels and go through the static scene."""

    origins: NDArray[np.float32]
    """Shape (m, 3), relative to the middle of the mesh that the ray goes through."""
    directions: NDArray[np.float32]
    """Shape (m, 3), of length 1."""
    lengths: NDArray[np.float32]
    """Shape (m,): metres to the first surface."""
    pixels: NDArray[np.int32]
    """Shape (m,): of which pixel each is a ray; not set for the first n."""


class BodyBoxes(NamedTuple):
    """Boxes around bodies, in the frames of the bodies."""

    centers: NDArray[np.float64]
    """Shape (b, 3)."""
    half_sizes: NDArray[np.float64]
    """Shape (b, 3)."""
    radii: NDArray[np.float64]
    """Shape (b,): of the balls about the centers that hold the bodies."""


class ViewCone(NamedTuple):
    """A cone about the rays of a camera, in the camera frame."""

    axis: NDArray[np.float64]
    """Shape (3,), of length 1."""
    angle: float
    """Radians between the axis and the outermost ray."""


@kernel
def bounding_cone(directions: NDArray[np.float64], axis: NDArray[np.float64]) -> float:
    """Write the axis (3,) of the cone about directions (n, 3); its angle, radians.

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


@kernel
def rotate_rays(
    directions: NDArray[np.float64],
    camera_pose: PlainTuple,
    center: NDArray[np.float64],
    origins: NDArray[np.float32],
    rotated: NDArray[np.float32],
    lengths: NDArray[np.float32],
) -> None:
    """Fill the first n rays: directions (n, 3) of a camera, relative to `center` (3,), endless.

    The pose is a plain `RigidTransform`.
    """
    R, t = camera_pose
    xx, xy, xz, yx, yy, yz = R[0, 0], R[0, 1], R[0, 2], R[1, 0], R[1, 1], R[1, 2]
    zx, zy, zz = R[2, 0], R[2, 1], R[2, 2]
    ox, oy, oz = t[0] - center[0], t[1] - center[1], t[2] - center[2]
    for k in range(len(directions)):
        x, y, z = directions[k, 0], directions[k, 1], directions[k, 2]
        origins[k, 0], origins[k, 1], origins[k, 2] = ox, oy, oz
        rotated[k, 0] = xx * x + xy * y + xz * z
        rotated[k, 1] = yx * x + yy * y + yz * z
        rotated[k, 2] = zx * x + zy * y + zz * z
        lengths[k] = math.inf


@kernel
def is_in_cone(center: NDArray[np.float64], distance: float, radius: float, cone: ViewCone) -> bool:
    """Whether a ball, its center (3,) in the camera frame, may reach into a cone."""
    axis = cone.axis
    along = (center[0] * axis[0] + center[1] * axis[1] + center[2] * axis[2]) / distance
    off_axis = math.acos(min(max(along, -1.0), 1.0))
    return not off_axis > cone.angle + math.asin(min(radius / distance, 1.0)) + CULL_MARGIN


@inlined_kernel
def ray_hits_box(
    o: NDArray[np.float64], ux: float, uy: float, uz: float, h: NDArray[np.float64]
) -> bool:
    """Whether a ray from o (3,) along u meets the box [-h, h]: no separating axis (3 and 3)."""
    ox, oy, oz = o[0], o[1], o[2]
    hx, hy, hz = h[0], h[1], h[2]
    return not (
        (abs(ox) > hx and ox * ux >= 0.0)
        or (abs(oy) > hy and oy * uy >= 0.0)
        or (abs(oz) > hz and oz * uz >= 0.0)
        or abs(uy * oz - uz * oy) > hy * abs(uz) + hz * abs(uy)
        or abs(uz * ox - ux * oz) > hz * abs(ux) + hx * abs(uz)
        or abs(ux * oy - uy * ox) > hx * abs(uy) + hy * abs(ux)
    )


@kernel
def camera_in_box(
    T_world_camera: RigidTransform,
    R: NDArray[np.float64],
    t: NDArray[np.float64],
    center: NDArray[np.float64],
    out: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]],
) -> float:
    """Write where a camera and the middle of a body's box see each other; squared distance.

    `R`, `t` are the body's pose in the world, `center` (3,) is the middle of its box in its own
    frame. `out` receives the camera's position (3,) and rotation (3, 3) relative to that middle,
    and the middle's position (3,) in the camera frame.
    """
    o, M, c = out
    for i in range(3):
        o[i] = -center[i]
        for j in range(3):
            o[i] += R[j, i] * (T_world_camera.translation[j] - t[j])
    square = o[0] * o[0] + o[1] * o[1] + o[2] * o[2]
    for i in range(3):
        for j in range(3):
            M[i, j] = (
                R[0, i] * T_world_camera.rotation[0, j]
                + R[1, i] * T_world_camera.rotation[1, j]
                + R[2, i] * T_world_camera.rotation[2, j]
            )
    for j in range(3):
        c[j] = -(M[0, j] * o[0] + M[1, j] * o[1] + M[2, j] * o[2])
    return square


@kernel
def cull_rays(
    directions: NDArray[np.float64],
    view_cone: PlainTuple,
    camera_pose: PlainTuple,
    body_poses: PlainTuple,
    body_boxes: PlainTuple,
    visible: NDArray[np.bool_],
    starts: NDArray[np.int64],
    ray_buffers: PlainTuple,
) -> None:
    """Append the rays that may hit each body, in the frame of the middle of its box.

    `view_cone` is a plain `ViewCone`, `camera_pose` a plain `RigidTransform`, as is `body_poses`
    with rotations (b, 3, 3) and translations (b, 3), `body_boxes` a plain `BodyBoxes`, and
    `ray_buffers` a plain `Rays`, whose first n lengths say how far each ray goes in the static
    scene. The rays of body b take places starts[b] to starts[b + 1].
    """
    n = len(directions)
    cone, boxes, rays = ViewCone(*view_cone), BodyBoxes(*body_boxes), Rays(*ray_buffers)
    T_world_camera, T_world_bodies = RigidTransform(*camera_pose), RigidTransform(*body_poses)
    lengths = rays.lengths
    count = n
    o, M, c = np.zeros(3), np.zeros((3, 3)), np.zeros(3)
    h = np.zeros(3)
    for body in range(len(visible)):
        starts[body] = count
        if not visible[body]:
            continue
        radius = boxes.radii[body] * (1.0 + CULL_MARGIN)
        for i in range(3):
            h[i] = boxes.half_sizes[body, i] + radius * CULL_MARGIN
        R, t = T_world_bodies.rotation[body], T_world_bodies.translation[body]
        square = camera_in_box(T_world_camera, R, t, boxes.centers[body], (o, M, c))
        distance = math.sqrt(square)
        tangent = square - radius * radius
        if tangent > 0.0 and not is_in_cone(c, distance, radius, cone):
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
            if not ray_hits_box(o, ux, uy, uz, h):
                continue
            rays.pixels[count] = k
            lengths[count] = lengths[k]
            for i in range(3):
                rays.origins[count, i] = o[i]
            rays.directions[count, 0] = ux
            rays.directions[count, 1] = uy
            rays.directions[count, 2] = uz
            count += 1
    starts[len(visible)] = count


@kernel
def nearest_hits(
    count: int,
    lengths: NDArray[np.float32],
    pixels: NDArray[np.int32],
    out: NDArray[np.float64],
) -> None:
    """Fill out (n,) with the nearest hit of every pixel among the first `count` rays."""
    n = len(out)
    for k in range(n):
        out[k] = lengths[k]
    for k in range(n, count):
        out[pixels[k]] = min(out[pixels[k]], lengths[k])
