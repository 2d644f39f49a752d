"""Which part of the true surface some mount pose could see: what coverage is a share of.

A point can be reached if a camera at some feasible pose has it in its image, between near and far,
with nothing of the scene in between. All poses are stood for by a fixed number of random ones for
each vehicle, uniform over the joints' limits; see `N_POSES`.

A pose is feasible if constraint i holds on a map that knows the truth: the mount's links keep clear
of each truly occupied voxel, of each other, and of the grid's end. The way there is not asked
about, and no robot hides anything or stands in the way, neither the teammates nor the own vehicle.
So there may be more in reach than a team can cover; and what only poses between the drawn ones see
is missing, and is not scored.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from coopmap_env.mapping import OccupancyMap
from coopmap_env.robots import CollisionChecker, CollisionSettings, Vehicle
from coopmap_env.sensing import DepthCamera
from coopmap_env.simulation.depth.traced_mesh import TracedMesh
from coopmap_env.simulation.scenes.field import FieldWorld

N_POSES = 1600
"""Of each vehicle. Two masts see 86, 87, 88, 89, 89 and 90 % of a worksite's surface from 100, 200,
400, 800, 1600 and 3200 poses, and 74, 77, 79, 81, 82 and 83 % of a pile of rubble's."""
MAX_SAMPLING_ROUNDS = 20
"""Poses are drawn this many times as many as asked for before it is settled for fewer."""
RAY_END_MARGIN = 1e-3
"""Metres by which a ray ends before its point, so that the point's own surface does not hide it:
rays are traced in single precision."""


def visible_points(
    world: FieldWorld,
    vehicles: Sequence[Vehicle],
    camera: DepthCamera,
    points: NDArray[np.float64],
    rng: np.random.Generator,
    n_poses: int = N_POSES,
    motion: CollisionSettings | None = None,
) -> NDArray[np.bool_]:
    """Which points (n, 3) of the surface some pose of some vehicle sees, shape (n,)."""
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
    """Random mount poses (k, n) that touch nothing on a map, k = n_poses if there are so many."""
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
    """Mark in `visible` (n,) the points (n, 3) that any camera sees, T_world_camera (k, 3, 3), (k, 3).

    Rays are traced only to points that no camera before has seen.
    """
    n = len(points)
    points = np.ascontiguousarray(points, dtype=np.float64)
    point_index = np.empty(n, dtype=np.int64)
    origins = np.empty((n, 3), dtype=np.float32)
    directions, lengths = np.empty((n, 3), dtype=np.float32), np.empty(n, dtype=np.float32)
    frustum = (
        math.tan(camera.horizontal_field_of_view / 2),
        math.tan(camera.vertical_field_of_view / 2),
        camera.near,
        camera.far,
    )
    for R, t in zip(rotations, translations, strict=True):
        count = rays_to_points(points, visible, R, t, frustum, point_index, directions, lengths)
        origins[:count] = t - scene.center
        traced = lengths[:count].copy()
        scene.intersect(origins[:count], directions[:count], traced)
        visible[point_index[:count][traced == lengths[:count]]] = True


def _ground_truth_map(world: FieldWorld) -> OccupancyMap:
    """The map of somebody who knows it all."""
    ground_truth_map = OccupancyMap(world.grid)
    occupied = world.occupied.ravel()
    ground_truth_map.mark_free(np.flatnonzero(~occupied))
    ground_truth_map.mark_occupied(np.flatnonzero(occupied))
    return ground_truth_map


@njit(cache=True, nogil=True)
def rays_to_points(points, visible, R, t, frustum, point_index, directions, lengths):
    """Rays to the points in a camera's frustum that are not seen yet; returns their number.

    Writes which point each ray goes to, its direction in the world, and its length less `RAY_END_MARGIN`.
    """
    tan_horizontal, tan_vertical, near, far = frustum
    count = 0
    for k in range(len(points)):
        if visible[k]:
            continue
        dx, dy, dz = points[k, 0] - t[0], points[k, 1] - t[1], points[k, 2] - t[2]
        x = R[0, 0] * dx + R[1, 0] * dy + R[2, 0] * dz
        if x <= 0.0 or x > far:
            continue
        y = R[0, 1] * dx + R[1, 1] * dy + R[2, 1] * dz
        z = R[0, 2] * dx + R[1, 2] * dy + R[2, 2] * dz
        if abs(y) > tan_horizontal * x or abs(z) > tan_vertical * x:
            continue
        distance = math.sqrt(dx * dx + dy * dy + dz * dz)
        if not near <= distance <= far:
            continue
        point_index[count] = k
        directions[count, 0] = dx / distance
        directions[count, 1] = dy / distance
        directions[count, 2] = dz / distance
        lengths[count] = max(distance - RAY_END_MARGIN, 0.0)
        count += 1
    return count
