"""Whether a pose of the target is to be believed: figures of fit, and the first that fails."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc

from coopmap_env.localization.registration.alignment import Alignment
from coopmap_env.localization.registration.pixel_residuals import AGREES, SEEN_THROUGH, UNDECIDED
from coopmap_env.localization.registration.shared_pose import view_chi2


@dataclass(frozen=True)
class AcceptanceSettings:
    """What a pose must fulfil.

    The figures were read off 340 worksites, 60 clutters and 60 piles of rubble with two robots and
    up to 12 looks each: true poses with 150 points or more are inside of each in 98 of 100 cases,
    and wrong poses fail one or several.

    Raises
    ------
    ValueError
        With the value, if one is out of range.
    """

    min_points: int = 100
    """Points on the target at least: with fewer, parts of other things look like it."""
    min_area: float = 0.65
    """Square metres of the target that points lie on: a crate near by fills an image with points
    and is like a part of many things. Wrong poses had up to 0.55."""
    min_confirmed_fraction: float = 0.94
    """Least share of the pixels that should see the target and do. True poses have 0.95 and more;
    the rest lies at edges. Another table, taken for the target, had 0.938."""
    max_contradicted_fraction: float = 0.01
    """Largest share of them that see through it; none do at most true poses."""
    max_off_surface_fraction: float = 0.6
    """Largest share, of the points in the target's box, that do not lie on it: other blocks lie
    between those of a pile (up to 0.47), nothing between a panel's legs."""
    max_chi2: float = 1.25
    """Largest mean of squared residuals over Eq. 1's variances. It is 0.97 for Gaussian ones that
    are cut off at three sigma, and up to 1.1 with edges."""
    max_position_std: float = 0.06
    """Metres: what the points leave open in x and y. Two faces that meet leave 0.01 to 0.03."""
    max_yaw_std: float = math.radians(1.5)
    """Radians, likewise."""
    min_evidence_margin: float = 0.1
    """Least share by which the evidence for the next distinct pose is less. A panel that has slid
    along itself by 0.3 m keeps 0.86 of it."""
    min_separation: tuple[float, float] = (0.1, math.radians(4.0))
    """Metres and radians from which another pose is distinct: ten sigma of the first."""
    min_view_points: int = 40
    """Points of a look that takes part in the test of whether looks agree."""
    min_view_confirmed_fraction: float = 0.84
    """Least share confirmed by each such look."""
    min_view_p_value: float = 1e-4
    """Chance below which a look that is so far from the others is taken to contradict them."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            least = min(value) if field.name == "min_separation" else value
            if not (math.isfinite(least) and least >= 0):
                raise ValueError(f"AcceptanceSettings.{field.name} must be >= 0, got {value}")
        for name in (
            "min_confirmed_fraction",
            "max_contradicted_fraction",
            "max_off_surface_fraction",
            "min_evidence_margin",
            "min_view_confirmed_fraction",
            "min_view_p_value",
        ):
            if getattr(self, name) > 1:
                raise ValueError(
                    f"AcceptanceSettings.{name} is a share of 1 at most, got {getattr(self, name)}"
                )


class Fitness(NamedTuple):
    """How well the best pose explains the looks."""

    n_points: int
    """Measured points on the target."""
    area: float
    """Square metres of the target that they lie on."""
    inlier_fraction: float
    """Share of them among all points in the target's box."""
    confirmed_fraction: float
    """Share of the pixels that should see the target, nothing being in front of it, that do."""
    contradicted_fraction: float
    """Share of them that see through it."""
    chi2: float
    """Mean squared residual of the points on the target, over Eq. 1's variance."""
    evidence_margin: float
    """1 - evidence for the next distinct pose / evidence for this one."""
    min_view_confirmed_fraction: float
    """The least share confirmed by a look that should see enough of the target."""
    view_p_value: float
    """Chance that looks differ as much as the one does that differs most, if the pose is true."""


