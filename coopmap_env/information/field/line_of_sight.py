"""Which camera poses see a given point of the known map: one ray for each question.

A view answers for all voxels at once; where only a few points are asked about, such as the nearest
frontier, a ray from the camera to the point is exact and costs less.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from coopmap_env.information.field.frustum import Frustum
from coopmap_env.mapping import OccupancyMap
from coopmap_env.mapping.line_of_sight import has_line_of_sight


def first_visible_point(
    map_: OccupancyMap,
    points: NDArray[np.float64],
    rotations: NDArray[np.float64],
    translations: NDArray[np.float64],
    frustum: Frustum,
) -> tuple[int, NDArray[np.bool_]]:
    """The first of some points that any pose sees, and which poses see it.

    A pose sees a point in its field of view, between near and far, if no occupied voxel (sampled,
    P >= 1/2) lies between the camera's own voxel and the point's.

    Parameters
    ----------
    map_ : OccupancyMap
        3-D.
    points : ndarray, shape (n, 3)
        World frame, inside the grid, in the order in which they are asked about.
    rotations, translations : ndarray, shape (k, 3, 3), (k, 3)
        T_world_camera of each pose.
    frustum : Frustum
        On the map's grid.

    Returns
    -------
    first : int
        Index of the point; n if no pose sees any.
    seeing : ndarray of bool, shape (k,)
    """
    grid = map_.grid
    sees_point = np.zeros(len(translations), dtype=np.bool_)
    first = _first_visible_point(
        map_.log_odds_fixed, map_.sampled_mask, grid.shape, grid.to_cell_units(points),
        np.ascontiguousarray(rotations), grid.to_cell_units(translations), frustum.projection, sees_point,
    )  # fmt: skip
    return int(first), sees_point


@njit(cache=True, nogil=True)
def _first_visible_point(
    log_odds_fixed, sampled, shape, points, rotations, positions, projection, sees_point
):
    for n in range(len(points)):
        found = False
        for k in range(len(positions)):
            sees_point[k] = _is_in_frustum(
                points[n], rotations[k], positions[k], projection
            ) and has_line_of_sight(log_odds_fixed, sampled, shape, positions[k], points[n], 0.0)
            found |= sees_point[k]
        if found:
            return n
    return len(points)


@njit(cache=True, nogil=True)
def _is_in_frustum(point, R, position, projection):
    """Whether a point lies in the frustum."""
    a, b, near, far = projection[0], projection[1], projection[2], projection[3]
    dx, dy, dz = point[0] - position[0], point[1] - position[1], point[2] - position[2]
    x = R[0, 0] * dx + R[1, 0] * dy + R[2, 0] * dz
    y = R[0, 1] * dx + R[1, 1] * dy + R[2, 1] * dz
    z = R[0, 2] * dx + R[1, 2] * dy + R[2, 2] * dz
    square = dx * dx + dy * dy + dz * dz
    inside = x > 0.0 and abs(y) <= a * x and abs(z) <= b * x
    return inside and near * near <= square <= far * far
