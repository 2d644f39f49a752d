"""Target registration: the pose of a robot's base from views of the known target (Section 2.2).

The search gives hypotheses, which are aligned and compared with every pixel. The best one must fit,
be fully determined and clearly better than all others. Otherwise the robot is not located yet; it
makes another scan and tries again.

The base frame and the target's are upright on the same flat ground, z up and 0 there: the search
is over x, y and yaw. The alignment is over all six coordinates, with flat ground as a prior
(`AlignmentSettings.level_ground`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.caches import freeze
from coopmap_env.core.linear_algebra import eigh, length, product
from coopmap_env.core.settings import Positive, PositiveInt, Settings
from coopmap_env.geometry import (
    Pose,
    apply_displacement,
    rotation_about_z,
    rotvec_from_rotation,
)
from coopmap_env.localization.failures import LocalizationFailure
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
from coopmap_env.sensing import DepthCamera, RangeNoise

_SLIDE_DISTANCES = (0.07, 0.15, 0.3)
"""Metres by which a pose is moved along its least certain direction, to see if it comes back."""
_MAX_SLIDES = 3
"""Rounds of such moves."""
_HALF_TURNS = (0.5, 1.0, 1.5)
"""Half turns about the target's center: most manufactured objects look alike after one."""
_ICP_SPACING = 0.06
"""Metres between the samples of the surface for ICP."""
_ICP_MAX_CHANGE = (0.3, 0.25)
"""Metres and radians by which ICP may move a hypothesis; otherwise its result is not used."""
_SAME_START = (0.02, 0.01)
"""Metres and radians within which a hypothesis is the same as one that was aligned already."""


@dataclass(frozen=True)
class RegistrationSettings(Settings):
    """Settings of the three stages, and of ICP between the first two."""

    search: SearchSettings = field(default_factory=SearchSettings)
    alignment: AlignmentSettings = field(default_factory=AlignmentSettings)
    acceptance: AcceptanceSettings = field(default_factory=AcceptanceSettings)
    n_hypotheses: PositiveInt = 8
    """Hypotheses that are aligned, at 5 to 10 ms each."""
    icp_max_distance: Positive = 0.12
    """Metres within which ICP pairs points with the surface: twice the error of the search."""


@dataclass(frozen=True, eq=False)
class Registration:
    """The pose of a robot's base, or why it is not known yet."""

    failure: LocalizationFailure
    """Why it is not located; `NONE` if it is."""
    reason: str
    """The same in words, with the figures; empty if it is located."""
    T_target_base: Pose | None = None
    """None unless it is located."""
    covariance: NDArray[np.float64] | None = None
    """(6, 6) of the base's displacement [translation, rotation vector] in the target's frame."""
    fitness: Fitness | None = None
    """Fitness of the best hypothesis, accepted or not; None if there is none."""
    equivalent_poses: tuple[Pose, ...] = ()
    """All poses that fit alike with a symmetric target: `T_target_base` first."""

    @property
    def located(self) -> bool:
        """Whether the pose is known."""
        return self.failure is LocalizationFailure.NONE


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
        All scans so far from the same base pose, at least one.
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
        nothing = LocalizationFailure.NOTHING_ALIKE
        return Registration(nothing, nothing.words)
    best = max(found, key=evidence)
    accept = settings.acceptance
    if best.counts.agreeing >= accept.min_points:
        best, found = _align_rivals(model, batch, best, found, noise, settings)
    equivalent = (best.T_target_base, *(m @ best.T_target_base for m in model.symmetries[1:]))
    rivals = [
        other
        for other in found
        if not any(
            _are_close(pose, other.T_target_base, accept.min_separation) for pose in equivalent
        )
    ]
    fitness = evaluate_fitness(best, max(map(evidence, rivals), default=0.0), accept)
    failure, reason = rejection_reason(best, fitness, accept)
    if failure:
        return Registration(failure, reason, fitness=fitness)
    return Registration(failure, "", best.T_target_base, best.covariance, fitness, equivalent)


def _aligned_hypotheses(
    model: TargetModel,
    batch: ViewBatch,
    noise: RangeNoise,
    settings: RegistrationSettings,
    refiner: Refiner,
) -> list[Alignment]:
    """The search's hypotheses, each refined by ICP and aligned."""
    points = voxel_centroids(
        batch.points_in_base(),
        settings.search.ground_height,
        model.bounds[1, 2],
        settings.search.voxel_size / 2.0,
    )
    samples, normals = _icp_surface(model)
    max_distance = settings.icp_max_distance
    low, high = model.bounds[0] - max_distance, model.bounds[1] + max_distance
    found: list[Alignment] = []
    for T, _ in search(model, batch, settings.search)[: settings.n_hypotheses]:
        camera_center = T.transform(batch.t.mean(axis=0))
        facing = samples[(normals * (camera_center - samples)).sum(axis=1) > 0.0]
        in_target = T.transform(points)
        near = ((in_target > low) & (in_target < high)).all(axis=1)
        refined = nearest_upright(refiner(points[near], facing, T, max_distance))
        start = refined if _are_close(refined, T, _ICP_MAX_CHANGE) else T
        if not any(_are_close(start, other.T_target_base, _SAME_START) for other in found):
            found.append(align(model, batch, start, noise, settings.alignment))
    return found


@lru_cache(maxsize=8)
def _icp_surface(model: TargetModel) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Samples and normals for ICP."""
    return freeze(model.sample_surface(max(round(model.area / _ICP_SPACING**2), 64)))


def _align_rivals(
    model: TargetModel,
    batch: ViewBatch,
    best: Alignment,
    found: list[Alignment],
    noise: RangeNoise,
    settings: RegistrationSettings,
) -> tuple[Alignment, list[Alignment]]:
    """Align the likeliest rivals of the best pose too; the best of all, and all of them.

    The search may have missed poses that slide along the target's faces, or are rotated about its
    center.
    """
    found = list(found)

    def align_from(start: Pose) -> Alignment:
        alignment = align(model, batch, start, noise, settings.alignment)
        found.append(alignment)
        return alignment

    for _ in range(_MAX_SLIDES):
        _, axes = eigh(best.covariance[:2, :2])
        previous = best.T_target_base
        for distance in _SLIDE_DISTANCES:
            for axis in (axes[:, 1], -axes[:, 1]):
                slide = np.array([*(distance * axis), 0.0, 0.0, 0.0, 0.0])
                best = max(best, align_from(apply_displacement(previous, slide)), key=evidence)
        if _are_close(previous, best.T_target_base, settings.acceptance.min_separation):
            break
    center = np.array([*model.center_xy, 0.0])
    for half_turns in _HALF_TURNS:
        R = rotation_about_z(np.pi * half_turns)
        start = Pose(center - product(R, center), R) @ best.T_target_base
        best = max(best, align_from(start), key=evidence)
    return best, found


def _are_close(one: Pose, other: Pose, limits: tuple[float, float]) -> bool:
    """Whether two poses are within a distance in metres and an angle in radians of each other."""
    distance, angle = limits
    if length(one.translation - other.translation) >= distance:
        return False
    return length(rotvec_from_rotation(product(one.rotation.T, other.rotation))) < angle