def evidence(alignment: Alignment) -> float:
    """Pixels for a pose less those that do not see what they should, and half of what is off it."""
    counts = alignment.counts
    return counts.agreeing - counts.seen_through - counts.undecided - 0.5 * counts.off_surface


def evaluate_fitness(
    best: Alignment, next_evidence: float, settings: AcceptanceSettings
) -> Fitness:
    """Figures of a pose; `next_evidence` is that for the next distinct one."""
    counts, best_evidence = best.counts, evidence(best)
    expected = max(counts.agreeing + counts.seen_through + counts.undecided, 1)
    return Fitness(
        counts.agreeing,
        best.area,
        counts.agreeing / max(counts.agreeing + counts.off_surface, 1),
        counts.agreeing / expected,
        counts.seen_through / expected,
        best.chi2,
        float(np.clip(1.0 - next_evidence / best_evidence, 0.0, 1.0)) if best_evidence > 0 else 0.0,
        _min_view_confirmed(best, settings.min_view_points),
        _view_p_value(best, settings.min_view_points),
    )


def _min_view_confirmed(best: Alignment, points: int) -> float:
    """Share confirmed by the look that confirms least, of those that should see so many points."""
    agreeing = best.verdicts_by_view[:, AGREES]
    expected = (
        agreeing + best.verdicts_by_view[:, SEEN_THROUGH] + best.verdicts_by_view[:, UNDECIDED]
    )
    enough = expected >= points
    return float((agreeing[enough] / expected[enough]).min(initial=1.0))


def _view_p_value(best: Alignment, points: int) -> float:
    """Chance of the look that agrees least with the others; 1 with fewer than two."""
    enough = best.verdicts_by_view[:, AGREES] >= points
    if enough.sum() < 2:
        return 1.0
    chi2, dof = view_chi2(best.H[enough], best.g[enough], best.pose_covariances[enough])
    chances = chdtrc(np.maximum(dof, 1.0), chi2)
    return float(min(chances.min() * enough.sum(), 1.0))  # of so many tries (Bonferroni)


def rejection_reason(best: Alignment, fit: Fitness, settings: AcceptanceSettings) -> str:
    """Why a pose is not to be believed yet, with the figures; empty if it is."""
    std = np.sqrt(np.maximum(np.diag(best.covariance), 0.0))
    position, yaw = float(std[:2].max()), float(std[5])
    if fit.n_points < settings.min_points:
        return f"{fit.n_points} points on the target, {settings.min_points} are needed"
    if fit.area < settings.min_area:
        return (
            f"points on {fit.area:.2f} square metres of the target, {settings.min_area} are needed"
        )
    if fit.confirmed_fraction < settings.min_confirmed_fraction:
        return f"only {fit.confirmed_fraction:.0%} of what should be seen of the target is seen"
    if fit.contradicted_fraction > settings.max_contradicted_fraction:
        return f"beams pass through {fit.contradicted_fraction:.0%} of what should be seen of the target"
    if 1.0 - fit.inlier_fraction > settings.max_off_surface_fraction:
        return f"{1.0 - fit.inlier_fraction:.0%} of the points in the target's box are not on it"
    if fit.chi2 > settings.max_chi2:
        return f"points miss the target by {fit.chi2:.2f} times their variance"
    if position > settings.max_position_std or yaw > settings.max_yaw_std:
        return (
            f"what is seen leaves {position:.2f} m and {math.degrees(yaw):.1f} degrees open: too "
            f"little of its shape"
        )
    if fit.evidence_margin < settings.min_evidence_margin:
        return f"another pose explains all but {fit.evidence_margin:.0%} as well"
    if fit.min_view_confirmed_fraction < settings.min_view_confirmed_fraction:
        return (
            f"one of the views sees but {fit.min_view_confirmed_fraction:.0%} of what it should see"
        )
    if fit.view_p_value < settings.min_view_p_value:
        return f"the views disagree: by chance they would with {fit.view_p_value:.1g}"
    return ""
