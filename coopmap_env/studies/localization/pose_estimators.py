"""Identifications side by side: Eq. 12, Eq. 13 and rigid solutions over levels of range noise.

Fiducials are drawn in the field of view, and both of their points with the noise of Eq. 1: what
was seen before the motion, from elsewhere, and what is seen after it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.geometry import Pose, displaced, displacement_between, rotation_of_vector
from coopmap_env.localization import (
    consistent,
    gaussian_transform,
    linear_pose,
    recursive_pose,
    rigid_transform,
)
from coopmap_env.sensing import DepthCamera, RangeNoise, rotate_covariances

Array = NDArray[np.float64]

LEVELS = (0.25, 0.5, 1.0, 2.0, 4.0)
"""Times the default noise."""
N_FIDUCIALS = 24
PREDICTED = np.array([0.005, 0.005, 0.005, 0.004, 0.004, 0.004])
"""Standard deviations of the prediction by the mast's encoders: metres, radians."""
MOVED = 0.15
"""Metres by which outliers have moved."""
METHODS = (
    "linear (Eq. 12)",
    "recursive (Eq. 13)",
    "Umeyama",
    "Umeyama, outliers rejected",
    "Gaussian",
    "Gaussian, with the prediction",
)


def compare_identifications(
    rng: np.random.Generator, draws: int, outlier_share: float
) -> dict[str, dict[str, list[float]]]:
    """Median errors of the camera's pose by each method, for each level of noise.

    Parameters
    ----------
    rng : numpy.random.Generator
    draws : int
        Of camera poses and fiducials, the same for all methods.
    outlier_share : float
        Of the fiducials, which have moved by `MOVED`.

    Returns
    -------
    dict
        By method: "position" (metres) and "angle" (radians), a median for each of `LEVELS`, and
        the same of the prediction.
    """
    camera = DepthCamera()
    errors: dict[str, Any] = {name: [] for name in ("prediction", *METHODS)}
    for level in LEVELS:
        noise = RangeNoise(intrinsic=RangeNoise().intrinsic * level)
        here: dict[str, list[Array]] = {name: [] for name in errors}
        for _ in range(draws):
            true, predicted, base, seen, information, deviations = _draw(
                rng, camera, noise, outlier_share
            )
            for name, pose in _poses(predicted, base, seen, information, deviations).items():
                here[name].append(displacement_between(pose, true))
        for name, off in here.items():
            d = np.array(off)
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


def _draw(
    rng: np.random.Generator, camera: DepthCamera, noise: RangeNoise, outlier_share: float
) -> tuple[Pose, Pose, Array, Array, Array, Array]:
    """True and predicted pose, both points, the information of their difference, deviations."""
    true = Pose(rng.normal(size=3), rotation_of_vector(rng.normal(size=3)))
    predicted = displaced(true, PREDICTED * rng.normal(size=6))
    pixels = rng.choice(camera.n_pixels, N_FIDUCIALS, replace=False)
    points = camera.directions[pixels] * rng.uniform(1.5, 5.0, N_FIDUCIALS)[:, None]
    # before the motion the camera stood up to half a metre away, turned by up to half a radian
    before = displaced(true, np.concatenate([rng.uniform(-0.5, 0.5, 3), rng.uniform(-0.5, 0.5, 3)]))
    world = true.transform(points)
    seen, C_seen = _observed(rng, points, true, noise)
    base, C_base = _observed(rng, before.inverse().transform(world), before, noise)
    base = before.transform(base)
    moved = rng.random(N_FIDUCIALS) < outlier_share
    base[moved] += MOVED * rng.normal(size=(int(moved.sum()), 3)) / np.sqrt(3.0)
    both = C_seen + C_base
    deviations: Array = np.sqrt(np.linalg.eigvalsh(both)[:, -1], dtype=np.float64)
    information: Array = np.linalg.inv(both).astype(np.float64, copy=False)
    return true, predicted, base, seen, information, deviations


def _observed(
    rng: np.random.Generator, points: Array, camera: Pose, noise: RangeNoise
) -> tuple[Array, Array]:
    """Points (m, 3) of the camera frame with the noise of Eq. 1; covariances in the world frame."""
    sigmas = noise.standard_deviations(np.linalg.norm(points, axis=1), 3)
    covariances = rotate_covariances(sigmas[:, :, None] ** 2 * np.eye(3), camera.rotation)
    noisy: Array = points + sigmas * rng.normal(size=points.shape)
    return noisy, covariances


def _poses(
    predicted: Pose, base: Array, seen: Array, information: Array, deviations: Array
) -> dict[str, Pose]:
    weights = 1.0 / deviations**2
    kept = consistent(base, seen, deviations)
    prior = np.diag(PREDICTED**2)
    fiducials = base[kept], seen[kept], information[kept]
    return {
        "prediction": predicted,
        METHODS[0]: linear_pose(base, seen),
        METHODS[1]: recursive_pose(base, seen)[0],
        METHODS[2]: rigid_transform(base, seen, weights),
        METHODS[3]: rigid_transform(base[kept], seen[kept], weights[kept]),
        METHODS[4]: gaussian_transform(*fiducials, predicted).estimate.pose,
        METHODS[5]: gaussian_transform(*fiducials, predicted, prior).estimate.pose,
    }
