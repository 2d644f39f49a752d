"""Questions about solids: what a ray hits first, and how far solids are from a vertical axis."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.kernels import kernel
from coopmap_env.simulation.scenes.field.solid import Solid


def first_hit(
    eye: NDArray[np.float64], points: NDArray[np.float64], solids: Sequence[Solid]
) -> NDArray[np.int64]:
    """Index of the solid that each ray from `eye` (3,) through `points` (n, 3) hits first.

    A ray goes on behind its point; -1 where it hits nothing.
    """
    starts = np.cumsum([0, *(len(solid.faces) for solid in solids)])
    triangles = np.concatenate([solid.triangles for solid in solids])
    bounds = np.array([solid.bounds for solid in solids])
    centers = bounds.mean(axis=1)
    radii = 0.5 * np.linalg.norm(bounds[:, 1] - bounds[:, 0], axis=1)
    rays = points - eye
    rays = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    hits = np.empty(len(points), dtype=np.int64)
    cast_rays(eye, rays, triangles, starts, centers, radii, hits)
    return hits


@kernel
def cast_rays(
    eye: NDArray[np.float64],
    rays: NDArray[np.float64],
    triangles: NDArray[np.float64],
    starts: NDArray[np.int64],
    centers: NDArray[np.float64],
    radii: NDArray[np.float64],
    hits: NDArray[np.int64],
) -> None:
    """Write the first solid along each ray (n, 3), of length 1; those off its line are skipped.

    Solid s has the triangles `starts[s]` to `starts[s + 1]` and lies in a ball.
    """
    for n in range(len(rays)):
        ux, uy, uz = rays[n, 0], rays[n, 1], rays[n, 2]
        nearest, hits[n] = np.inf, -1
        for s in range(len(centers)):
            px, py, pz = centers[s, 0] - eye[0], centers[s, 1] - eye[1], centers[s, 2] - eye[2]
            along = px * ux + py * uy + pz * uz
            aside = px * px + py * py + pz * pz - along * along
            if aside > radii[s] * radii[s] or not -radii[s] < along < nearest + radii[s]:
                continue
            for m in range(starts[s], starts[s + 1]):
                distance = ray_triangle_distance(eye, ux, uy, uz, triangles[m])
                if distance < nearest:
                    nearest, hits[n] = distance, s


@kernel
def ray_triangle_distance(
    eye: NDArray[np.float64], ux: float, uy: float, uz: float, triangle: NDArray[np.float64]
) -> float:
    """Distance along a ray to a triangle (3, 3), infinite if it misses (Moeller-Trumbore)."""
    ax, bx = triangle[1, 0] - triangle[0, 0], triangle[2, 0] - triangle[0, 0]
    ay, by = triangle[1, 1] - triangle[0, 1], triangle[2, 1] - triangle[0, 1]
    az, bz = triangle[1, 2] - triangle[0, 2], triangle[2, 2] - triangle[0, 2]
    px, py, pz = uy * bz - uz * by, uz * bx - ux * bz, ux * by - uy * bx
    determinant = ax * px + ay * py + az * pz
    if abs(determinant) < 1e-12:
        return np.inf
    sx, sy, sz = eye[0] - triangle[0, 0], eye[1] - triangle[0, 1], eye[2] - triangle[0, 2]
    a = (sx * px + sy * py + sz * pz) / determinant
    qx, qy, qz = sy * az - sz * ay, sz * ax - sx * az, sx * ay - sy * ax
    b = (ux * qx + uy * qy + uz * qz) / determinant
    distance = (bx * qx + by * qy + bz * qz) / determinant
    if a < 0.0 or b < 0.0 or a + b > 1.0 or distance <= 0.0:
        return np.inf
    return distance


def project_to_ground(solids: Sequence[Solid]) -> NDArray[np.float64]:
    """Triangles (m, 3, 2) of all solids but the ground, as seen from above."""
    projected = [solid.triangles[:, :, :2] for solid in solids if not solid.is_ground]
    return np.concatenate([np.zeros((0, 3, 2)), *projected])


def distance_to_axis(point: ArrayLike, solids: Sequence[Solid]) -> float:
    """Horizontal distance in metres from a vertical axis at (x, y) to the nearest solid.

    0 if the axis passes through one, infinite if there is none; ground does not count.
    """
    x, y = np.asarray(point, dtype=np.float64)[:2]
    return float(distance_to_triangles(x, y, project_to_ground(solids)))


@kernel
def distance_to_triangles(x: float, y: float, triangles: NDArray[np.float64]) -> float:
    """Distance from (x, y) to triangles (m, 3, 2) in the plane, 0 inside of one."""
    nearest = math.inf
    for m in range(len(triangles)):
        left, right = True, True
        for k in range(3):
            after = (k + 1) % 3
            ex = triangles[m, after, 0] - triangles[m, k, 0]
            ey = triangles[m, after, 1] - triangles[m, k, 1]
            px, py = x - triangles[m, k, 0], y - triangles[m, k, 1]
            length = ex * ex + ey * ey
            fraction = 0.0  # a vertical edge is a point
            if length > 0.0:
                fraction = min(max((ex * px + ey * py) / length, 0.0), 1.0)
            nearest = min(nearest, (px - fraction * ex) ** 2 + (py - fraction * ey) ** 2)
            side = ex * py - ey * px
            left, right = left and side > 0.0, right and side < 0.0
        if left or right:
            return 0.0
    return math.sqrt(nearest)
