"""The depth buffer of a view: the depth that each pixel sees on the known map.

Occluders are sampled voxels with P >= 1/2, and the spheres that cover the other robots; unknown
voxels let the view pass. The voxel that holds the camera hides nothing.

Few voxels of a view occlude it, and most pixels meet nothing. So it is not the rays that are
followed through the map: each occluder shortens the rays of the few pixels that it covers.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import borrowing_kernel, inlined_kernel, unchecked_division_kernel
from coopmap_env.geometry import RigidTransform
from coopmap_env.information.field._near_occluders import (
    BATCH,
    TOLERANCE,
    keep_touched,
    list_bits,
    touched_columns,
)
from coopmap_env.information.field.frustum import FrustumGeometry, LinearForm, linear_forms
from coopmap_env.mapping.occluders import ViewedMap

DEPTH_TOLERANCE = math.sqrt(3.0) / 2.0
"""Cells by which the center of a visible voxel may lie behind the surface that a pixel saw: half
the diagonal of a voxel, so that an occluder's own voxels count as seen whichever way it faces."""
NEARLY_ZERO = 1e-300
"""Stands for a component of a direction that is zero."""


class CameraArrays(NamedTuple):
    """A depth camera on one grid, as kernels take it."""

    frustum: FrustumGeometry
    directions: NDArray[np.float64]
    """Unit vectors (width height, 3) through the pixels of the depth buffer, camera frame."""
    max_runs: int
    """Largest number of runs of a view."""
    max_row: int
    """Largest number of voxels that a frustum touches in one layer across x, a word more."""


class DepthBuffer(NamedTuple):
    """Scratch of the depth buffer of one view, and its result."""

    cells: NDArray[np.int32]
    """Occluding voxels, flat indices (`BATCH` + max_row,)."""
    reciprocals: NDArray[np.float64]
    """One over the components of each pixel's direction in the world (3, width height)."""
    distances: NDArray[np.float64]
    """Distance to the first occluder along the ray of each pixel (width height,)."""
    limits: NDArray[np.float64]
    """Depth X down to which each pixel sees ((width + 1) (height + 1),); one more row and column
    are copies of the last: a voxel on the very border of the image needs no case of its own."""
    stride: int
    """Limits of one column of pixels."""


class SphereArrays(NamedTuple):
    """Spheres in cells of a grid: centers (s, 3) and radii (s,)."""

    centers: NDArray[np.float64]
    radii: NDArray[np.float64]


@borrowing_kernel
def is_outside(shape: tuple[int, int, int], position: NDArray[np.float64]) -> bool:
    """Whether a position is in no cell of the grid; such a camera sees nothing."""
    inside = 0
    for axis in range(3):
        inside += 0.0 <= position[axis] < shape[axis]
    return inside < 3


@unchecked_division_kernel
def write_reciprocals(
    rotation: NDArray[np.float64], directions: NDArray[np.float64], out: NDArray[np.float64]
) -> None:
    """Write one over each component, in the world, of the directions (k, 3) of the rays, (3, k)."""
    R, nearly_zero = rotation, NEARLY_ZERO
    for p in range(len(directions)):
        x, y, z = directions[p, 0], directions[p, 1], directions[p, 2]
        ux = R[0, 0] * x + R[0, 1] * y + R[0, 2] * z
        uy = R[1, 0] * x + R[1, 1] * y + R[1, 2] * z
        uz = R[2, 0] * x + R[2, 1] * y + R[2, 2] * z
        out[0, p] = 1.0 / (ux if ux != 0.0 else nearly_zero)
        out[1, p] = 1.0 / (uy if uy != 0.0 else nearly_zero)
        out[2, p] = 1.0 / (uz if uz != 0.0 else nearly_zero)


