"""Statistics of a comparison: how sure the numbers over a set of worlds are.

Policies run on the same worlds, so comparisons are paired: a bootstrap resamples worlds and keeps
what every policy did on a drawn world together. Intervals are percentile bootstrap intervals, as
in Agarwal et al. (2021), "Deep reinforcement learning at the edge of the statistical precipice".
Data that do not vary give an interval of zero width. Algorithms with several training runs are the
matter of `evaluation.run_statistics`.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

Statistic = Callable[..., Any]
"""Reduces an array along its keyword `axis`, like ``np.mean``."""


@dataclass(frozen=True)
class Interval:
    """An estimate and its confidence interval.

    ``str(interval)`` reads "9.12 [8.90, 9.33]"; ``f"{interval:.3f}"`` sets the digits.
    """

    estimate: float
    low: float
    high: float

    def __format__(self, spec: str) -> str:
        spec = spec or ".2f"
        return f"{self.estimate:{spec}} [{self.low:{spec}}, {self.high:{spec}}]"

    def __str__(self) -> str:
        return format(self, "")

    def as_dict(self) -> dict[str, float]:
        """Return estimate, low and high by name, ready for JSON."""
        return asdict(self)


@dataclass(frozen=True)
class TrendTestResult:
    """Result of Page's trend test."""

    statistic: float
    """Page's L: sum over columns of predicted rank times rank sum."""
    p_value: float
    """Chance of an L at least this large if the columns do not differ."""


@dataclass(frozen=True)
class EquivalenceResult:
    """Whether the columns of a table have about the same mean."""

    equivalent: bool
    """Every column's ratio and its interval lie within 1 ± margin."""
    intervals: tuple[Interval, ...]
    """Column mean over grand mean, one for each column."""
    max_deviation: float
    """Largest distance from 1 of any ratio or interval end: the smallest margin that holds."""


def bootstrap_mean(
    values: ArrayLike,
    rng: np.random.Generator,
    confidence: float = 0.95,
    n_resamples: int = 2000,
) -> Interval:
    """Mean over worlds with its bootstrap interval.

    Parameters
    ----------
    values : array_like (n_worlds,)
        One number per world, two or more.
    rng : numpy.random.Generator
        Draws the resamples.
    confidence : float
        Level of the interval, in (0, 1).
    n_resamples : int
        Bootstrap resamples.

    Raises
    ------
    ValueError
        If there are fewer than two worlds, or a value is not finite (its index is named).
    """
    return _interval([_check_per_world(values, "values")], np.mean, rng, confidence, n_resamples)


def bootstrap_paired_difference(
    a: ArrayLike,
    b: ArrayLike,
    rng: np.random.Generator,
    statistic: Statistic = np.mean,
    confidence: float = 0.95,
    n_resamples: int = 2000,
) -> Interval:
    """Statistic of the differences a - b, world by world, with its bootstrap interval.

    Parameters
    ----------
    a, b : array_like (n_worlds,)
        Two policies on the same worlds, in the same order.
    rng, confidence, n_resamples
        As in `bootstrap_mean`.
    statistic : callable
        Reduces the differences along its keyword ``axis``: ``np.mean``, ``np.median``.

    Raises
    ------
    ValueError
        As in `bootstrap_mean`, or if the lengths differ.
    """
    first, second = _check_paired(a, b)
    return _interval([first - second], statistic, rng, confidence, n_resamples)


def bootstrap_clusters(
    clusters: Sequence[ArrayLike],
    statistic: Callable[[NDArray[np.float64]], float],
    rng: np.random.Generator,
    confidence: float = 0.95,
    n_resamples: int = 2000,
) -> Interval:
    """Any statistic of rows that come in groups, such as the looks of a world.

    Groups are resampled as a whole: the rows of one have more in common than with others.

    Parameters
    ----------
    clusters : sequence of array_like (rows, ...)
        Two or more; groups without rows count too.
    statistic : callable
        Of all rows together; where it is NaN (a resample that holds nothing to measure) the
        resample is left out.
    rng : numpy.random.Generator
        Draws the resamples.

    Raises
    ------
    ValueError
        If there are fewer than two groups.
    """
    arrays = [np.asarray(group, dtype=np.float64) for group in clusters]
    if len(arrays) < 2:
        raise ValueError(f"clusters must be at least 2, got {len(arrays)}")
    draws = rng.integers(len(arrays), size=(n_resamples, len(arrays)))
    resampled = [statistic(np.concatenate([arrays[i] for i in draw])) for draw in draws]
    tail = 50.0 * (1.0 - confidence)
    known = np.array(resampled)[np.isfinite(resampled)]
    low, high = np.percentile(known, [tail, 100.0 - tail]) if len(known) else (np.nan, np.nan)
    return Interval(float(statistic(np.concatenate(arrays))), float(low), float(high))


