"""The part of the true surface that some mount pose can see: the reference of coverage.

A point is visible if a camera at some feasible pose has it in its image, between near and far range
and without an occluder. A fixed number of random poses of each vehicle, uniform within the joint
limits, stands for all poses; see `N_POSES`.

A pose is feasible if it is free of collisions on a map of the true occupancy: the
links keep clear of each occupied voxel, of each other, and of the grid's border. Whether a
collision-free path leads to the pose is not checked. Robots, the own one included, neither occlude
nor obstruct. So a team may be unable to cover all visible points. Points that only poses between
the drawn ones can see are not scored.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import kernel
from coopmap_env.geometry import RigidTransform
from coopmap_env.mapping import OccupancyMap
from coopmap_env.robots import CollisionChecker, CollisionSettings, Vehicle
from coopmap_env.sensing import DepthCamera
from coopmap_env.simulation.depth import TracedMesh
from coopmap_env.simulation.scenes.field import FieldWorld

N_POSES = 1600
"""Poses of each vehicle. Two masts see 86, 87, 88, 89, 89 and 90 % of a worksite's surface from
100, 200, 400, 800, 1600 and 3200 poses, and 74, 77, 79, 81, 82 and 83 % of a pile of rubble's."""
MAX_SAMPLING_ROUNDS = 20
"""Times that `n_poses` poses are drawn before fewer collision-free ones are accepted."""
RAY_END_MARGIN = 1e-3
"""Metres by which a ray ends before its point, so that the point's own surface does not occlude it:
rays are traced in single precision."""


class ViewFrustum(NamedTuple):
    """What a camera can see, for kernels."""

    tan_x: float
    """Tangent of half the horizontal field of view."""
    tan_y: float
    """Tangent of half the vertical field of view."""
    near: float
    """Least range, metres."""
    far: float
    """Greatest range, metres."""


class PointRays(NamedTuple):
    """Rays from one camera to points, with room for n of them."""

    point_index: NDArray[np.int64]
    """The point of each ray (n,)."""
    directions: NDArray[np.float32]
    """Unit vectors (n, 3), world frame."""
    lengths: NDArray[np.float32]
    """Metres (n,)."""


def visible_points(
    world: FieldWorld,
    vehicles: Sequence[Vehicle],
    camera: DepthCamera,
    points: NDArray[np.float64],
    rng: np.random.Generator,
    n_poses: int = N_POSES,
    motion: CollisionSettings | None = None,
) -> NDArray[np.bool_]:
    """Which points (n, 3) of the surface some pose of some vehicle can see, shape (n,)."""
    scene = TracedMesh(world.triangles)
    ground_truth_map = _ground_truth_map(world)
    visible = np.zeros(len(points), dtype=np.bool_)
    for vehicle in vehicles:
        poses = sample_collision_free_poses(vehicle, ground_truth_map, rng, n_poses, motion)
        mark_visible_points(*vehicle.camera_poses(poses), camera, scene, points, visible)
    return visible


def sample_collision_free_poses(
    vehicle: Vehicle,
    ground_truth_map: OccupancyMap,
    rng: np.random.Generator,
    n_poses: int,
    motion: CollisionSettings | None = None,
) -> NDArray[np.float64]:
    """Random collision-free mount poses (k, n) on a map; k = n_poses if that many are found.

    Raises
    ------
    ValueError
        If `n_poses` is less than 1.
    """
    if n_poses < 1:
        raise ValueError(f"n_poses must be at least 1, got {n_poses}")
    chain = vehicle.chain
    lower = np.maximum(chain.lower, -math.pi)  # a joint without limits turns once around
    upper = np.minimum(chain.upper, math.pi)
    checker = CollisionChecker(vehicle, ground_truth_map, settings=motion)
    found: list[NDArray[np.float64]] = []
    for _ in range(MAX_SAMPLING_ROUNDS):
        poses = rng.uniform(lower, upper, (n_poses, len(lower)))
        found.append(poses[checker.are_poses_free(poses)])
        if sum(map(len, found)) >= n_poses:
            break
    return np.concatenate(found)[:n_poses]


def mark_visible_points(
    rotations: NDArray[np.float64],
    translations: NDArray[np.float64],
    camera: DepthCamera,
    scene: TracedMesh,
    points: NDArray[np.float64],
    visible: NDArray[np.bool_],
) -> None:
    """Mark the points that any of the cameras sees; rays go only to points not seen before.

    Parameters
    ----------
    rotations, translations : ndarray, shapes (k, 3, 3) and (k, 3)
        T_world_camera.
    camera : DepthCamera
    scene : TracedMesh
        The occluders.
    points : ndarray, shape (n, 3)
        Metres, world frame.
    visible : ndarray of bool, shape (n,)
        Set to true in place.
    """
    n = len(points)
    points = np.ascontiguousarray(points, dtype=np.float64)
    rays = PointRays(
        np.empty(n, dtype=np.int64), np.empty((n, 3), np.float32), np.empty(n, np.float32)
    )
    origins = np.empty((n, 3), dtype=np.float32)
    intrinsics = camera.intrinsics
    frustum = ViewFrustum(intrinsics.tan_x, intrinsics.tan_y, camera.near, camera.far)
    for R, t in zip(rotations, translations, strict=True):
        count = rays_to_points(points, visible, RigidTransform(R, t), frustum, rays)
        origins[:count] = t - scene.center
        traced = rays.lengths[:count].copy()
        scene.intersect(origins[:count], rays.directions[:count], traced)
        visible[rays.point_index[:count][traced == rays.lengths[:count]]] = True


def _ground_truth_map(world: FieldWorld) -> OccupancyMap:
    """A map of the true occupancy of every voxel."""
    ground_truth_map = OccupancyMap(world.grid)
    occupied = world.occupied.ravel()
    ground_truth_map.mark_free(np.flatnonzero(~occupied))
    ground_truth_map.mark_occupied(np.flatnonzero(occupied))
    return ground_truth_map


@kernel
def rays_to_points(
    points: NDArray[np.float64],
    visible: NDArray[np.bool_],
    T_world_camera: RigidTransform,
    frustum: ViewFrustum,
    rays: PointRays,
) -> int:
    """Write rays to the points in the frustum that are not visible yet; return their number.

    Each ray ends `RAY_END_MARGIN` before its point.
    """
    R, t = T_world_camera.rotation, T_world_camera.translation
    count = 0
    for k in range(len(points)):
        if visible[k]:
            continue
        dx, dy, dz = points[k, 0] - t[0], points[k, 1] - t[1], points[k, 2] - t[2]
        x = R[0, 0] * dx + R[1, 0] * dy + R[2, 0] * dz
        if x <= 0.0 or x > frustum.far:
            continue
        y = R[0, 1] * dx + R[1, 1] * dy + R[2, 1] * dz
        z = R[0, 2] * dx + R[1, 2] * dy + R[2, 2] * dz
        if abs(y) > frustum.tan_x * x or abs(z) > frustum.tan_y * x:
            continue
        distance = math.sqrt(dx * dx + dy * dy + dz * dz)
        if not frustum.near <= distance <= frustum.far:
            continue
        rays.point_index[count] = k
        rays.directions[count, 0] = dx / distance
        rays.directions[count, 1] = dy / distance
        rays.directions[count, 2] = dz / distance
        rays.lengths[count] = max(distance - RAY_END_MARGIN, 0.0)
        count += 1
    return count