@inlined_kernel
def _covered_pixels(
    pixel: float, form: LinearForm, depth_form: LinearForm, half_per_depth: float, n: int
) -> tuple[int, int]:
    """First and last pixel, along one image axis, whose rays may meet a voxel in front.

    `pixel` is where its center appears and `half_per_depth` half a cell over the least depth. A
    pixel is the quotient of two linear forms of the position: at a distance from the center, it
    differs by that of the forms' difference, over the depth there.
    """
    a = abs(form[0] - pixel * depth_form[0])
    b = abs(form[1] - pixel * depth_form[1])
    c = abs(form[2] - pixel * depth_form[2])
    half = (a + b + c) * half_per_depth + TOLERANCE
    first = max(0.0, np.ceil(pixel - half - 0.5))
    return int(first), int(min(n - 1.0, np.floor(pixel + half - 0.5)))


@unchecked_division_kernel
def add_voxels(
    cells: NDArray[np.int32],
    n: int,
    shape: tuple[int, int, int],
    pose: RigidTransform,
    forms: tuple[LinearForm, LinearForm, LinearForm],
    frustum: FrustumGeometry,
    reciprocals: NDArray[np.float64],
    distances: NDArray[np.float64],
) -> None:
    """Shorten the distances (width height,) along rays that enter one of n voxels.

    A ray is inside a voxel where it is between the faces across all three axes.
    """
    px, py, pz = pose.translation[0], pose.translation[1], pose.translation[2]
    far, w, h = frustum.far, frustum.width, frustum.height
    ny, nz = np.uint32(shape[1]), np.uint32(shape[2])
    own = (math.floor(px) * shape[1] + math.floor(py)) * shape[2] + math.floor(pz)
    (x0, x1, x2), (u0, u1, u2), (v0, v1, v2) = forms
    half_depth = 0.5 * (abs(x0) + abs(x1) + abs(x2))
    for m in range(n):
        if cells[m] == own:
            continue
        cell = np.uint32(cells[m])
        column = cell // nz
        row = column // ny
        lx, ly, lz = row - px, np.int64(column - row * ny) - py, np.int64(cell - column * nz) - pz
        dx, dy, dz = lx + 0.5, ly + 0.5, lz + 0.5
        X = x0 * dx + x1 * dy + x2 * dz
        first_u, last_u, first_v, last_v = 0, w - 1, 0, h - 1
        if X - half_depth > TOLERANCE:  # all of it is in front of the camera
            inverse, half_per_depth = 1.0 / X, 0.5 / (X - half_depth)
            u = (u0 * dx + u1 * dy + u2 * dz) * inverse
            v = (v0 * dx + v1 * dy + v2 * dz) * inverse
            first_u, last_u = _covered_pixels(u, forms[1], forms[0], half_per_depth, w)
            first_v, last_v = _covered_pixels(v, forms[2], forms[0], half_per_depth, h)
        u_pixel, v_pixel = first_u, first_v
        for _ in range(max(last_u - first_u + 1, 0) * max(last_v - first_v + 1, 0)):
            p = np.uint64(u_pixel * h + v_pixel)
            ix, iy, iz = reciprocals[0, p], reciprocals[1, p], reciprocals[2, p]
            ax, bx = lx * ix, (lx + 1.0) * ix
            ay, by = ly * iy, (ly + 1.0) * iy
            az, bz = lz * iz, (lz + 1.0) * iz
            entry = max(min(ax, bx), max(min(ay, by), min(az, bz)))
            exit_ = min(max(ax, bx), min(max(ay, by), max(az, bz)))
            is_met = (entry < exit_) & (entry >= 0.0) & (entry < far)
            distances[p] = min(distances[p], entry if is_met else math.inf)
            v_pixel += 1
            column_ends = v_pixel > last_v
            u_pixel += column_ends
            v_pixel = first_v if column_ends else v_pixel


@borrowing_kernel
def _pixel_span(
    center: float, radius: float, depth: float, tangent: float, n: int
) -> tuple[int, int]:
    """First and last pixel, along one image axis, that a sphere in front may cover."""
    low, high = center - radius, center + radius
    low /= depth + radius if low > 0.0 else depth - radius
    high /= depth - radius if high > 0.0 else depth + radius
    half = 0.5 * n
    # half a pixel of tolerance: only the rays through the centers of pixels count
    first = max(0.0, math.floor(half * (1.0 + low / tangent) - 0.5))
    last = min(n - 1.0, math.ceil(half * (1.0 + high / tangent) - 0.5))
    return int(first), int(last)


