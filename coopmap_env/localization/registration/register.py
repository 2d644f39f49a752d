"""Target registration: where a robot stands, from the known target among what it sees (2.2).

The search names hypotheses, which are then refined and held against every pixel. The best one must
fit, leave nothing open and be told clearly from all others; else the robot is not located yet,
looks once more and asks again.

The base frame and the target's stand upright on the same flat ground, z up and 0 there: the search
is one of x, y and yaw. The refinement is one of all six, about that (`AlignmentSettings.level`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from coopmap_env.geometry.rotations import displaced, vector_of_rotation
from coopmap_env.geometry.transforms import Pose
from coopmap_env.localization.registration.acceptance import (
    Fitness,
    FitnessSettings,
    evidence,
    fitness,
    why_not,
)
from coopmap_env.localization.registration.alignment import (
    Alignment,
    AlignmentSettings,
    align,
    levelled,
)
from coopmap_env.localization.registration.icp import Refiner, SmallGicp
from coopmap_env.localization.registration.search import SearchSettings, search, votes
from coopmap_env.localization.registration.views import Looks, View
from coopmap_env.localization.target import TargetModel, about_z
from coopmap_env.sensing.depth_camera import DepthCamera
from coopmap_env.sensing.noise import RangeNoise

__all__ = ["Registration", "RegistrationSettings", "View", "register"]

_SLIDES = (0.07, 0.15, 0.3)
"""Metres by which a pose is moved to where its points hold it least, to see whether it stays."""
_TURNS = (0.5, 1.0, 1.5)
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
    fitness: FitnessSettings = field(default_factory=FitnessSettings)
    candidates: int = 8
    """Hypotheses that are aligned, at 5 to 10 ms each."""
    refine_reach: float = 0.12
    """Metres within which ICP pairs points with the surface: what the search leaves, twice."""

    def __post_init__(self) -> None:
        n = self.candidates
        if isinstance(n, bool) or not isinstance(n, int | np.integer) or n < 1:
            raise ValueError(
                f"RegistrationSettings.candidates must be a whole number of at least 1, got {n!r}"
            )
        if not self.refine_reach > 0:
            raise ValueError(
                f"RegistrationSettings.refine_reach must be > 0 m, got {self.refine_reach}"
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
    equivalents: tuple[Pose, ...] = ()
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
    looks = Looks.of(views, camera)
    found = _candidates(model, looks, noise, settings, refiner)
    if not found:
        return Registration(False, "nothing in view could be the target")
    best = max(found, key=evidence)
    least = settings.fitness.points
    if best.counts.agree >= least:
        best, found = _challenged(model, looks, best, found, noise, settings)
    others = [
        other for other in found
        if not any(
            _same(motion @ best.T_target_base, other.T_target_base, *settings.fitness.distinct)
            for motion in model.symmetries
        )
    ]  # fmt: skip
    fit = fitness(best, max(map(evidence, others), default=0.0), settings.fitness)
    reason = why_not(best, fit, settings.fitness)
    if reason:
        return Registration(False, reason, fitness=fit)
    poses = (best.T_target_base, *(m @ best.T_target_base for m in model.symmetries[1:]))
    return Registration(True, "", best.T_target_base, best.covariance, fit, poses)


def _candidates(
    model: TargetModel, looks: Looks, noise: RangeNoise, settings: RegistrationSettings,
    refiner: Refiner,
) -> list[Alignment]:  # fmt: skip
    """The search's hypotheses, each refined by ICP and aligned."""
    points = votes(
        looks.in_base(), settings.search.ground, model.bounds[1, 2], settings.search.voxel / 2.0
    )
    samples, normals = _coarse(model)
    found: list[Alignment] = []
    for T, _ in search(model, looks, settings.search)[: settings.candidates]:
        eye = T.transform(looks.t.mean(axis=0))
        facing = samples[np.einsum("ni,ni->n", normals, eye - samples) > 0.0]
        placed, room = T.transform(points), settings.refine_reach
        near = ((placed > model.bounds[0] - room) & (placed < model.bounds[1] + room)).all(axis=1)
        refined = levelled(refiner(points[near], facing, T, room))
        start = refined if _same(refined, T, 0.3, 0.25) else T
        if not any(_same(start, other.T_target_base, 0.02, 0.01) for other in found):
            found.append(align(model, looks, start, noise, settings.alignment))
    return found


@lru_cache(maxsize=8)
def _coarse(model: TargetModel) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Samples and normals for ICP: one for each 6 cm."""
    return model.sampled(max(round(model.area / 0.06**2), 64))


def _challenged(
    model: TargetModel, looks: Looks, best: Alignment, found: list[Alignment], noise: RangeNoise,
    settings: RegistrationSettings,
) -> tuple[Alignment, list[Alignment]]:  # fmt: skip
    """The best pose, after its likeliest rivals have been aligned too, and all of them.

    These are poses that have slid along the target's faces, and such that are turned about its
    middle, which the search may have passed over.
    """
    found = list(found)

    def tried(start: Pose) -> Alignment:
        alignment = align(model, looks, start, noise, settings.alignment)
        found.append(alignment)
        return alignment

    for _ in range(3):
        _, axes = np.linalg.eigh(best.covariance[:2, :2])
        before = best
        for slide in _SLIDES:
            for axis in (axes[:, 1], -axes[:, 1]):
                move = np.array([*(slide * axis), 0.0, 0.0, 0.0, 0.0])
                best = max(best, tried(displaced(before.T_target_base, move)), key=evidence)
        if _same(before.T_target_base, best.T_target_base, *settings.fitness.distinct):
            break
    centre = np.array([*model.middle, 0.0])
    for half_turns in _TURNS:
        R = about_z(np.pi * half_turns)
        best = max(best, tried(Pose(centre - R @ centre, R) @ best.T_target_base), key=evidence)
    return best, found


def _same(one: Pose, other: Pose, distance: float, angle: float) -> bool:
    """Whether two poses are within a distance in metres and an angle in radians of each other."""
    if float(np.linalg.norm(one.translation - other.translation)) >= distance:
        return False
    return float(np.linalg.norm(vector_of_rotation(one.rotation.T @ other.rotation))) < angle
