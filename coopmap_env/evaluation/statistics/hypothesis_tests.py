"""Tests of an ordered alternative (Page) and of equivalence, over a set of worlds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from coopmap_env.evaluation.statistics._samples import check_table
from coopmap_env.evaluation.statistics.bootstrap import percentile_bootstrap
from coopmap_env.evaluation.statistics.interval import Interval


@dataclass(frozen=True)
class TrendTestResult:
    """Result of Page's trend test."""

    statistic: float
    """Page's L: sum over columns of predicted rank times rank sum."""
    p_value: float
    """Probability of an L at least this large if the columns do not differ."""


@dataclass(frozen=True)
class EquivalenceResult:
    """Whether the columns of a table have about the same mean."""

    equivalent: bool
    """Whether every column's ratio and its interval lie within 1 ± margin."""
    intervals: tuple[Interval, ...]
    """Column mean over grand mean, one for each column."""
    max_deviation: float
    """Largest distance of any ratio or interval end from 1: the smallest margin of equivalence."""


def page_trend_test(
    data: ArrayLike, direction: Literal["increasing", "decreasing"] = "increasing"
) -> TrendTestResult:
    """Page's trend test: whether the columns increase (or decrease) in the given order.

    The columns are ranked in each world, so worlds need no common scale. Ties get their mean rank.
    The alternative is one-sided: m₁ ≤ m₂ ≤ … ≤ m_k with at least one strict, for "increasing".

    Parameters
    ----------
    data : array_like (n_worlds, k)
        One row per world, one column per treatment, at least 2 by 3.
    direction : {"increasing", "decreasing"}
        Predicted order of the columns from left to right.

    Raises
    ------
    ValueError
        If the table is too small, a value is not finite (its index is named), or the direction is
        unknown.

    References
    ----------
    Page (1963), "Ordered hypotheses for multiple treatments".
    """
    table = check_table(data, "data", min_columns=3)
    ranks = np.arange(1, table.shape[1] + 1)
    if direction == "decreasing":
        ranks = ranks[::-1]
    elif direction != "increasing":
        raise ValueError(f"direction must be 'increasing' or 'decreasing', got {direction!r}")
    result = stats.page_trend_test(table, predicted_ranks=ranks)
    return TrendTestResult(statistic=float(result.statistic), p_value=float(result.pvalue))


def equivalence_test(
    values: ArrayLike,
    margin: float,
    rng: np.random.Generator,
    confidence: float = 0.95,
    n_resamples: int = 2000,
) -> EquivalenceResult:
    """Test whether the means of all columns are equal within a relative margin.

    A test that finds no difference does not show equality. Equivalence does: the ratio of each
    column's mean to the grand mean, and its whole interval, must lie in [1 - margin, 1 + margin].
    Worlds are resampled as rows, one draw for all columns.

    Parameters
    ----------
    values : array_like (n_worlds, k)
        One row per world, one column per treatment, at least 2 by 2. Every world's mean must be
        positive, because ratios to the grand mean are taken.
    margin : float
        Relative margin, in (0, 1).
    rng, confidence, n_resamples
        As in `bootstrap_mean`.

    Raises
    ------
    ValueError
        If the table is too small, a value is not finite (its index is named), a world's mean is
        not positive, or the margin is out of range.
    """
    if not 0 < margin < 1:
        raise ValueError(f"margin must lie in (0, 1), got {margin}")
    table = check_table(values, "values", min_columns=2)
    means = table.mean(axis=1)
    if np.any(means <= 0):
        world = int(np.argmax(means <= 0))
        raise ValueError(
            f"the mean of every world must be positive, that of values[{world}] is {means[world]}"
        )
    estimates, lows, highs = percentile_bootstrap(
        list(table.T), _ratios_to_grand_mean, rng, confidence, n_resamples, paired=True
    )
    ends = np.stack([estimates, lows, highs])
    return EquivalenceResult(
        equivalent=bool(np.all((ends >= 1 - margin) & (ends <= 1 + margin))),
        intervals=tuple(Interval(*map(float, column)) for column in ends.T),
        max_deviation=float(np.abs(ends - 1).max()),
    )


def _ratios_to_grand_mean(*columns: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    means = np.stack([column.mean(axis=axis) for column in columns])
    return means / means.mean(axis=0)
