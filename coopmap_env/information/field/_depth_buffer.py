"""The depth buffer of a view: the depth that each pixel sees on the known map.

Occluders are sampled voxels with P >= 1/2, and the spheres that cover the other robots; unknown
voxels let the view pass. The voxel that holds the camera hides nothing.

Most rays meet nothing. No ray is followed beyond the bounding box of all occluding voxels, which
halves the length of all rays. Finding the box costs as much as it saves in four views.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import inlined_kernel, kernel
from coopmap_env.geometry import RigidTransform, start_ray, step_ray
from coopmap_env.information.field.frustum import FrustumGeometry
from coopmap_env.mapping import MapArrays

DEPTH_TOLERANCE = math.sqrt(3.0) / 2.0
"""Cells by which the center of a visible voxel may lie behind the surface that a pixel saw: half
the diagonal of a voxel, so that an occluder's own voxels count as seen whichever way it faces."""
BOX_MARGIN = 1e-6
"""Cells by which the box of the occluders is larger than they are: distances carry rounding
errors of 1e-13."""


class CameraArrays(NamedTuple):
    """A depth camera on one grid, as kernels take it."""

    frustum: FrustumGeometry
    directions: NDArray[np.float64]
    """Unit vectors (width height, 3) through the pixels of the depth buffer, camera frame."""
    max_runs: int
    """Largest number of runs of a view."""


class SphereArrays(NamedTuple):
    """Spheres in cells of a grid: centers (s, 3) and radii (s,)."""

    centers: NDArray[np.float64]
    radii: NDArray[np.float64]


@kernel
def occluder_bounds(arrays: MapArrays, box: NDArray[np.float64]) -> None:
    """Write the lower and the upper corner (2, 3) of a box that holds all occluding voxels.

    Without any the lower corner lies above the upper one, and every ray is outside at once.
    """
    log_odds_fixed, sampled, (nx, ny, nz) = arrays.log_odds_fixed, arrays.sampled_mask, arrays.shape
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


@kernel
def is_outside(shape: tuple[int, int, int], position: NDArray[np.float64]) -> bool:
    """Whether a position is in no cell of the grid; such a camera sees nothing."""
    inside = 0
    for axis in range(3):
        inside += 0.0 <= position[axis] < shape[axis]
    return inside < 3


@inlined_kernel
def _exit_distance(position: float, direction: float, low: float, high: float) -> float:
    """Distance at which a ray leaves the space between two planes of an axis for good."""
    if direction > 0.0:
        return (high - position) / direction
    if direction < 0.0:
        return (low - position) / direction
    return math.inf


@kernel
def _first_occluder(
    arrays: MapArrays,
    box: NDArray[np.float64],
    position: NDArray[np.float64],
    ux: float,
    uy: float,
    uz: float,
    far: float,
) -> float:
    """Distance at which a ray enters the first occluding voxel, or infinity."""
    log_odds_fixed, sampled = arrays.log_odds_fixed, arrays.sampled_mask
    ray, at = start_ray(position, (ux, uy, uz), arrays.shape)
    end = min(far, ray.end)
    end = min(end, _exit_distance(position[0], ux, box[0, 0], box[1, 0]))
    end = min(end, _exit_distance(position[1], uy, box[0, 1], box[1, 1]))
    end = min(end, _exit_distance(position[2], uz, box[0, 2], box[1, 2]))
    while True:
        at = step_ray(ray, at)
        if at.distance >= end:
            return math.inf
        index = np.uint64(at.cell)
        if log_odds_fixed[index] >= 0:  # noqa: SIM102 - nested is faster
            if sampled[index]:
                return at.distance


@kernel
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


@kernel
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


@kernel
def depth_limits(
    arrays: MapArrays,
    box: NDArray[np.float64],
    pose: RigidTransform,
    camera: CameraArrays,
    spheres: SphereArrays,
    distances: NDArray[np.float64],
    limits: NDArray[np.float64],
) -> None:
    """Write the depth X down to which each pixel sees, tolerance included.

    `box` (2, 3) contains all occluding voxels; `distances` (width height,) is scratch. `limits`
    ((width + 1)(height + 1),) has one more row and column, copies of the last: a voxel on the very
    border of the image needs no case of its own.
    """
    R, directions = pose.rotation, camera.directions
    far, w, h = camera.frustum.far, camera.frustum.width, camera.frustum.height
    for p in range(w * h):
        x, y, z = directions[p, 0], directions[p, 1], directions[p, 2]
        distances[p] = _first_occluder(
            arrays, box, pose.translation,
            R[0, 0] * x + R[0, 1] * y + R[0, 2] * z,
            R[1, 0] * x + R[1, 1] * y + R[1, 2] * z,
            R[2, 0] * x + R[2, 1] * y + R[2, 2] * z, far,
        )  # fmt: skip
    add_spheres(pose, camera.frustum, directions, spheres, distances)
    for u in range(w + 1):
        for v in range(h + 1):
            p = min(u, w - 1) * h + min(v, h - 1)
            limits[u * (h + 1) + v] = (distances[p] + DEPTH_TOLERANCE) * directions[p, 0]
