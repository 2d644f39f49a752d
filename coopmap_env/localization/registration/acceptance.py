"""Whether a pose of the target is to be believed: figures of fit, and the first that fails."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc

from coopmap_env.localization.registration.alignment import Alignment
from coopmap_env.localization.registration.pixel_residuals import AGREES, OPEN, SEEN_THROUGH
from coopmap_env.localization.registration.shared_pose import disagreement


@dataclass(frozen=True)
class FitnessSettings:
    """What a pose must fulfil.

    The figures were read off 340 worksites, 60 clutters and 60 piles of rubble with two robots and
    up to 12 looks each: true poses with 150 points or more are inside of each in 98 of 100 cases,
    and wrong poses fail one or several.

    Raises
    ------
    ValueError
        With the value, if one is out of range.
    """

    points: int = 100
    """Points on the target at least: with fewer, parts of other things look like it."""
    area: float = 0.65
    """Square metres of the target that points lie on: a crate near by fills an image with points
    and is like a part of many things. Wrong poses had up to 0.55."""
    confirmed: float = 0.94
    """Least share of the pixels that should see the target and do. True poses have 0.95 and more;
    the rest lies at edges. Another table, taken for the target, had 0.938."""
    contradicted: float = 0.01
    """Largest share of them that see through it; none do at most true poses."""
    off: float = 0.6
    """Largest share, of the points in the target's box, that do not lie on it: other blocks lie
    between those of a pile (up to 0.47), nothing between a panel's legs."""
    chi2: float = 1.25
    """Largest mean of squared residuals over Eq. 1's variances. It is 0.97 for Gaussian ones that
    are cut off at three sigma, and up to 1.1 with edges."""
    position_std: float = 0.06
    """Metres: what the points leave open in x and y. Two faces that meet leave 0.01 to 0.03."""
    yaw_std: float = math.radians(1.5)
    """Radians, likewise."""
    margin: float = 0.1
    """Least share by which the evidence for the next distinct pose is less. A panel that has slid
    along itself by 0.3 m keeps 0.86 of it."""
    distinct: tuple[float, float] = (0.1, math.radians(4.0))
    """Metres and radians from which another pose is distinct: ten sigma of the first."""
    view_points: int = 40
    """Points of a look that takes part in the test of whether looks agree."""
    view_confirmed: float = 0.84
    """Least share confirmed by each such look."""
    view_chance: float = 1e-4
    """Chance below which a look that is so far from the others is taken to contradict them."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            least = min(value) if field.name == "distinct" else value
            if not (math.isfinite(least) and least >= 0):
                raise ValueError(f"FitnessSettings.{field.name} must be >= 0, got {value}")
        for name in ("confirmed", "contradicted", "off", "margin", "view_confirmed", "view_chance"):
            if getattr(self, name) > 1:
                raise ValueError(
                    f"FitnessSettings.{name} is a share of 1 at most, got {getattr(self, name)}"
                )


class Fitness(NamedTuple):
    """How well the best pose explains the looks."""

    points: int
    """Measured points on the target."""
    area: float
    """Square metres of the target that they lie on."""
    inliers: float
    """Share of them among all points in the target's box."""
    confirmed: float
    """Share of the pixels that should see the target, nothing being in front of it, that do."""
    contradicted: float
    """Share of them that see through it."""
    chi2: float
    """Mean squared residual of the points on the target, over Eq. 1's variance."""
    margin: float
    """1 - evidence for the next distinct pose / evidence for this one."""
    view_confirmed: float
    """The least share confirmed by a look that should see enough of the target."""
    agreement: float
    """Chance that looks differ as much as the one does that differs most, if the pose is true."""


def evidence(alignment: Alignment) -> float:
    """Pixels for a pose less those that do not see what they should, and half of what is off it."""
    counts = alignment.counts
    return counts.agree - counts.through - counts.open - 0.5 * counts.off


def fitness(best: Alignment, next_evidence: float, settings: FitnessSettings) -> Fitness:
    """Figures of a pose; `next_evidence` is that for the next distinct one."""
    counts, mine = best.counts, evidence(best)
    expected = max(counts.agree + counts.through + counts.open, 1)
    return Fitness(
        counts.agree,
        best.area,
        counts.agree / max(counts.agree + counts.off, 1),
        counts.agree / expected,
        counts.through / expected,
        best.chi2,
        float(np.clip(1.0 - next_evidence / mine, 0.0, 1.0)) if mine > 0 else 0.0,
        _least_confirmed(best, settings.view_points),
        _agreement(best, settings.view_points),
    )


def _least_confirmed(best: Alignment, points: int) -> float:
    """Share confirmed by the look that confirms least, of those that should see so many points."""
    agree = best.by_look[:, AGREES]
    expected = agree + best.by_look[:, SEEN_THROUGH] + best.by_look[:, OPEN]
    enough = expected >= points
    return float((agree[enough] / expected[enough]).min(initial=1.0))


def _agreement(best: Alignment, points: int) -> float:
    """Chance of the look that agrees least with the others; 1 with fewer than two."""
    enough = best.by_look[:, AGREES] >= points
    if enough.sum() < 2:
        return 1.0
    chi2, freedom = disagreement(best.H[enough], best.g[enough], best.carried[enough])
    chances = chdtrc(np.maximum(freedom, 1.0), chi2)
    return float(min(chances.min() * enough.sum(), 1.0))  # of so many tries (Bonferroni)


def why_not(best: Alignment, fit: Fitness, settings: FitnessSettings) -> str:
    """Why a pose is not to be believed yet, with the figures; empty if it is."""
    std = np.sqrt(np.maximum(np.diag(best.covariance), 0.0))
    position, yaw = float(std[:2].max()), float(std[5])
    if fit.points < settings.points:
        return f"{fit.points} points on the target, {settings.points} are needed"
    if fit.area < settings.area:
        return f"points on {fit.area:.2f} square metres of the target, {settings.area} are needed"
    if fit.confirmed < settings.confirmed:
        return f"only {fit.confirmed:.0%} of what should be seen of the target is seen"
    if fit.contradicted > settings.contradicted:
        return f"beams pass through {fit.contradicted:.0%} of what should be seen of the target"
    if 1.0 - fit.inliers > settings.off:
        return f"{1.0 - fit.inliers:.0%} of the points in the target's box are not on it"
    if fit.chi2 > settings.chi2:
        return f"points miss the target by {fit.chi2:.2f} times their variance"
    if position > settings.position_std or yaw > settings.yaw_std:
        return (
            f"what is seen leaves {position:.2f} m and {math.degrees(yaw):.1f} degrees open: too "
            f"little of its shape"
        )
    if fit.margin < settings.margin:
        return f"another pose explains all but {fit.margin:.0%} as well"
    if fit.view_confirmed < settings.view_confirmed:
        return f"one of the views sees but {fit.view_confirmed:.0%} of what it should see"
    if fit.agreement < settings.view_chance:
        return f"the views disagree: by chance they would with {fit.agreement:.1g}"
    return ""
