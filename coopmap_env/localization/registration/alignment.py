"""Alignment of a hypothesis with all views, and the evidence for it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.elementary import atan2
from coopmap_env.core.linear_algebra import product
from coopmap_env.core.settings import NonNegative, Positive, Settings, UnitInterval
from coopmap_env.geometry import (
    Pose,
    RigidTransform,
    apply_displacement,
    displacement_between,
    rotation_about_z,
)
from coopmap_env.localization._depth_rendering import DepthImage, render_depth
from coopmap_env.localization.registration._likelihood_field import distance_field
from coopmap_env.localization.registration._pixel_residuals import (
    AGREES,
    OCCLUDED,
    SEEN_THROUGH,
    UNDECIDED,
    SurfacePatches,
    Thresholds,
    ViewEvidence,
    count_off_surface,
    pixel_residuals,
)
from coopmap_env.localization.registration._shared_pose import (
    camera_to_base_covariances,
    shared_pose,
)
from coopmap_env.localization.registration.views import ViewBatch
from coopmap_env.localization.target import TargetModel
from coopmap_env.sensing import RangeNoise

Array = NDArray[np.float64]

RESIDUAL_GATE = 3.0
"""Sigmas within which a point lies on its plane."""
MAX_RANGE_RESIDUAL = 0.3
"""Metres along a ray within which it can do so: a slanted plane is far ahead of a point that is
near to it."""
_SIGMA_FLOORS = (0.1, 0.06, 0.03, 0.015, 0.008)
"""Metres that are added to sigma in the first iterations, while associations still change."""
ITERATIONS = 8
"""As many as floors, and three with the last one."""
FINAL_SIGMA_FLOOR = 0.003
"""Metres: remaining error of model and arithmetic."""
_MAX_STEP = 1.0
"""Metres and radians of a step: no start is so far off, so a larger step is a failure."""
_DISTANCE_CELL, _DISTANCE_PADDING = 0.05, 0.2
"""Metres: cells of the distance field, and its margin around the target."""
_PATCH_SIZE = 0.1
"""Metres: edge of the patches that measure the visible area of the target."""
_BOX_INSET = 0.05
"""Metres by which the box for points off the surface lies inside the target's bounding box."""
_BOX_BOTTOM = 0.15
"""Metres above the ground where that box begins: below, points are the ground's."""
_WEAK_PRIOR = np.diag([1e-2, 1e-2, 1e-2, 1.0, 1.0, 1.0])
"""Prior information without knowledge: standard deviations of 10 m and 1 rad."""


@dataclass(frozen=True)
class AlignmentSettings(Settings):
    """Prior knowledge of cameras and ground for the alignment."""

    level_ground: bool = True
    """Flat ground: the base stands as level as the target, at the same height."""
    level_std: tuple[Positive, Positive] = (0.005, math.radians(0.1))
    """Standard deviations of that: metres of height, radians of roll and pitch."""
    common_error_fraction: UnitInterval = 0.7
    """Fraction of a camera pose's variance that is common to all views and does not average out.
    Of a joint's it is 0.15^2 / (0.15^2 + 0.1^2) = 0.69 with the calibration and encoders of mounts
    (`Mount`). The suspension's error is new with each posture, so this errs on the safe side."""
    depth_margin: NonNegative = 0.08
    """Metres beyond three sigma by which a surface must lie behind or in front of a point to
    contradict it: 0.45 degrees at 5 m, and 4 cm for the pixel's own width on a slanted face."""


class PixelCounts(NamedTuple):
    """Pixels of all views by their verdict on a pose."""

    agreeing: int
    """See the target where it is expected."""
    occluded: int
    """See something in front of it."""
    seen_through: int
    """See through it."""
    undecided: int
    """None of these, though the target is expected there."""
    off_surface: int
    """Points within the target's box that do not lie on the target."""


class Alignment(NamedTuple):
    """An aligned pose, its covariance, and the evidence there."""

    T_target_base: Pose
    covariance: Array
    """(6, 6) of the base's displacement in the target's frame."""
    counts: PixelCounts
    chi2: float
    """Mean square of the agreeing pixels' residuals over their variances."""
    H: Array
    """Information (v, 6, 6) of each view about the base's pose."""
    g: Array
    """H times the displacement (v, 6) of the base that each view measures."""
    pose_covariances: Array
    """Covariances (v, 6, 6) of the cameras' poses, as displacements of the base."""
    verdicts_by_view: NDArray[np.int64]
    """(v, 4): number of each view's pixels by the verdicts of `pixel_residuals`."""
    area: float
    """Square metres of the target that points lie on: patches of a square decimetre."""


class _Evaluation(NamedTuple):
    """All views compared with the target at one pose."""

    verdicts_by_view: NDArray[np.int64]
    area: float
    chi2: float
    H: Array
    b: Array