@borrowing_kernel
def add_spheres(
    pose: RigidTransform,
    frustum: FrustumGeometry,
    directions: NDArray[np.float64],
    spheres: SphereArrays,
    distances: NDArray[np.float64],
) -> None:
    """Shorten the distances (width height,) along rays that meet a sphere."""
    R, position = pose.rotation, pose.translation
    far, w, h = frustum.far, frustum.width, frustum.height
    for s in range(len(spheres.radii)):
        dx = spheres.centers[s, 0] - position[0]
        dy = spheres.centers[s, 1] - position[1]
        dz = spheres.centers[s, 2] - position[2]
        r = spheres.radii[s]
        d2 = dx * dx + dy * dy + dz * dz
        x = R[0, 0] * dx + R[1, 0] * dy + R[2, 0] * dz
        # around the camera, behind it, or too far
        if d2 <= r * r or x <= -r or d2 >= (far + r) * (far + r):
            continue
        y = R[0, 1] * dx + R[1, 1] * dy + R[2, 1] * dz
        z = R[0, 2] * dx + R[1, 2] * dy + R[2, 2] * dz
        u0, u1, v0, v1 = 0, w - 1, 0, h - 1
        if x > r:
            u0, u1 = _pixel_span(y, r, x, frustum.tan_x, w)
            v0, v1 = _pixel_span(z, r, x, frustum.tan_y, h)
        for u in range(u0, u1 + 1):
            for v in range(v0, v1 + 1):
                p = u * h + v
                along = directions[p, 0] * x + directions[p, 1] * y + directions[p, 2] * z
                inside = along * along - (d2 - r * r)
                if along > 0.0 and inside >= 0.0:
                    distances[p] = min(distances[p], along - math.sqrt(inside))


@borrowing_kernel
def _add_near_voxels(
    viewed: ViewedMap,
    pose: RigidTransform,
    rows: NDArray[np.float64],
    camera: CameraArrays,
    buffer: DepthBuffer,
) -> None:
    """Shorten the distances along rays that meet an occluding voxel."""
    shape, frustum, cells = viewed.arrays.shape, camera.frustum, buffer.cells
    (_, ny, nz), forms = shape, linear_forms(rows)
    write_reciprocals(pose.rotation, camera.directions, buffer.reciprocals)
    box = touched_columns(shape, pose, frustum)
    if box.first_y > box.last_y:
        return
    n = 0
    for i in range(box.first_x, box.last_x + 1):
        first, end = (i * ny + box.first_y) * nz, (i * ny + box.last_y + 1) * nz
        n = list_bits(viewed.occluders, first, end, cells, n)
        if n >= BATCH or i == box.last_x:
            n = keep_touched(cells, n, shape, pose.translation, forms, frustum)
            add_voxels(
                cells, n, shape, pose, forms, frustum, buffer.reciprocals, buffer.distances
            )  # fmt: skip
            n = 0


@borrowing_kernel
def depth_limits(
    viewed: ViewedMap,
    pose: RigidTransform,
    rows: NDArray[np.float64],
    camera: CameraArrays,
    spheres: SphereArrays,
    buffer: DepthBuffer,
) -> None:
    """Write the depth X down to which each pixel sees, tolerance included; see `DepthBuffer`."""
    directions, distances, limits = camera.directions, buffer.distances, buffer.limits
    w, h = camera.frustum.width, camera.frustum.height
    for p in range(w * h):
        distances[p] = math.inf
    _add_near_voxels(viewed, pose, rows, camera, buffer)
    add_spheres(pose, camera.frustum, directions, spheres, distances)
    for u in range(w + 1):
        for v in range(h + 1):
            p = min(u, w - 1) * h + min(v, h - 1)
            limits[u * buffer.stride + v] = (distances[p] + DEPTH_TOLERANCE) * directions[p, 0]
