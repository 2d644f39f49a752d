"""Target registration: where a robot stands, from the known target among what it sees (2.2).

The search names hypotheses, which are then refined and held against every pixel. The best one must
fit, leave nothing open and be told clearly from all others; else the robot is not located yet,
looks once more and asks again.

The base frame and the target's stand upright on the same flat ground, z up and 0 there: the search
is one of x, y and yaw. The refinement is one of all six, about that (`AlignmentSettings.level_ground`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from coopmap_env.geometry import rotation_about_z
from coopmap_env.geometry.rotations import apply_displacement, rotvec_from_rotation
from coopmap_env.geometry.transforms import Pose
from coopmap_env.localization.registration.acceptance import (
    AcceptanceSettings,
    Fitness,
    evaluate_fitness,
    evidence,
    rejection_reason,
)
from coopmap_env.localization.registration.alignment import (
    Alignment,
    AlignmentSettings,
    align,
    nearest_upright,
)
from coopmap_env.localization.registration.icp import Refiner, SmallGicp
from coopmap_env.localization.registration.search import SearchSettings, search, voxel_centroids
from coopmap_env.localization.registration.views import View, ViewBatch
from coopmap_env.localization.target import TargetModel
from coopmap_env.sensing.depth_camera import DepthCamera
from coopmap_env.sensing.noise import RangeNoise

__all__ = ["Registration", "RegistrationSettings", "View", "register"]

_SLIDE_DISTANCES = (0.07, 0.15, 0.3)
"""Metres by which a pose is moved to where its points hold it least, to see whether it stays."""
_HALF_TURNS = (0.5, 1.0, 1.5)
"""Half turns about the target's middle: of things made by people, most look alike after one."""


@dataclass(frozen=True)
class RegistrationSettings:
    """Settings of the three stages, and what links them.

    Raises
    ------
    ValueError
        With the value, if one is out of range.
    """

    search: SearchSettings = field(default_factory=SearchSettings)
    alignment: AlignmentSettings = field(default_factory=AlignmentSettings)
    acceptance: AcceptanceSettings = field(default_factory=AcceptanceSettings)
    n_hypotheses: int = 8
    """Hypotheses that are aligned, at 5 to 10 ms each."""
    icp_max_distance: float = 0.12
    """Metres within which ICP pairs points with the surface: what the search leaves, twice."""

    def __post_init__(self) -> None:
        n = self.n_hypotheses
        if isinstance(n, bool) or not isinstance(n, int | np.integer) or n < 1:
            raise ValueError(
                f"RegistrationSettings.n_hypotheses must be a whole number of at least 1, got {n!r}"
            )
        if not self.icp_max_distance > 0:
            raise ValueError(
                f"RegistrationSettings.icp_max_distance must be > 0 m, got {self.icp_max_distance}"
            )


@dataclass(frozen=True, eq=False)
class Registration:
    """Where a robot stands, or why that is not known yet."""

    located: bool
    reason: str
    """Why it is not located; empty if it is."""
    T_target_base: Pose | None = None
    """None unless it is located."""
    covariance: NDArray[np.float64] | None = None
    """(6, 6) of the base's displacement [translation, rotation vector] in the target's frame."""
    fitness: Fitness | None = None
    """Of the best hypothesis, be it believed or not; None without any."""
    equivalent_poses: tuple[Pose, ...] = ()
    """All poses that fit alike, as the target maps onto itself: `T_target_base` first."""


