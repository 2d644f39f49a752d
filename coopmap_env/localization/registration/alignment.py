"""A hypothesis brought to where all looks agree best, and what the looks then say of it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.geometry.rotations import displaced, displacement_between
from coopmap_env.geometry.transforms import Pose
from coopmap_env.localization.depth_rendering import expect
from coopmap_env.localization.registration.likelihood_field import distances
from coopmap_env.localization.registration.pixel_residuals import (
    AGREES,
    IN_FRONT,
    OPEN,
    SEEN_THROUGH,
    judge,
    unexplained,
)
from coopmap_env.localization.registration.shared_pose import carried_to_base, shared_pose
from coopmap_env.localization.registration.views import Looks
from coopmap_env.localization.target import TargetModel, about_z
from coopmap_env.sensing.noise import RangeNoise

Array = NDArray[np.float64]

GATE = 3.0
"""Sigmas within which a point lies on its plane."""
JUMP = 0.3
"""Metres along a beam within which it can do so: a slanted plane is far ahead of a point that is
near to it."""
_FLOORS = (0.1, 0.06, 0.03, 0.015, 0.008)
"""Metres that are added to sigma while planes are still to be found; the last one for the rest."""
ROUNDS = 8
"""As many rounds as floors, and three for the rest."""
FLOOR = 0.003
"""Metres: what is left of the model's and the arithmetic's error."""
_FARTHEST = 1.0
"""Metres and radians of a step: a start is never so far off."""
_CELL, _ROOM = 0.05, 0.2
_PATCH = 0.1
"""Metres: side of the patches that tell how much of the target is seen."""
_UNKNOWN = np.diag([1e-2, 1e-2, 1e-2, 1.0, 1.0, 1.0])
"""Information beforehand where nothing is known: standard deviations of 10 m and 1 rad."""


@dataclass(frozen=True)
class AlignmentSettings:
    """What is known of cameras and ground when the pose is refined.

    Raises
    ------
    ValueError
        With the value, if one is out of range.
    """

    level: bool = True
    """The base stands as level as the target, at the same height: flat ground."""
    level_std: tuple[float, float] = (0.005, math.radians(0.1))
    """Metres of height and radians of roll and pitch by which it may not."""
    common_share: float = 0.7
    """Of the camera pose's variance, what is alike in all looks and does not average out. Of a
    joint's it is 0.15^2 / (0.15^2 + 0.1^2) = 0.69 with the calibration and encoders of mounts
    (`Mount`); what a suspension adds is new with each posture, so this errs on the safe side."""
    margin: float = 0.08
    """Metres beyond three sigma by which a surface must lie behind or in front of a point for the
    pixel to say so: 0.45 degrees at 5 m, and 4 cm for the pixel's own width on a slanted face."""

    def __post_init__(self) -> None:
        if not (len(self.level_std) == 2 and all(0 < s < math.inf for s in self.level_std)):
            raise ValueError(f"AlignmentSettings.level_std must be > 0, got {self.level_std}")
        if not 0 <= self.common_share <= 1:
            raise ValueError(
                f"AlignmentSettings.common_share must lie in [0, 1], got {self.common_share}"
            )
        if not 0 <= self.margin < math.inf:
            raise ValueError(f"AlignmentSettings.margin must be >= 0, got {self.margin}")


class Counts(NamedTuple):
    """What the pixels of all looks say of a pose."""

    agree: int
    """See the target where it should be."""
    in_front: int
    """See something in front of it."""
    through: int
    """See through it."""
    open: int
    """Are to see the target and say none of these."""
    off: int
    """Points within the target's box that do not lie on the target."""


class Alignment(NamedTuple):
    """A pose, how sure it is, and what was counted there."""

    T_target_base: Pose
    covariance: Array
    """(6, 6) of the base's displacement in the target's frame."""
    counts: Counts
    chi2: float
    """Mean square of the agreeing pixels' residuals over their variances."""
    H: Array
    """Information (v, 6, 6) of each look about where it sees the base."""
    g: Array
    """H times the displacement (v, 6) at which each look sees it."""
    carried: Array
    """Covariances (v, 6, 6) of the cameras' poses, as displacements of the base."""
    by_look: NDArray[np.int64]
    """(v, 4): how many pixels of each look have which verdict of `fit_pixels`."""
    area: float
    """Square metres of the target that points lie on: patches of a square decimetre."""


