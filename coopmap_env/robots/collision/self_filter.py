"""Robots know their own poses: the points that a camera measures on them are not mapped."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.elementary import power
from coopmap_env.core.kernels import PlainTuple, borrowing_kernel, kernel
from coopmap_env.core.linear_algebra import total
from coopmap_env.geometry import Pose
from coopmap_env.sensing import PointCloud, RangeNoise

ANGLE_TOLERANCE = 1e-6
"""Radians by which the view cone is widened, against rounding."""


class PointUncertainty(NamedTuple):
    """Standard deviation of a measured point by its distance: Eq. 1 and the camera's pose."""

    factor: float
    """S * T_depth of Eq. 1."""
    exponent: float
    """n of Eq. 1."""
    translation: float
    """Trace of the covariance of the camera's position, m^2."""
    rotation: float
    """Trace of the covariance of the camera's rotation vector, rad^2."""


def filter_robot_points(
    cloud: PointCloud,
    T_world_camera: Pose,
    centers: ArrayLike,
    radii: ArrayLike,
    noise: RangeNoise,
    pose_covariance: NDArray[np.float64] | None = None,
) -> PointCloud:
    """A point cloud without the robots: hits on them become free beams that end in front of them.

    A hit is a robot's if it lies in one of its spheres, inflated by three standard deviations of
    the range there (Eq. 1) and of the point's position due to the camera's pose. Its beam then is
    free up to where it enters the first of the spheres that it crosses. A sphere that contains the
    camera only counts for hits inside of it, and nothing is learned from them.

    Parameters
    ----------
    cloud : PointCloud
        n beams in the camera frame.
    T_world_camera : Pose
        Estimated pose of the camera.
    centers : array_like, shape (s, 3)
        Spheres that cover the robots, its own too, in the world frame.
    radii : array_like, shape (s,)
    noise : RangeNoise
        Range noise of the camera's specification.
    pose_covariance : ndarray, shape (6, 6), optional
        Of the camera's pose, [translation, rotation vector].

    Raises
    ------
    ValueError
        If the spheres' shapes disagree, or the pose is planar.
    """
    at, wide = np.asarray(centers, dtype=np.float64), np.asarray(radii, dtype=np.float64)
    if at.ndim != 2 or at.shape[1] != 3 or wide.shape != (len(at),):
        raise ValueError(
            f"spheres need centers (s, 3) and radii (s,), got {at.shape}, {wide.shape}"
        )
    points, hit = cloud.points.copy(), cloud.hit.copy()
    covariance = np.zeros((6, 6)) if pose_covariance is None else pose_covariance
    uncertainty = PointUncertainty(
        float(noise.intrinsic * noise.depth),
        float(noise.exponent),
        total(covariance.diagonal()[:3].tolist()),
        total(covariance.diagonal()[3:].tolist()),
    )
    filter_points_in_spheres(
        points,
        hit,
        tuple(T_world_camera.spatial_arrays),
        np.ascontiguousarray(at),
        np.ascontiguousarray(wide),
        tuple(uncertainty),
    )
    return PointCloud(points, hit)


@borrowing_kernel
def _to_camera_frame(
    plain_camera: PlainTuple, points: NDArray[np.float64], out: NDArray[np.float64]
) -> None:
    """Write points (s, 3) of the world in the frame of a camera, a plain `RigidTransform`."""
    R, t = plain_camera
    for i in range(3):
        origin = -(t[0] * R[0, i] + t[1] * R[1, i] + t[2] * R[2, i])
        for s in range(len(points)):
            x, y, z = points[s, 0], points[s, 1], points[s, 2]
            out[s, i] = x * R[0, i] + y * R[1, i] + z * R[2, i] + origin


@kernel
def _three_sigma(distance: float, uncertainty: PointUncertainty) -> float:
    """Metres by which spheres are inflated at a distance from the camera."""
    factor, exponent, translation, rotation = uncertainty
    along = factor * power(distance, exponent)
    return 3.0 * np.sqrt(along * along + translation + rotation * distance * distance)


@kernel
def _spheres_in_view(
    points: NDArray[np.float64],
    hit: NDArray[np.bool_],
    centers: NDArray[np.float64],
    radii: NDArray[np.float64],
    uncertainty: PointUncertainty,
    kept: NDArray[np.int64],
) -> int:
    """Write the indices of the spheres that a hit may lie in or its beam cross; return how many.

    All hits lie in a cone about the optical axis, no further than the farthest of them. Most
    spheres lie outside: of the 48 of two masts 6 are left on average.
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


@kernel
def filter_points_in_spheres(
    points: NDArray[np.float64],
    hit: NDArray[np.bool_],
    plain_camera: PlainTuple,
    world_centers: NDArray[np.float64],
    radii: NDArray[np.float64],
    plain_uncertainty: PlainTuple,
) -> None:
    """`filter_robot_points` in place, with a plain `RigidTransform` and `PointUncertainty`."""
    uncertainty = PointUncertainty(*plain_uncertainty)
    centers = np.empty(world_centers.shape)
    _to_camera_frame(plain_camera, world_centers, centers)
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
