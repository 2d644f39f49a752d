"""A hypothesis brought to where all looks agree best, and what the looks then say of it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.geometry import rotation_about_z
from coopmap_env.geometry.rotations import apply_displacement, displacement_between
from coopmap_env.geometry.transforms import Pose
from coopmap_env.localization.depth_rendering import render_depth
from coopmap_env.localization.registration.likelihood_field import distance_field
from coopmap_env.localization.registration.pixel_residuals import (
    AGREES,
    OCCLUDED,
    SEEN_THROUGH,
    UNDECIDED,
    count_off_surface,
    pixel_residuals,
)
from coopmap_env.localization.registration.shared_pose import (
    camera_to_base_covariances,
    shared_pose,
)
from coopmap_env.localization.registration.views import ViewBatch
from coopmap_env.localization.target import TargetModel
from coopmap_env.sensing.noise import RangeNoise

Array = NDArray[np.float64]

RESIDUAL_GATE = 3.0
"""Sigmas within which a point lies on its plane."""
MAX_RANGE_RESIDUAL = 0.3
"""Metres along a beam within which it can do so: a slanted plane is far ahead of a point that is
near to it."""
_SIGMA_FLOORS = (0.1, 0.06, 0.03, 0.015, 0.008)
"""Metres that are added to sigma while planes are still to be found; the last one for the rest."""
ITERATIONS = 8
"""As many rounds as floors, and three for the rest."""
FINAL_SIGMA_FLOOR = 0.003
"""Metres: what is left of the model's and the arithmetic's error."""
_MAX_STEP = 1.0
"""Metres and radians of a step: a start is never so far off."""
_DISTANCE_CELL, _DISTANCE_PADDING = 0.05, 0.2
_PATCH_SIZE = 0.1
"""Metres: side of the patches that tell how much of the target is seen."""
_WEAK_PRIOR = np.diag([1e-2, 1e-2, 1e-2, 1.0, 1.0, 1.0])
"""Information beforehand where nothing is known: standard deviations of 10 m and 1 rad."""


@dataclass(frozen=True)
class AlignmentSettings:
    """What is known of cameras and ground when the pose is refined.

    Raises
    ------
    ValueError
        With the value, if one is out of range.
    """

    level_ground: bool = True
    """The base stands as level as the target, at the same height: flat ground."""
    level_std: tuple[float, float] = (0.005, math.radians(0.1))
    """Metres of height and radians of roll and pitch by which it may not."""
    common_error_fraction: float = 0.7
    """Of the camera pose's variance, what is alike in all looks and does not average out. Of a
    joint's it is 0.15^2 / (0.15^2 + 0.1^2) = 0.69 with the calibration and encoders of mounts
    (`Mount`); what a suspension adds is new with each posture, so this errs on the safe side."""
    depth_margin: float = 0.08
    """Metres beyond three sigma by which a surface must lie behind or in front of a point for the
    pixel to say so: 0.45 degrees at 5 m, and 4 cm for the pixel's own width on a slanted face."""

    def __post_init__(self) -> None:
        if not (len(self.level_std) == 2 and all(0 < s < math.inf for s in self.level_std)):
            raise ValueError(f"AlignmentSettings.level_std must be > 0, got {self.level_std}")
        if not 0 <= self.common_error_fraction <= 1:
            raise ValueError(
                f"AlignmentSettings.common_error_fraction must lie in [0, 1], got {self.common_error_fraction}"
            )
        if not 0 <= self.depth_margin < math.inf:
            raise ValueError(
                f"AlignmentSettings.depth_margin must be >= 0, got {self.depth_margin}"
            )


class PixelCounts(NamedTuple):
    """What the pixels of all looks say of a pose."""

    agreeing: int
    """See the target where it should be."""
    occluded: int
    """See something in front of it."""
    seen_through: int
    """See through it."""
    undecided: int
    """Are to see the target and say none of these."""
    off_surface: int
    """Points within the target's box that do not lie on the target."""


class Alignment(NamedTuple):
    """A pose, how sure it is, and what was counted there."""

    T_target_base: Pose
    covariance: Array
    """(6, 6) of the base's displacement in the target's frame."""
    counts: PixelCounts
    chi2: float
    """Mean square of the agreeing pixels' residuals over their variances."""
    H: Array
    """Information (v, 6, 6) of each look about where it sees the base."""
    g: Array
    """H times the displacement (v, 6) at which each look sees it."""
    pose_covariances: Array
    """Covariances (v, 6, 6) of the cameras' poses, as displacements of the base."""
    verdicts_by_view: NDArray[np.int64]
    """(v, 4): how many pixels of each look have which verdict of `fit_pixels`."""
    area: float
    """Square metres of the target that points lie on: patches of a square decimetre."""