def align(
    model: TargetModel, looks: Looks, start: Pose, noise: RangeNoise, settings: AlignmentSettings,
    rounds: int = ROUNDS,
) -> Alignment:  # fmt: skip
    """Gauss-Newton over the base's pose and the errors of all looks' camera poses.

    Each round draws what the cameras would see (`expect`), has every pixel say what it pulls
    towards (`judge`), and solves for all errors at once (`shared_pose`).

    Parameters
    ----------
    model : TargetModel
    looks : Looks
    start : Pose
        T_target_base, right to about 0.2 m and 5 degrees.
    noise : RangeNoise
        Eq. 1.
    settings : AlignmentSettings
    rounds : int
        At least 1.
    """
    T, errors = start, np.zeros((len(looks), 6))
    for k in range(rounds):
        floor = _FLOORS[k] if k < len(_FLOORS) else FLOOR
        by_look, area, chi2, H, b = _judge_all(model, looks, T, errors, noise, floor, settings)
        carried = carried_to_base(looks.covariances, looks.t, T.rotation)
        agree = by_look[:, AGREES]
        weights = agree / max(agree.sum(), 1)
        common = settings.common_share * np.einsum("v,vij->ij", weights, carried)
        own = (1.0 - settings.common_share) * carried
        P, Px = _prior(T, settings)
        g = b + np.einsum("vij,vj->vi", H, errors)
        estimate = shared_pose(H, g, own, common, P, Px)
        step = estimate.x
        if not np.abs(step).max() < _FARTHEST:
            # nothing holds it: what was counted on the way is no evidence
            by_look[:] = 0
            break
        T, errors = displaced(T, step), estimate.errors
        g = g - np.einsum("vij,j->vi", H, step)
    total = by_look.sum(axis=0).tolist()
    counts = Counts(
        total[AGREES], total[IN_FRONT], total[SEEN_THROUGH], total[OPEN],
        _off(model, looks, T, errors, noise, settings.margin),
    )  # fmt: skip
    return Alignment(
        T, estimate.covariance, counts, chi2 / max(counts.agree, 1), H, g, carried, by_look, area
    )


def levelled(pose: Pose) -> Pose:
    """The pose on the ground, upright, that is nearest: its x, y and yaw."""
    yaw = math.atan2(
        pose.rotation[1, 0] - pose.rotation[0, 1], pose.rotation[0, 0] + pose.rotation[1, 1]
    )
    return Pose(pose.translation * [1.0, 1.0, 0.0], about_z(yaw))


def _prior(T: Pose, settings: AlignmentSettings) -> tuple[Array, Array]:
    """Information (6, 6) of what is known beforehand, and times its displacement (6,) from T."""
    P = _UNKNOWN
    if settings.level:
        height, tilt = (1.0 / s**2 for s in settings.level_std)
        P = P + np.diag([0.0, 0.0, height, tilt, tilt, 0.0])
    return P, P @ displacement_between(T, levelled(T)) * [0.0, 0.0, 1.0, 1.0, 1.0, 0.0]


def _judge_all(
    model: TargetModel, looks: Looks, T: Pose, errors: Array, noise: RangeNoise, floor: float,
    settings: AlignmentSettings,
) -> tuple[NDArray[np.int64], float, float, Array, Array]:  # fmt: skip
    """Verdicts of each look (v, 4), the area agreed on, chi^2, and H and b of each look."""
    v, n = looks.ranges.shape
    H, b, chi2 = np.zeros((v, 6, 6)), np.zeros((v, 6)), 0.0
    by_look = np.zeros((v, 4), dtype=np.int64)
    depth, seen, verdict = np.empty(n), np.empty(n, dtype=np.int64), np.empty(n, dtype=np.int8)
    shape = np.ceil((model.bounds[1] - model.bounds[0]) / _PATCH).astype(int)
    patches = np.zeros(np.maximum(shape, 1), dtype=np.bool_)
    for k in range(v):
        R, t = _seen_from(T, errors[k])
        R_view, t_view = R @ looks.R[k], R @ looks.t[k] + t
        expect(model.triangles, R_view.T.copy(), -R_view.T @ t_view, looks.lens, depth, seen)
        expected = seen >= 0
        if not expected.any():
            continue
        chi2 += judge(
            looks.points[k], looks.hit[k], looks.ranges[k], looks.around[k], depth, seen,
            model.normals, model.corners, looks.R[k], looks.t[k], R, t, numbers(noise), floor,
            GATE, settings.margin, JUMP, verdict, H[k], b[k], patches, model.bounds[0], _PATCH,
        )  # fmt: skip
        by_look[k] = np.bincount(verdict[expected], minlength=4)
    return by_look, float(patches.sum()) * _PATCH**2, chi2, H, b


def _off(
    model: TargetModel, looks: Looks, T: Pose, errors: Array, noise: RangeNoise, tolerance: float
) -> int:
    """Points of all looks in the target's box that do not lie on it."""
    away, origin = distances(model, _CELL, _ROOM)
    inner = np.array([0.05, 0.05, 0.05])
    low, high = model.bounds[0] + inner, model.bounds[1] - inner
    low[2] = 0.15
    total = 0
    for k in range(len(looks)):
        R, t = _seen_from(T, errors[k])
        total += unexplained(
            looks.points[k], looks.hit[k], looks.R[k], looks.t[k], R, t, away, origin, _CELL,
            low, high, numbers(noise), tolerance,
        )  # fmt: skip
    return total


def _seen_from(T: Pose, error: Array) -> tuple[Array, Array]:
    """R, t of where a look sees the base."""
    pose = displaced(T, error)
    return pose.rotation, pose.translation


def numbers(noise: RangeNoise) -> tuple[float, float, float, float]:
    """S, T along and across the optical axis, and n of Eq. 1, for kernels."""
    return float(noise.intrinsic), float(noise.depth), float(noise.lateral), float(noise.exponent)
