"""What a straight look meets first, among solids."""

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from coopmap_env.simulation.scenes.field.solid import Solid


def first_hit(
    eye: NDArray[np.float64], points: NDArray[np.float64], solids: Sequence[Solid]
) -> NDArray[np.int64]:
    """Index of the solid that each look from `eye` (3,) towards `points` (n, 3) meets first.

    A look goes on behind its point; -1 where it meets nothing.
    """
    starts = np.cumsum([0, *(len(solid.faces) for solid in solids)])
    triangles = np.concatenate([solid.triangles for solid in solids])
    bounds = np.array([solid.bounds for solid in solids])
    centres = bounds.mean(axis=1)
    radii = 0.5 * np.linalg.norm(bounds[:, 1] - bounds[:, 0], axis=1)
    rays = points - eye
    rays = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    hits = np.empty(len(points), dtype=np.int64)
    cast_rays(eye, rays, triangles, starts, centres, radii, hits)
    return hits


@njit(cache=True, nogil=True)
def cast_rays(eye, rays, triangles, starts, centres, radii, hits):
    """Write the first solid along each look (n, 3), of length 1; those off its line are skipped.

    Solid s has the triangles `starts[s]` to `starts[s + 1]` and lies in a ball.
    """
    for n in range(len(rays)):
        ux, uy, uz = rays[n, 0], rays[n, 1], rays[n, 2]
        nearest, hits[n] = np.inf, -1
        for s in range(len(centres)):
            px, py, pz = centres[s, 0] - eye[0], centres[s, 1] - eye[1], centres[s, 2] - eye[2]
            along = px * ux + py * uy + pz * uz
            aside = px * px + py * py + pz * pz - along * along
            if aside > radii[s] * radii[s] or not -radii[s] < along < nearest + radii[s]:
                continue
            for m in range(starts[s], starts[s + 1]):
                distance = ray_triangle_distance(eye, ux, uy, uz, triangles[m])
                if distance < nearest:
                    nearest, hits[n] = distance, s


@njit(cache=True, nogil=True)
def ray_triangle_distance(eye, ux, uy, uz, triangle):
    """Distance along a look to a triangle (3, 3), infinite if it misses (Moeller-Trumbore)."""
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