def align(
    model: TargetModel, batch: ViewBatch, start: Pose, noise: RangeNoise, settings: AlignmentSettings,
    iterations: int = ITERATIONS,
) -> Alignment:  # fmt: skip
    """Gauss-Newton over the base's pose and the errors of all looks' camera poses.

    Each round draws what the cameras would see (`render_depth`), has every pixel say what it pulls
    towards (`pixel_residuals`), and solves for all errors at once (`shared_pose`).

    Parameters
    ----------
    model : TargetModel
    looks : ViewBatch
    start : Pose
        T_target_base, right to about 0.2 m and 5 degrees.
    noise : RangeNoise
        Eq. 1.
    settings : AlignmentSettings
    rounds : int
        At least 1.
    """
    T, errors = start, np.zeros((len(batch), 6))
    for k in range(iterations):
        sigma_floor = _SIGMA_FLOORS[k] if k < len(_SIGMA_FLOORS) else FINAL_SIGMA_FLOOR
        verdicts_by_view, area, chi2, H, b = _evaluate_views(
            model, batch, T, errors, noise, sigma_floor, settings
        )
        pose_covariances = camera_to_base_covariances(batch.covariances, batch.t, T.rotation)
        agreeing = verdicts_by_view[:, AGREES]
        weights = agreeing / max(agreeing.sum(), 1)
        common = settings.common_error_fraction * np.einsum("v,vij->ij", weights, pose_covariances)
        independent = (1.0 - settings.common_error_fraction) * pose_covariances
        P, Px = _prior(T, settings)
        g = b + np.einsum("vij,vj->vi", H, errors)
        estimate = shared_pose(H, g, independent, common, P, Px)
        step = estimate.x
        if not np.abs(step).max() < _MAX_STEP:
            # nothing holds it: what was counted on the way is no evidence
            verdicts_by_view[:] = 0
            break
        T, errors = apply_displacement(T, step), estimate.errors
        g = g - np.einsum("vij,j->vi", H, step)
    total = verdicts_by_view.sum(axis=0).tolist()
    counts = PixelCounts(
        total[AGREES], total[OCCLUDED], total[SEEN_THROUGH], total[UNDECIDED],
        _count_off_surface(model, batch, T, errors, noise, settings.depth_margin),
    )  # fmt: skip
    return Alignment(
        T,
        estimate.covariance,
        counts,
        chi2 / max(counts.agreeing, 1),
        H,
        g,
        pose_covariances,
        verdicts_by_view,
        area,
    )


def nearest_upright(pose: Pose) -> Pose:
    """The pose on the ground, upright, that is nearest: its x, y and yaw."""
    yaw = math.atan2(
        pose.rotation[1, 0] - pose.rotation[0, 1], pose.rotation[0, 0] + pose.rotation[1, 1]
    )
    return Pose(pose.translation * [1.0, 1.0, 0.0], rotation_about_z(yaw))


def _prior(T: Pose, settings: AlignmentSettings) -> tuple[Array, Array]:
    """Information (6, 6) of what is known beforehand, and times its displacement (6,) from T."""
    P = _WEAK_PRIOR
    if settings.level_ground:
        height, tilt = (1.0 / s**2 for s in settings.level_std)
        P = P + np.diag([0.0, 0.0, height, tilt, tilt, 0.0])
    return P, P @ displacement_between(T, nearest_upright(T)) * [0.0, 0.0, 1.0, 1.0, 1.0, 0.0]


def _evaluate_views(
    model: TargetModel, batch: ViewBatch, T: Pose, errors: Array, noise: RangeNoise, sigma_floor: float,
    settings: AlignmentSettings,
) -> tuple[NDArray[np.int64], float, float, Array, Array]:  # fmt: skip
    """Verdicts of each look (v, 4), the area agreed on, chi^2, and H and b of each look."""
    v, n = batch.ranges.shape
    H, b, chi2 = np.zeros((v, 6, 6)), np.zeros((v, 6)), 0.0
    verdicts_by_view = np.zeros((v, 4), dtype=np.int64)
    depth, triangle_index, verdict = (
        np.empty(n),
        np.empty(n, dtype=np.int64),
        np.empty(n, dtype=np.int8),
    )
    shape = np.ceil((model.bounds[1] - model.bounds[0]) / _PATCH_SIZE).astype(int)
    patches = np.zeros(np.maximum(shape, 1), dtype=np.bool_)
    for k in range(v):
        R, t = _displaced_base(T, errors[k])
        R_view, t_view = R @ batch.R[k], R @ batch.t[k] + t
        render_depth(
            model.triangles,
            R_view.T.copy(),
            -R_view.T @ t_view,
            batch.intrinsics,
            depth,
            triangle_index,
        )
        expected = triangle_index >= 0
        if not expected.any():
            continue
        chi2 += pixel_residuals(
            batch.points[k], batch.hit[k], batch.ranges[k], batch.min_ranges[k], depth, triangle_index,
            model.normals, model.plane_points, batch.R[k], batch.t[k], R, t, noise_parameters(noise), sigma_floor,
            RESIDUAL_GATE, settings.depth_margin, MAX_RANGE_RESIDUAL, verdict, H[k], b[k], patches, model.bounds[0], _PATCH_SIZE,
        )  # fmt: skip
        verdicts_by_view[k] = np.bincount(verdict[expected], minlength=4)
    return verdicts_by_view, float(patches.sum()) * _PATCH_SIZE**2, chi2, H, b


def _count_off_surface(
    model: TargetModel,
    batch: ViewBatch,
    T: Pose,
    errors: Array,
    noise: RangeNoise,
    tolerance: float,
) -> int:
    """Points of all looks in the target's box that do not lie on it."""
    surface_distances, origin = distance_field(model, _DISTANCE_CELL, _DISTANCE_PADDING)
    inset = np.array([0.05, 0.05, 0.05])
    low, high = model.bounds[0] + inset, model.bounds[1] - inset
    low[2] = 0.15
    total = 0
    for k in range(len(batch)):
        R, t = _displaced_base(T, errors[k])
        total += count_off_surface(
            batch.points[k], batch.hit[k], batch.R[k], batch.t[k], R, t, surface_distances, origin, _DISTANCE_CELL,
            low, high, noise_parameters(noise), tolerance,
        )  # fmt: skip
    return total


def _displaced_base(T: Pose, error: Array) -> tuple[Array, Array]:
    """R, t of where a look sees the base."""
    pose = apply_displacement(T, error)
    return pose.rotation, pose.translation


def noise_parameters(noise: RangeNoise) -> tuple[float, float, float, float]:
    """S, T along and across the optical axis, and n of Eq. 1, for kernels."""
    return float(noise.intrinsic), float(noise.depth), float(noise.lateral), float(noise.exponent)