def register(
    model: TargetModel,
    views: Sequence[View],
    camera: DepthCamera,
    noise: RangeNoise,
    settings: RegistrationSettings | None = None,
    refiner: Refiner | None = None,
) -> Registration:
    """Locate a base by the target that its camera sees. It draws no random numbers.

    Parameters
    ----------
    model : TargetModel
    views : sequence of View
        All looks so far from one place, at least one.
    camera : DepthCamera
    noise : RangeNoise
        Eq. 1.
    settings : RegistrationSettings, optional
    refiner : Refiner, optional
        `SmallGicp` if not given.

    Raises
    ------
    ValueError
        If there is no view, or one does not fit to the camera.
    ImportError
        If no refiner is given and the extra "field" is not installed.
    """
    settings = settings or RegistrationSettings()
    refiner = refiner or SmallGicp()
    batch = ViewBatch.from_views(views, camera)
    found = _aligned_hypotheses(model, batch, noise, settings, refiner)
    if not found:
        return Registration(False, "nothing in view could be the target")
    best = max(found, key=evidence)
    least = settings.acceptance.min_points
    if best.counts.agreeing >= least:
        best, found = _challenge(model, batch, best, found, noise, settings)
    rivals = [
        other for other in found
        if not any(
            _are_close(motion @ best.T_target_base, other.T_target_base, *settings.acceptance.min_separation)
            for motion in model.symmetries
        )
    ]  # fmt: skip
    fit = evaluate_fitness(best, max(map(evidence, rivals), default=0.0), settings.acceptance)
    reason = rejection_reason(best, fit, settings.acceptance)
    if reason:
        return Registration(False, reason, fitness=fit)
    poses = (best.T_target_base, *(m @ best.T_target_base for m in model.symmetries[1:]))
    return Registration(True, "", best.T_target_base, best.covariance, fit, poses)


def _aligned_hypotheses(
    model: TargetModel, batch: ViewBatch, noise: RangeNoise, settings: RegistrationSettings,
    refiner: Refiner,
) -> list[Alignment]:  # fmt: skip
    """The search's hypotheses, each refined by ICP and aligned."""
    points = voxel_centroids(
        batch.points_in_base(),
        settings.search.ground_height,
        model.bounds[1, 2],
        settings.search.voxel_size / 2.0,
    )
    samples, normals = _icp_surface(model)
    found: list[Alignment] = []
    for T, _ in search(model, batch, settings.search)[: settings.n_hypotheses]:
        camera_center = T.transform(batch.t.mean(axis=0))
        facing = samples[np.einsum("ni,ni->n", normals, camera_center - samples) > 0.0]
        points_in_target, max_distance = T.transform(points), settings.icp_max_distance
        near = (
            (points_in_target > model.bounds[0] - max_distance)
            & (points_in_target < model.bounds[1] + max_distance)
        ).all(axis=1)
        refined = nearest_upright(refiner(points[near], facing, T, max_distance))
        start = refined if _are_close(refined, T, 0.3, 0.25) else T
        if not any(_are_close(start, other.T_target_base, 0.02, 0.01) for other in found):
            found.append(align(model, batch, start, noise, settings.alignment))
    return found


@lru_cache(maxsize=8)
def _icp_surface(model: TargetModel) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Samples and normals for ICP: one for each 6 cm."""
    return model.sample_surface(max(round(model.area / 0.06**2), 64))


def _challenge(
    model: TargetModel, batch: ViewBatch, best: Alignment, found: list[Alignment], noise: RangeNoise,
    settings: RegistrationSettings,
) -> tuple[Alignment, list[Alignment]]:  # fmt: skip
    """The best pose, after its likeliest rivals have been aligned too, and all of them.

    These are poses that have slid along the target's faces, and such that are turned about its
    middle, which the search may have passed over.
    """
    found = list(found)

    def align_from(start: Pose) -> Alignment:
        alignment = align(model, batch, start, noise, settings.alignment)
        found.append(alignment)
        return alignment

    for _ in range(3):
        _, axes = np.linalg.eigh(best.covariance[:2, :2])
        previous = best
        for distance in _SLIDE_DISTANCES:
            for axis in (axes[:, 1], -axes[:, 1]):
                move = np.array([*(distance * axis), 0.0, 0.0, 0.0, 0.0])
                best = max(
                    best, align_from(apply_displacement(previous.T_target_base, move)), key=evidence
                )
        if _are_close(
            previous.T_target_base, best.T_target_base, *settings.acceptance.min_separation
        ):
            break
    centre = np.array([*model.center_xy, 0.0])
    for half_turns in _HALF_TURNS:
        R = rotation_about_z(np.pi * half_turns)
        best = max(
            best, align_from(Pose(centre - R @ centre, R) @ best.T_target_base), key=evidence
        )
    return best, found


def _are_close(one: Pose, other: Pose, distance: float, angle: float) -> bool:
    """Whether two poses are within a distance in metres and an angle in radians of each other."""
    if float(np.linalg.norm(one.translation - other.translation)) >= distance:
        return False
    return float(np.linalg.norm(rotvec_from_rotation(one.rotation.T @ other.rotation))) < angle
