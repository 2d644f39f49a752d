"""Which camera poses see a given point of the known map: one ray for each pose and point.

A view decides for all voxels at once. For a few points, such as the nearest frontier, a ray from
the camera to each point is exact and costs less.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import kernel
from coopmap_env.geometry import RigidTransform
from coopmap_env.information.field.frustum import Frustum, FrustumGeometry
from coopmap_env.information.field.views import PoseArrays
from coopmap_env.information.ratings import CameraPoses
from coopmap_env.mapping import MapArrays, OccupancyMap, has_line_of_sight


def first_visible_point(
    map_: OccupancyMap,
    points: NDArray[np.float64],
    poses: CameraPoses,
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
        World frame, inside the grid, in the order in which they are tried.
    poses : rotations (k, 3, 3) and translations (k, 3)
        T_world_camera of each pose.
    frustum : Frustum
        On the map's grid.

    Returns
    -------
    first : int
        Index of the point; n if no pose sees any.
    sees_point : ndarray of bool, shape (k,)
    """
    grid = map_.grid
    rotations = np.ascontiguousarray(poses[0], dtype=np.float64)
    cameras = PoseArrays(rotations, grid.to_cell_units(poses[1]))
    sees_point = np.zeros(len(rotations), dtype=np.bool_)
    first = _first_visible_point(
        map_.arrays, grid.to_cell_units(points), cameras, frustum.geometry, sees_point
    )
    return int(first), sees_point


@kernel
def _first_visible_point(
    arrays: MapArrays,
    points: NDArray[np.float64],
    poses: PoseArrays,
    frustum: FrustumGeometry,
    sees_point: NDArray[np.bool_],
) -> int:
    positions = poses.positions
    for n in range(len(points)):
        found = False
        for k in range(len(positions)):
            pose = RigidTransform(poses.rotations[k], positions[k])
            sees_point[k] = _is_in_frustum(points[n], pose, frustum) and has_line_of_sight(
                arrays, positions[k], points[n], 0.0
            )
            found |= sees_point[k]
        if found:
            return n
    return len(points)


@kernel
def _is_in_frustum(
    point: NDArray[np.float64], pose: RigidTransform, frustum: FrustumGeometry
) -> bool:
    """Whether a point lies in the frustum of a pose."""
    R, position, near, far = pose.rotation, pose.translation, frustum.near, frustum.far
    dx, dy, dz = point[0] - position[0], point[1] - position[1], point[2] - position[2]
    x = R[0, 0] * dx + R[1, 0] * dy + R[2, 0] * dz
    y = R[0, 1] * dx + R[1, 1] * dy + R[2, 1] * dz
    z = R[0, 2] * dx + R[1, 2] * dy + R[2, 2] * dz
    square = dx * dx + dy * dy + dz * dz
    inside = x > 0.0 and abs(y) <= frustum.tan_x * x and abs(z) <= frustum.tan_y * x
    return inside and near * near <= square <= far * far
