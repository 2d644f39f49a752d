"""Comparison of pose estimators: Eq. 12, Eq. 13 and rigid solutions at levels of range noise.

Fiducials are drawn in the field of view. Each has two points with the noise of Eq. 1: one measured
before the motion from an earlier pose, and one measured after it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.geometry import (
    Pose,
    apply_displacement,
    displacement_between,
    rotation_from_rotvec,
)
from coopmap_env.localization import (
    consistent_subset,
    gaussian_pose,
    linear_pose,
    recursive_pose,
    rigid_pose,
)
from coopmap_env.sensing import DepthCamera, RangeNoise, rotate_covariances

Array = NDArray[np.float64]

NOISE_FACTORS = (0.25, 0.5, 1.0, 2.0, 4.0)
"""Factors of the default noise."""
N_FIDUCIALS = 24
PREDICTION_STD = np.array([0.005, 0.005, 0.005, 0.004, 0.004, 0.004])
"""Standard deviations of the prediction from the mast's encoders: metres, radians."""
OUTLIER_STD = 0.15
"""Standard deviation of the displacement of outliers, metres."""
ESTIMATORS = (
    "linear (Eq. 12)",
    "recursive (Eq. 13)",
    "Umeyama",
    "Umeyama, outliers rejected",
    "Gaussian",
    "Gaussian, with the prediction",
)


def compare_pose_estimators(
    rng: np.random.Generator, n_draws: int, outlier_fraction: float
) -> dict[str, dict[str, list[float]]]:
    """Median errors of the camera pose by each estimator, for each level of noise.

    Parameters
    ----------
    rng : numpy.random.Generator
    draws : int
        Number of random camera poses and fiducials, the same for all estimators.
    outlier_fraction : float
        Fraction of fiducials that moved, by `OUTLIER_STD`.

    Returns
    -------
    dict
        By estimator, and for the prediction: "position" (metres) and "angle" (radians), one median
        for each of `NOISE_FACTORS`.
    """
    camera = DepthCamera()
    errors: dict[str, Any] = {name: [] for name in ("prediction", *ESTIMATORS)}
    for noise_factor in NOISE_FACTORS:
        noise = RangeNoise(intrinsic=RangeNoise().intrinsic * noise_factor)
        pose_errors: dict[str, list[Array]] = {name: [] for name in errors}
        for _ in range(n_draws):
            true, predicted, world_points, camera_points, information, sigmas = _sample_problem(
                rng, camera, noise, outlier_fraction
            )
            for name, pose in _estimate_poses(
                predicted, world_points, camera_points, information, sigmas
            ).items():
                pose_errors[name].append(displacement_between(pose, true))
        for name, displacements in pose_errors.items():
            d = np.array(displacements)
            errors[name].append(
                [
                    float(np.median(np.linalg.norm(d[:, :3], axis=1))),
                    float(np.median(np.linalg.norm(d[:, 3:], axis=1))),
                ]
            )
    return {
        name: {"position": [p for p, _ in rows], "angle": [a for _, a in rows]}
        for name, rows in errors.items()
    }


def _sample_problem(
    rng: np.random.Generator, camera: DepthCamera, noise: RangeNoise, outlier_fraction: float
) -> tuple[Pose, Pose, Array, Array, Array, Array]:
    """True and predicted pose, both points, information and largest sigma of their difference."""
    true = Pose(rng.normal(size=3), rotation_from_rotvec(rng.normal(size=3)))
    predicted = apply_displacement(true, PREDICTION_STD * rng.normal(size=6))
    pixels = rng.choice(camera.n_pixels, N_FIDUCIALS, replace=False)
    points = camera.directions[pixels] * rng.uniform(1.5, 5.0, N_FIDUCIALS)[:, None]
    # the earlier pose differs by up to half a metre and half a radian along each axis
    earlier_camera = apply_displacement(
        true, np.concatenate([rng.uniform(-0.5, 0.5, 3), rng.uniform(-0.5, 0.5, 3)])
    )
    world = true.transform(points)
    camera_points, C_camera = _add_noise(rng, points, true, noise)
    world_points, C_world = _add_noise(
        rng, earlier_camera.inverse().transform(world), earlier_camera, noise
    )
    world_points = earlier_camera.transform(world_points)
    is_outlier = rng.random(N_FIDUCIALS) < outlier_fraction
    world_points[is_outlier] += (
        OUTLIER_STD * rng.normal(size=(int(is_outlier.sum()), 3)) / np.sqrt(3.0)
    )
    difference_covariances = C_camera + C_world
    sigmas: Array = np.sqrt(np.linalg.eigvalsh(difference_covariances)[:, -1], dtype=np.float64)
    information: Array = np.linalg.inv(difference_covariances).astype(np.float64, copy=False)
    return true, predicted, world_points, camera_points, information, sigmas


def _add_noise(
    rng: np.random.Generator, points: Array, camera: Pose, noise: RangeNoise
) -> tuple[Array, Array]:
    """Points (m, 3) in the camera frame with the noise of Eq. 1; covariances in the world frame."""
    sigmas = noise.standard_deviations(np.linalg.norm(points, axis=1), 3)
    covariances = rotate_covariances(sigmas[:, :, None] ** 2 * np.eye(3), camera.rotation)
    noisy: Array = points + sigmas * rng.normal(size=points.shape)
    return noisy, covariances


def _estimate_poses(
    predicted: Pose, world_points: Array, camera_points: Array, information: Array, sigmas: Array
) -> dict[str, Pose]:
    weights = 1.0 / sigmas**2
    inliers = consistent_subset(world_points, camera_points, sigmas)
    prior = np.diag(PREDICTION_STD**2)
    fiducials = world_points[inliers], camera_points[inliers], information[inliers]
    return {
        "prediction": predicted,
        ESTIMATORS[0]: linear_pose(world_points, camera_points),
        ESTIMATORS[1]: recursive_pose(world_points, camera_points)[0],
        ESTIMATORS[2]: rigid_pose(world_points, camera_points, weights),
        ESTIMATORS[3]: rigid_pose(world_points[inliers], camera_points[inliers], weights[inliers]),
        ESTIMATORS[4]: gaussian_pose(*fiducials, predicted).estimate.pose,
        ESTIMATORS[5]: gaussian_pose(*fiducials, predicted, prior).estimate.pose,
    }
