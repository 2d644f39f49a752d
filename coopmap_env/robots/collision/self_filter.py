"""Robots know where they are: what a camera sees of them is no part of the scene."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from coopmap_env.geometry.transforms import Pose
from coopmap_env.sensing.noise import RangeNoise
from coopmap_env.sensing.point_cloud import PointCloud

ANGLE_TOLERANCE = 1e-6
"""Radians by which a sphere counts as in sight that is not, for rounding's sake."""


def filter_robot_points(
    cloud: PointCloud,
    T_world_camera: Pose,
    centers: ArrayLike,
    radii: ArrayLike,
    noise: RangeNoise,
    pose_covariance: NDArray[np.float64] | None = None,
) -> PointCloud:
    """A look from which the robots are taken: hits on them become beams that are clear up to them.

    A hit is a robot's if it lies in one of its spheres, grown by three standard deviations of the
    range there (Eq. 1) and of where the camera takes the point to be. Its beam then says that all
    is free up to where it enters the first of the spheres that it crosses. Spheres in which the
    camera is itself count for hits inside of them only, from which it learns nothing.

    Parameters
    ----------
    cloud : PointCloud
        n beams in the camera frame.
    T_world_camera : Pose
        Where the robot believes that its camera stands.
    centers : array_like, shape (s, 3)
        Spheres that cover the robots, its own too, in the world frame.
    radii : array_like, shape (s,)
    noise : RangeNoise
        What the camera states of its uncertainty.
    pose_covariance : ndarray, shape (6, 6), optional
        Of the camera's pose, [translation, rotation vector].

    Raises
    ------
    ValueError
        If the spheres' shapes disagree.
    """
    at, wide = np.asarray(centers, dtype=np.float64), np.asarray(radii, dtype=np.float64)
    if at.ndim != 2 or at.shape[1] != 3 or wide.shape != (len(at),):
        raise ValueError(
            f"spheres need centres (s, 3) and radii (s,), got {at.shape}, {wide.shape}"
        )
    local = np.ascontiguousarray(T_world_camera.inverse().transform(at))
    points, hit = cloud.points.copy(), cloud.hit.copy()
    pose = np.zeros((6, 6)) if pose_covariance is None else pose_covariance
    uncertainty = (
        float(noise.intrinsic * noise.depth), float(noise.exponent),
        float(np.trace(pose[:3, :3])), float(np.trace(pose[3:, 3:])),
    )  # fmt: skip
    filter_points_in_spheres(points, hit, local, np.ascontiguousarray(wide), uncertainty)
    return PointCloud(points, hit)


@njit(cache=True, nogil=True)
def _three_sigma(distance, uncertainty):
    """Metres by which spheres grow there."""
    factor, exponent, translation, rotation = uncertainty
    power = distance * distance if exponent == 2.0 else distance**exponent
    along = factor * power
    return 3.0 * np.sqrt(along * along + translation + rotation * distance * distance)


@njit(cache=True, nogil=True)
def _spheres_in_view(points, hit, centers, radii, uncertainty, kept):
    """Write the numbers of the spheres that a hit may lie in, or its beam cross; how many.

    All hits lie in a cone about the optical axis, no further than the farthest of them. Most of the
    robots stands elsewhere: of the 48 spheres of two masts 6 are left on average.
    """
    lowest, farthest = 1.0, 0.0
    for k in range(len(points)):
        if hit[k]:
            x, y, z = points[k, 0], points[k, 1], points[k, 2]
            distance = np.sqrt(x * x + y * y + z * z)
            if distance > 0.0:
                lowest = min(lowest, x / distance)
                farthest = max(farthest, distance)
    spread_angle = np.arccos(max(lowest, -1.0))
    inflation = _three_sigma(farthest, uncertainty)
    count = 0
    for s in range(len(radii)):
        x, y, z = centers[s, 0], centers[s, 1], centers[s, 2]
        distance, radius = np.sqrt(x * x + y * y + z * z), radii[s] + inflation
        if distance > radius:
            off_axis = np.arccos(min(max(x / distance, -1.0), 1.0))
            if off_axis > spread_angle + np.arcsin(radius / distance) + ANGLE_TOLERANCE:
                continue
            if distance - radius > farthest:
                continue
        kept[count] = s
        count += 1
    return count


@njit(cache=True, nogil=True)
def filter_points_in_spheres(points, hit, centers, radii, uncertainty):
    """`filter_robot_points` in the camera frame, in place; `uncertainty` is (S * T_depth, n) of Eq. 1."""
    kept = np.empty(len(radii), np.int64)
    n_kept = _spheres_in_view(points, hit, centers, radii, uncertainty, kept)
    if n_kept == 0:
        return
    for k in range(len(points)):
        if not hit[k]:
            continue
        x, y, z = points[k, 0], points[k, 1], points[k, 2]
        distance = np.sqrt(x * x + y * y + z * z)
        if distance == 0.0:
            continue
        inflation = _three_sigma(distance, uncertainty)
        on_robot = False
        entry = distance
        for s in kept[:n_kept]:
            cx, cy, cz = centers[s, 0], centers[s, 1], centers[s, 2]
            along = (cx * x + cy * y + cz * z) / distance
            aside = cx * cx + cy * cy + cz * cz - along * along
            radius = radii[s] + inflation
            if aside >= radius * radius:
                continue
            half = np.sqrt(radius * radius - aside)
            holds_hit = along - half < distance < along + half
            on_robot |= holds_hit
            if holds_hit or along - half > 0.0:
                entry = min(entry, along - half)
        if on_robot:
            hit[k] = False
            fraction = max(entry, 0.0) / distance
            for i in range(3):
                points[k, i] *= fraction
