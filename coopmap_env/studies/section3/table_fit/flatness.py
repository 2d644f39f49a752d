"""How well the table determines each constant: two views of what lies around the optimum.

The *profile* moves one coordinate of `points.RANGES` and keeps the others, on the same worlds: the
differences are paired. The *near-optimal range* spans the trials of the search that are almost as
good as the best one. There the other constants differ too, so it is wide where they can make up
for each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from coopmap_env.evaluation import BOOTSTRAP_SEED
from coopmap_env.evaluation.statistics import Interval, percentile_bounds
from coopmap_env.studies.section3.setting import TableConstants
from coopmap_env.studies.section3.table_fit.episodes import Columns, mean_columns
from coopmap_env.studies.section3.table_fit.objective import Fit
from coopmap_env.studies.section3.table_fit.points import RANGES, Point, constants_at

PROFILE_FACTORS = (0.6, 0.8, 1.25, 1.67)
"""Multiples of a coordinate's best value that the profile plays."""
SMALL_WEIGHT = 0.5
"""Below this, a weight of headings is as good as 0."""
TOLERANCE = 0.02
"""Trials whose loss is larger than the best one by at most this are near it."""
N_RESAMPLES = 2000


@dataclass(frozen=True)
class ProfilePoint:
    """One coordinate moved."""

    value: float
    fit: Fit
    loss: Interval
    """What the search minimises, less that of the optimum, on the same worlds."""
    deviation_loss: Interval
    """Its part of the 18 numbers: their deviation, less that of the optimum."""

    def as_dict(self) -> dict[str, Any]:
        """JSON values."""
        return {
            "value": self.value,
            **self.fit.as_dict(),
            "loss": self.loss.as_dict(),
            "deviation_loss": self.deviation_loss.as_dict(),
        }


def profile_values(name: str, best: float) -> list[float]:
    """The values of a coordinate that a profile plays, without the best one."""
    if RANGES[name].low == 0.0 and best < SMALL_WEIGHT:  # multiples of 0 are 0
        return [SMALL_WEIGHT, 4 * SMALL_WEIGHT]
    values = [factor * best for factor in PROFILE_FACTORS]
    if not RANGES[name].integer:
        return [round(value, 4) for value in values]
    return sorted({float(round(value)) for value in values} - {best})


def profile_points(best: Point) -> list[tuple[str, float]]:
    """Coordinate and value of all points that a profile plays beside the best one.

    Values that no `TableConstants` may have are replaced by the limit of the search on their side.
    """
    moved: dict[tuple[str, float], None] = {}
    for name in RANGES:
        for value in profile_values(name, best[name]):
            if not _is_valid(best, name, value):
                value = RANGES[name].low if value < best[name] else RANGES[name].high
            if value != best[name]:
                moved[name, value] = None
    return list(moved)


def _is_valid(best: Point, name: str, value: float) -> bool:
    try:
        moved_constants(best, name, value)
    except ValueError:
        return False
    return True


def moved_constants(best: Point, name: str, value: float) -> TableConstants:
    """The constants of the best point with one coordinate moved."""
    return constants_at({**best, name: int(value) if RANGES[name].integer else value})


def compare_points(
    moved: Sequence[tuple[str, float]], columns: Sequence[Columns], at_best: Columns
) -> dict[str, list[ProfilePoint]]:
    """The profile, by coordinate: what each moved coordinate costs on the same worlds."""
    points: dict[str, list[ProfilePoint]] = {}
    for (name, value), one in zip(moved, columns, strict=True):
        fit = Fit.from_means(mean_columns(one))
        losses = [paired_loss(one, at_best, part) for part in ("value", "deviation")]
        points.setdefault(name, []).append(ProfilePoint(value, fit, *losses))
    return points


def paired_loss(columns: Columns, reference: Columns, part: str = "value") -> Interval:
    """A property of the `Fit` of some columns less that of others, with its 95 % interval.

    Both are of the same worlds.
    """
    n_worlds = len(next(iter(reference.values())))
    draws = np.random.default_rng(BOOTSTRAP_SEED).integers(n_worlds, size=(N_RESAMPLES, n_worlds))

    def loss(worlds: Any) -> Any:
        ours, best = (
            Fit.from_means({search: rows[worlds].mean(axis=-2) for search, rows in one.items()})
            for one in (columns, reference)
        )
        return getattr(ours, part) - getattr(best, part)

    low, high = percentile_bounds(loss(draws))
    return Interval(float(loss(np.arange(n_worlds))), float(low), float(high))


def near_optimal_ranges(
    trials: Sequence[tuple[float, Point]], tolerance: float = TOLERANCE
) -> dict[str, tuple[float, float]]:
    """Lowest and highest value of each coordinate among the trials (value, point) near the best."""
    best = min(value for value, _ in trials)
    near = [point for value, point in trials if value <= best + tolerance]
    return {
        name: (min(point[name] for point in near), max(point[name] for point in near))
        for name in near[0]
    }
