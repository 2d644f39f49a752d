"""Acceptance of an aligned pose: its fitness, and why it is rejected."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from coopmap_env.core.settings import NonNegative, NonNegativeInt, Settings, UnitInterval
from coopmap_env.localization.failures import LocalizationFailure
from coopmap_env.localization.registration._pixel_residuals import AGREES, SEEN_THROUGH, UNDECIDED
from coopmap_env.localization.registration._shared_pose import view_chi2
from coopmap_env.localization.registration.alignment import Alignment


@dataclass(frozen=True)
class AcceptanceSettings(Settings):
    """What a pose must fulfil.

    The values follow from 340 worksites, 60 clutters and 60 piles of rubble with two robots and up
    to 12 scans each: true poses with 150 points or more meet each of them in 98 of 100 cases, and
    wrong poses fail one or several.
    """

    min_points: NonNegativeInt = 100
    """Points on the target: with fewer, parts of other things fit as well."""
    min_area: NonNegative = 0.65
    """Square metres of the target that points lie on: a crate near by fills an image with points
    and is like a part of many things. Wrong poses had up to 0.55."""
    min_confirmed_fraction: UnitInterval = 0.94
    """Of the pixels that should see the target, the fraction that does. True poses have 0.95 and
    more; the rest lies at edges. Another table that was found for the target had 0.938."""
    max_contradicted_fraction: UnitInterval = 0.01
    """Of the same pixels, the fraction that sees through it; none does at most true poses."""
    max_off_surface_fraction: UnitInterval = 0.6
    """Of the points in the target's box, the fraction that does not lie on it: other blocks lie
    between those of a pile (up to 0.47), nothing between a panel's legs."""
    max_chi2: NonNegative = 1.25
    """Mean of squared residuals over Eq. 1's variances. It is 0.97 for Gaussian ones that are cut
    off at three sigma, and up to 1.1 with edges."""
    max_position_std: NonNegative = 0.06
    """Standard deviation of x and y, metres. Two faces that meet leave 0.01 to 0.03."""
    max_yaw_std: NonNegative = math.radians(1.5)
    """Standard deviation of yaw, radians."""
    min_evidence_margin: UnitInterval = 0.1
    """Fraction by which the evidence for the next distinct pose is less. A panel that has slid
    along itself by 0.3 m keeps 0.86 of it."""
    min_separation: tuple[NonNegative, NonNegative] = (0.1, math.radians(4.0))
    """Metres and radians from which another pose is distinct: ten sigma of the first."""
    min_view_points: NonNegativeInt = 40
    """Points of a view that takes part in the test of whether views agree."""
    min_view_confirmed_fraction: UnitInterval = 0.84
    """Confirmed fraction of each such view."""
    min_view_p_value: UnitInterval = 1e-4
    """P-value of a view's disagreement with the others below which it contradicts them."""


class Fitness(NamedTuple):
    """How well the best pose explains the views."""

    n_points: int
    """Measured points on the target."""
    area: float
    """Square metres of the target that they lie on."""
    inlier_fraction: float
    """Fraction of them among all points in the target's box."""
    confirmed_fraction: float
    """Of the pixels that should see the target with nothing in front of it, the fraction that
    does."""
    contradicted_fraction: float
    """Of the same pixels, the fraction that sees through it."""
    chi2: float
    """Mean squared residual of the points on the target, over Eq. 1's variance."""
    evidence_margin: float
    """1 - evidence for the next distinct pose / evidence for this one."""
    min_view_confirmed_fraction: float
    """Least confirmed fraction of a view that should see enough of the target."""
    view_p_value: float
    """Probability of a disagreement as large as the largest of a view, if the pose is true."""


def evidence(alignment: Alignment) -> float:
    """Score of a pose: agreeing pixels less contradicting ones and half of the points off it."""
    counts = alignment.counts
    return counts.agreeing - counts.seen_through - counts.undecided - 0.5 * counts.off_surface


