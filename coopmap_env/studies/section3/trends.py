"""The trends of the paper's Section 3, each a question with a statistical answer.

T1  The observed area after 32 scans is about equal for every m and for the exhaustive search.
T2  A raster scan observes far less.
T3  The spread of the observed space (sigma) and its farthest point decrease as m grows.
T4  Already from m = 10 to m = 50, the two smallest searches, no column of Table 1 increases.

All compare searches on the same worlds. They are reported as held or not held, but T4 by what its
intervals show: that the smallest m is above the next, that it is below, or neither.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats

from coopmap_env.evaluation import BOOTSTRAP_SEED, Evaluation
from coopmap_env.evaluation.statistics import (
    Interval,
    bootstrap_paired_difference,
    equivalence_test,
    page_trend_test,
    percentile_bounds,
)
from coopmap_env.studies.section3.setting import TABLE_1_SCORES

EQUIVALENCE_MARGIN = 0.15
"""T1: "about equal" means that the interval of a search's mean lies within 15 % of the mean of all
searches. The curves of the paper's Figure 8 differ by about as much."""
MAX_RASTER_RATIO = 0.75
"""T2: "far less" means less than three quarters of the smallest coverage of the other searches."""
SIGNIFICANCE_LEVEL = 0.05
"""Of T2 and T3."""


@dataclass(frozen=True)
class Trend:
    """A verdict and its evidence."""

    held: bool
    question: str
    statistic: str
    """What the value means."""
    value: float
    p_value: float | None
    details: dict[str, Any]
    wording: str = ""
    """The verdict, where "held" or "not held" says too much."""

    @property
    def verdict(self) -> str:
        """In words."""
        return self.wording or ("held" if self.held else "not held")

    def as_dict(self) -> dict[str, Any]:
        """JSON values."""
        return {
            "held": self.held,
            "verdict": self.verdict,
            "question": self.question,
            "statistic": self.statistic,
            "value": self.value,
            "p_value": self.p_value,
            **self.details,
        }


def equal_coverage(searches: Mapping[Any, Evaluation]) -> Trend:
    """T1 as an equivalence test: every mean within `EQUIVALENCE_MARGIN` of the mean of all."""
    coverage = _table(searches, "coverage")
    test = equivalence_test(coverage, EQUIVALENCE_MARGIN, np.random.default_rng(BOOTSTRAP_SEED))
    return Trend(
        held=test.equivalent,
        question="the observed area is about equal for every m and exhaustive",
        statistic="largest distance of a search's mean, its 95 % interval included, from the mean "
        f"of all, as a fraction of it; held if at most {EQUIVALENCE_MARGIN}",
        value=test.max_deviation,
        p_value=None,
        details={
            "ratio_to_mean": {
                str(name): interval.as_dict()
                for name, interval in zip(searches, test.intervals, strict=True)
            }
        },
    )


def raster_coverage_is_lower(raster: Evaluation, searches: Mapping[Any, Evaluation]) -> Trend:
    """T2: the ratio of a raster scan's coverage to the smallest of the searches."""
    ours, theirs = raster.table["coverage"], _table(searches, "coverage")
    ratio = _ratio_to_minimum(ours, theirs)
    p_values = [
        float(stats.wilcoxon(ours, column, alternative="less").pvalue) for column in theirs.T
    ]
    return Trend(
        held=ratio.high < MAX_RASTER_RATIO and max(p_values) < SIGNIFICANCE_LEVEL,
        question="a raster scan observes far less than any search",
        statistic="observed area of the raster scan over the smallest of the searches; held if its "
        f"interval lies below {MAX_RASTER_RATIO} and every paired test is significant",
        value=ratio.estimate,
        p_value=max(p_values),
        details={"ratio": ratio.as_dict(), "p_value_of": "largest of the Wilcoxon tests"},
    )


def extent_decreases(searches: Mapping[Any, Evaluation]) -> Trend:
    """T3: sigma and farthest observed point decrease from the smallest m to exhaustive (Page)."""
    tests = {
        column: page_trend_test(_table(searches, column), direction="decreasing")
        for column in ("radius_std", "max_radius")
    }
    worst = max(tests, key=lambda column: tests[column].p_value)
    return Trend(
        held=all(test.p_value < SIGNIFICANCE_LEVEL for test in tests.values()),
        question="sigma and the farthest observed point decrease as m grows",
        statistic=f"Page's L of {worst}, the less certain of the two; held if both are significant",
        value=float(tests[worst].statistic),
        p_value=float(tests[worst].p_value),
        details={
            column: {"statistic": float(test.statistic), "p_value": float(test.p_value)}
            for column, test in tests.items()
        },
    )


def smallest_search_is_widest(searches: Mapping[Any, Evaluation]) -> Trend:
    """T4: no column of Table 1 is surely smaller for the smallest m than for the next."""
    smallest, second = list(searches.values())[:2]
    rng = np.random.default_rng(BOOTSTRAP_SEED)
    differences = {
        column: bootstrap_paired_difference(smallest.table[column], second.table[column], rng)
        for column in TABLE_1_SCORES
    }
    worst = min(differences, key=lambda column: differences[column].high)
    return Trend(
        held=all(difference.high >= 0.0 for difference in differences.values()),
        question="the smallest m views further and wider than the next",
        statistic=f"{worst}, the least certain of the three columns: smallest m less the next, "
        f"{differences[worst]:.2f} (95 % interval); above if all three intervals lie above 0, "
        "below if one lies below it",
        value=differences[worst].estimate,
        p_value=None,
        details={column: difference.as_dict() for column, difference in differences.items()},
        wording=_wording(list(differences.values())),
    )


def _wording(differences: Sequence[Interval]) -> str:
    if all(difference.low > 0.0 for difference in differences):
        return "above"
    if any(difference.high < 0.0 for difference in differences):
        return "below"
    return "within noise: not shown to be lower"


def all_trends(raster: Evaluation, searches: Mapping[Any, Evaluation]) -> dict[str, Trend]:
    """T1 to T4; `searches` are ordered from the smallest m to exhaustive."""
    return {
        "T1": equal_coverage(searches),
        "T2": raster_coverage_is_lower(raster, searches),
        "T3": extent_decreases(searches),
        "T4": smallest_search_is_widest(searches),
    }


def _table(searches: Mapping[Any, Evaluation], column: str) -> np.ndarray[Any, Any]:
    """(n_worlds, n_searches) of one score."""
    columns: Sequence[Any] = [evaluation.table[column] for evaluation in searches.values()]
    return np.column_stack(columns)


def _ratio_to_minimum(ours: np.ndarray[Any, Any], theirs: np.ndarray[Any, Any]) -> Interval:
    """Mean of `ours` (n,) over the smallest column mean of `theirs` (n, k), worlds resampled."""
    rng = np.random.default_rng(BOOTSTRAP_SEED)
    worlds = rng.integers(len(ours), size=(2000, len(ours)))
    ratios = ours[worlds].mean(axis=1) / theirs[worlds].mean(axis=1).min(axis=1)
    low, high = percentile_bounds(ratios)
    return Interval(float(ours.mean() / theirs.mean(axis=0).min()), float(low), float(high))