def interquartile_mean(values: ArrayLike) -> float:
    """Mean of the middle half: robust to outliers, yet uses more of the data than the median.

    A quarter of the n values, rounded down, is cut from each end.

    Parameters
    ----------
    values : array_like (n,)
        One or more numbers.

    Raises
    ------
    ValueError
        If there is no value, or one is not finite (its index is named).
    """
    return float(stats.trim_mean(_check_per_world(values, "values", min_size=1), 0.25))


def bootstrap_interquartile_mean(
    strata: Sequence[ArrayLike],
    rng: np.random.Generator,
    confidence: float = 0.95,
    n_resamples: int = 2000,
) -> Interval:
    """Interquartile mean of all strata pooled, with its stratified bootstrap interval.

    Each stratum is resampled on its own, so every resample holds as many worlds of each kind as
    the study did.

    Parameters
    ----------
    strata : sequence of array_like (n_i,)
        One array per kind of world, of two or more worlds each; lengths may differ.
    rng, confidence, n_resamples
        As in `bootstrap_mean`.

    Raises
    ------
    ValueError
        As in `bootstrap_mean` for any stratum, or if there is none.
    """
    samples = [_check_per_world(stratum, f"strata[{i}]") for i, stratum in enumerate(strata)]
    if not samples:
        raise ValueError("strata must hold at least 1 array, got none")
    return _interval(samples, _pooled_interquartile_mean, rng, confidence, n_resamples)


def probability_of_improvement(
    a: ArrayLike,
    b: ArrayLike,
    rng: np.random.Generator,
    confidence: float = 0.95,
    n_resamples: int = 2000,
) -> Interval:
    """Chance that a beats b on a world: P(a > b) + P(a = b)/2, with its bootstrap interval.

    Agarwal et al. compare every run of a with every run of b; here a and b met the same worlds, so
    each world is compared with itself. Worlds that all agree give an interval of zero width, which
    says that no resample could differ and not that the chance is known exactly.

    Parameters
    ----------
    a, b : array_like (n_worlds,)
        Two policies on the same worlds, in the same order; larger is better.
    rng, confidence, n_resamples
        As in `bootstrap_mean`.

    Raises
    ------
    ValueError
        As in `bootstrap_mean`, or if the lengths differ.
    """
    first, second = _check_paired(a, b)
    wins = (first > second) + 0.5 * (first == second)
    return _interval([wins], np.mean, rng, confidence, n_resamples)


def page_trend_test(
    data: ArrayLike, direction: Literal["increasing", "decreasing"] = "increasing"
) -> TrendTestResult:
    """Test whether the columns rise (or fall) in the order given, by Page's trend test.

    Each world ranks the columns, so worlds need not share a scale; ties get their mean rank. The
    alternative is one-sided: m₁ ≤ m₂ ≤ … ≤ m_k with at least one strict, for "increasing".

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
    table = _check_table(data, "data", min_columns=3)
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
    """Test whether all columns have the same mean, give or take a relative margin.

    Failing to find a difference is no proof of sameness. This asks for proof: each column's mean
    over the grand mean must lie in [1 - margin, 1 + margin] together with its whole interval.
    Worlds are resampled as rows, one draw for all columns.

    Parameters
    ----------
    values : array_like (n_worlds, k)
        One row per world, one column per treatment, at least 2 by 2. Every world's mean must be
        positive, or a ratio to the grand mean says nothing.
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
    table = _check_table(values, "values", min_columns=2)
    means = table.mean(axis=1)
    if np.any(means <= 0):
        world = int(np.argmax(means <= 0))
        raise ValueError(
            f"the mean of every world must be positive, that of values[{world}] is {means[world]}"
        )
    estimates, lows, highs = _bootstrap(
        list(table.T), _ratios_to_grand_mean, rng, confidence, n_resamples, paired=True
    )
    ends = np.stack([estimates, lows, highs])
    return EquivalenceResult(
        equivalent=bool(np.all((ends >= 1 - margin) & (ends <= 1 + margin))),
        intervals=tuple(Interval(*map(float, column)) for column in ends.T),
        max_deviation=float(np.abs(ends - 1).max()),
    )