def evaluate_fitness(
    best: Alignment, next_evidence: float, settings: AcceptanceSettings
) -> Fitness:
    """Fitness of a pose; `next_evidence` is the evidence for the next distinct one."""
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
    """Least confirmed fraction, of the views that should see at least so many points."""
    agreeing = best.verdicts_by_view[:, AGREES]
    expected = (
        agreeing + best.verdicts_by_view[:, SEEN_THROUGH] + best.verdicts_by_view[:, UNDECIDED]
    )
    enough = expected >= points
    return float((agreeing[enough] / expected[enough]).min(initial=1.0))


def _view_p_value(best: Alignment, points: int) -> float:
    """P-value of the view that agrees least with the others; 1 with fewer than two views."""
    from scipy.special import chdtrc  # a third of a second, seldom needed

    enough = best.verdicts_by_view[:, AGREES] >= points
    if enough.sum() < 2:
        return 1.0
    chi2, dof = view_chi2(best.H[enough], best.g[enough], best.pose_covariances[enough])
    p_values = chdtrc(np.maximum(dof, 1.0), chi2)
    return float(min(p_values.min() * enough.sum(), 1.0))  # of so many tries (Bonferroni)


def rejection_reason(
    best: Alignment, fit: Fitness, settings: AcceptanceSettings
) -> tuple[LocalizationFailure, str]:
    """Why a pose is rejected, and the same in words, with the figures; empty if it is accepted."""
    found = _first_failure(best, fit, settings)
    return (LocalizationFailure.NONE, "") if found is None else found


def _first_failure(
    best: Alignment, fit: Fitness, settings: AcceptanceSettings
) -> tuple[LocalizationFailure, str] | None:
    std = np.sqrt(np.maximum(np.diag(best.covariance), 0.0))
    position, yaw = float(std[:2].max()), float(std[5])
    code = LocalizationFailure
    if fit.n_points < settings.min_points:
        text = f"points on the target: {fit.n_points}, needed: {settings.min_points}"
        return code.FEW_POINTS, text
    if fit.area < settings.min_area:
        text = f"area of the target with points: {fit.area:.2f} m^2, needed: {settings.min_area}"
        return code.SMALL_AREA, text
    if fit.confirmed_fraction < settings.min_confirmed_fraction:
        text = f"only {fit.confirmed_fraction:.0%} of the expected target pixels see the target"
        return code.UNCONFIRMED, text
    if fit.contradicted_fraction > settings.max_contradicted_fraction:
        text = f"{fit.contradicted_fraction:.0%} of the expected target pixels see through it"
        return code.SEEN_THROUGH, text
    if 1.0 - fit.inlier_fraction > settings.max_off_surface_fraction:
        text = f"{1.0 - fit.inlier_fraction:.0%} of the points in the target's box are not on it"
        return code.OFF_SURFACE, text
    if fit.chi2 > settings.max_chi2:
        text = f"mean squared residual of the points is {fit.chi2:.2f} times their variance"
        return code.LARGE_RESIDUALS, text
    if position > settings.max_position_std or yaw > settings.max_yaw_std:
        return code.UNDETERMINED, (
            f"visible shape does not determine the pose: standard deviations of {position:.2f} m "
            f"and {math.degrees(yaw):.1f} degrees"
        )
    if fit.evidence_margin < settings.min_evidence_margin:
        text = f"another pose has {1.0 - fit.evidence_margin:.0%} of the evidence"
        return code.AMBIGUOUS, text
    if fit.min_view_confirmed_fraction < settings.min_view_confirmed_fraction:
        fraction = fit.min_view_confirmed_fraction
        text = f"only {fraction:.0%} of the expected target pixels of a view see the target"
        return code.VIEW_UNCONFIRMED, text
    if fit.view_p_value < settings.min_view_p_value:
        return code.VIEWS_DISAGREE, f"views disagree, with a p-value of {fit.view_p_value:.1g}"
    return None