def align(
    model: TargetModel,
    batch: ViewBatch,
    start: Pose,
    noise: RangeNoise,
    settings: AlignmentSettings,
    iterations: int = ITERATIONS,
) -> Alignment:
    """Gauss-Newton over the base's pose and the errors of all camera poses.

    Each iteration renders the target for each camera (`render_depth`), computes the pixels'
    residuals (`pixel_residuals`), and solves for all errors at once (`shared_pose`).

    Parameters
    ----------
    model : TargetModel
    batch : ViewBatch
    start : Pose
        T_target_base, right to about 0.2 m and 5 degrees.
    noise : RangeNoise
        Eq. 1.
    settings : AlignmentSettings
    iterations : int
        At least 1.
    """
    T, errors = start, np.zeros((len(batch), 6))
    for k in range(iterations):
        sigma_floor = _SIGMA_FLOORS[k] if k < len(_SIGMA_FLOORS) else FINAL_SIGMA_FLOOR
        thresholds = Thresholds(
            sigma_floor, RESIDUAL_GATE, settings.depth_margin, MAX_RANGE_RESIDUAL
        )
        verdicts, area, chi2, H, b = _evaluate_views(model, batch, T, errors, noise, thresholds)
        pose_covariances = camera_to_base_covariances(batch.covariances, batch.t, T.rotation)
        agreeing = verdicts[:, AGREES]
        weights = agreeing / max(agreeing.sum(), 1)
        common = settings.common_error_fraction * (weights[:, None, None] * pose_covariances).sum(
            axis=0
        )
        independent = (1.0 - settings.common_error_fraction) * pose_covariances
        P, Px = _prior(T, settings)
        g = b + product(H, errors[..., None])[..., 0]
        estimate = shared_pose(H, g, independent, common, P, Px)
        step = estimate.x
        if not np.abs(step).max() < _MAX_STEP:
            # the pose is not determined: what was counted so far is no evidence
            verdicts[:] = 0
            break
        T, errors = apply_displacement(T, step), estimate.errors
        g = g - product(H, step)
    total = verdicts.sum(axis=0).tolist()
    counts = PixelCounts(
        total[AGREES], total[OCCLUDED], total[SEEN_THROUGH], total[UNDECIDED],
        _count_off_surface(model, batch, T, errors, noise, settings.depth_margin),
    )  # fmt: skip
    chi2 /= max(counts.agreeing, 1)
    return Alignment(T, estimate.covariance, counts, chi2, H, g, pose_covariances, verdicts, area)


def nearest_upright(pose: Pose) -> Pose:
    """The nearest pose that stands upright on the ground: x, y and yaw of a pose."""
    yaw = atan2(
        pose.rotation[1, 0] - pose.rotation[0, 1], pose.rotation[0, 0] + pose.rotation[1, 1]
    )
    return Pose(pose.translation * [1.0, 1.0, 0.0], rotation_about_z(yaw))


def _prior(T: Pose, settings: AlignmentSettings) -> tuple[Array, Array]:
    """Prior information (6, 6), and times its displacement (6,) from T."""
    P = _WEAK_PRIOR
    if settings.level_ground:
        height, tilt = (1.0 / s**2 for s in settings.level_std)
        P = P + np.diag([0.0, 0.0, height, tilt, tilt, 0.0])
    return P, product(P, displacement_between(T, nearest_upright(T))) * [
        0.0,
        0.0,
        1.0,
        1.0,
        1.0,
        0.0,
    ]


def _evaluate_views(
    model: TargetModel,
    batch: ViewBatch,
    T: Pose,
    errors: Array,
    noise: RangeNoise,
    thresholds: Thresholds,
) -> _Evaluation:
    """Compare all views with the target, the base at T and displaced by each view's error."""
    v, n = batch.ranges.shape
    H, b, chi2 = np.zeros((v, 6, 6)), np.zeros((v, 6)), 0.0
    verdicts_by_view = np.zeros((v, 4), dtype=np.int64)
    image, verdicts = DepthImage.empty(n), np.empty(n, dtype=np.int8)
    shape = np.ceil((model.bounds[1] - model.bounds[0]) / _PATCH_SIZE).astype(int)
    seen = np.zeros(np.maximum(shape, 1), dtype=np.bool_)
    patches = SurfacePatches(seen, model.bounds[0], _PATCH_SIZE)
    for k in range(v):
        pose = apply_displacement(T, errors[k])
        R = product(pose.rotation, batch.R[k])
        t = product(pose.rotation, batch.t[k]) + pose.translation
        T_camera_target = RigidTransform(R.T.copy(), -product(R.T, t))
        render_depth(model.triangles, T_camera_target, batch.intrinsics, image)
        expected = image.triangle_index >= 0
        if not expected.any():
            continue
        chi2 += pixel_residuals(
            batch.view(k), image, model.planes, pose.arrays, noise.parameters, thresholds,
            ViewEvidence(verdicts, H[k], b[k]), patches,
        )  # fmt: skip
        verdicts_by_view[k] = np.bincount(verdicts[expected], minlength=4)
    return _Evaluation(verdicts_by_view, float(seen.sum()) * _PATCH_SIZE**2, chi2, H, b)


def _count_off_surface(
    model: TargetModel,
    batch: ViewBatch,
    T: Pose,
    errors: Array,
    noise: RangeNoise,
    tolerance: float,
) -> int:
    """Points of all views in the target's box that do not lie on it."""
    field = distance_field(model, _DISTANCE_CELL, _DISTANCE_PADDING)
    low, high = model.bounds[0] + _BOX_INSET, model.bounds[1] - _BOX_INSET
    low[2] = _BOX_BOTTOM
    return sum(
        count_off_surface(
            batch.view(k), apply_displacement(T, errors[k]).arrays, field, low, high,
            noise.parameters, tolerance,
        )
        for k in range(len(batch))
    )  # fmt: skip