def _pooled_interquartile_mean(*strata: NDArray[np.float64], axis: int) -> Any:
    return stats.trim_mean(np.concatenate(strata, axis=axis), 0.25, axis=axis)


def _ratios_to_grand_mean(*columns: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    means = np.stack([column.mean(axis=axis) for column in columns])
    return means / means.mean(axis=0)


def _interval(
    samples: list[NDArray[np.float64]],
    statistic: Statistic,
    rng: np.random.Generator,
    confidence: float,
    n_resamples: int,
) -> Interval:
    estimate, low, high = _bootstrap(samples, statistic, rng, confidence, n_resamples)
    return Interval(float(estimate), float(low), float(high))


def _bootstrap(
    samples: list[NDArray[np.float64]],
    statistic: Statistic,
    rng: np.random.Generator,
    confidence: float,
    n_resamples: int,
    paired: bool = False,
) -> tuple[Any, Any, Any]:
    """Estimate, low and high end of a percentile bootstrap over one or several samples."""
    if not 0 < confidence < 1:
        raise ValueError(f"confidence must lie in (0, 1), got {confidence}")
    if n_resamples < 1:
        raise ValueError(f"n_resamples must be at least 1, got {n_resamples}")
    estimate = statistic(*samples, axis=-1)
    if all(np.all(sample == sample[0]) for sample in samples):
        # every resample is the sample; computing them would add rounding
        return estimate, estimate, estimate
    interval = stats.bootstrap(
        samples,
        statistic,
        n_resamples=n_resamples,
        confidence_level=confidence,
        method="percentile",
        paired=paired,
        vectorized=True,
        random_state=rng,  # the name that every scipy since 1.13 knows
    ).confidence_interval
    return estimate, interval.low, interval.high


def _check_paired(a: ArrayLike, b: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    first, second = _check_per_world(a, "a"), _check_per_world(b, "b")
    if first.shape != second.shape:
        raise ValueError(
            f"a and b must cover the same worlds, got {first.size} and {second.size} of them"
        )
    return first, second


def _check_per_world(values: ArrayLike, name: str, min_size: int = 2) -> NDArray[np.float64]:
    """Check one finite number per world, as a (n_worlds,) array."""
    array = np.asarray(values, dtype=np.float64)
    if array.ndim != 1:
        raise ValueError(f"{name} must have one axis (n_worlds,), got shape {array.shape}")
    if array.size < min_size:
        raise ValueError(f"{name} needs at least {min_size} worlds, got {array.size}")
    check_finite(array, name)
    return array


def _check_table(values: ArrayLike, name: str, min_columns: int) -> NDArray[np.float64]:
    """Check a finite table with a row per world, as a (n_worlds, k) array."""
    array = np.asarray(values, dtype=np.float64)
    if array.ndim != 2:
        raise ValueError(f"{name} must have two axes (n_worlds, k), got shape {array.shape}")
    if array.shape[0] < 2:
        raise ValueError(f"{name} needs at least 2 worlds (rows), got {array.shape[0]}")
    if array.shape[1] < min_columns:
        raise ValueError(f"{name} needs at least {min_columns} columns, got {array.shape[1]}")
    check_finite(array, name)
    return array


def check_finite(array: NDArray[np.float64], name: str) -> None:
    """ValueError with the index of the first value that is not finite, if there is one."""
    bad = np.argwhere(~np.isfinite(array))
    if bad.size:
        index = tuple(int(i) for i in bad[0])
        index_text = ", ".join(map(str, index))
        raise ValueError(f"{name}[{index_text}] is {array[index]}, every value must be finite")
