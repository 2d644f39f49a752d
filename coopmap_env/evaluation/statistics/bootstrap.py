"""Percentile bootstrap over worlds.

All policies are evaluated on the same worlds, so comparisons are paired: a resample draws worlds
and keeps what every policy did on a drawn world together. Intervals are percentile bootstrap
intervals, as in Agarwal et al. (2021), "Deep reinforcement learning at the edge of the statistical
precipice". Data that do not vary give an interval of zero width. For algorithms with several
training runs see `coopmap_env.evaluation.statistics.training_runs`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from coopmap_env.evaluation.statistics._samples import check_paired, check_per_world
from coopmap_env.evaluation.statistics.interval import Interval

Array = NDArray[Any]
Statistic = Callable[..., Any]
"""Reduces an array along its keyword `axis`, like ``np.mean``."""


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
    return _interval([check_per_world(values, "values")], np.mean, rng, confidence, n_resamples)


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
    first, second = check_paired(a, b)
    return _interval([first - second], statistic, rng, confidence, n_resamples)


def bootstrap_clusters(
    clusters: Sequence[ArrayLike],
    statistic: Callable[[NDArray[np.float64]], float],
    rng: np.random.Generator,
    confidence: float = 0.95,
    n_resamples: int = 2000,
) -> Interval:
    """Any statistic of rows that come in clusters, such as the scans of a world.

    Whole clusters are resampled, as the rows of a cluster are correlated.

    Parameters
    ----------
    clusters : sequence of array_like (rows, ...)
        Two or more; clusters without rows count too.
    statistic : callable
        Of all rows together. Resamples where it is NaN, having nothing to measure, are left out.
    rng : numpy.random.Generator
        Draws the resamples.

    Raises
    ------
    ValueError
        If there are fewer than two clusters.
    """
    arrays = [np.asarray(group, dtype=np.float64) for group in clusters]
    if len(arrays) < 2:
        raise ValueError(f"clusters must be at least 2, got {len(arrays)}")
    draws = rng.integers(len(arrays), size=(n_resamples, len(arrays)))
    resampled = [statistic(np.concatenate([arrays[i] for i in draw])) for draw in draws]
    tail = 50.0 * (1.0 - confidence)
    finite = np.array(resampled)[np.isfinite(resampled)]
    low, high = percentile_bounds(finite, tail) if len(finite) else (np.nan, np.nan)
    return Interval(float(statistic(np.concatenate(arrays))), float(low), float(high))


def interquartile_mean(values: ArrayLike) -> float:
    """Mean of the middle half: robust to outliers, and uses more of the data than the median.

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
    return float(stats.trim_mean(check_per_world(values, "values", min_size=1), 0.25))


def bootstrap_interquartile_mean(
    strata: Sequence[ArrayLike],
    rng: np.random.Generator,
    confidence: float = 0.95,
    n_resamples: int = 2000,
) -> Interval:
    """Interquartile mean of all strata pooled, with its stratified bootstrap interval.

    Each stratum is resampled separately, so every resample has as many worlds of each kind as the
    study.

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
    samples = [check_per_world(stratum, f"strata[{i}]") for i, stratum in enumerate(strata)]
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
    """Probability that a beats b on a world, P(a > b) + P(a = b)/2, with its bootstrap interval.

    Agarwal et al. compare every run of a with every run of b. Here both were evaluated on the same
    worlds, so each world is compared with itself. If all worlds agree, the interval has zero width:
    no resample can differ, although the probability is not known exactly.

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
    first, second = check_paired(a, b)
    wins = (first > second) + 0.5 * (first == second)
    return _interval([wins], np.mean, rng, confidence, n_resamples)


def _pooled_interquartile_mean(*strata: NDArray[np.float64], axis: int) -> Any:
    return stats.trim_mean(np.concatenate(strata, axis=axis), 0.25, axis=axis)


def _interval(
    samples: list[NDArray[np.float64]],
    statistic: Statistic,
    rng: np.random.Generator,
    confidence: float,
    n_resamples: int,
) -> Interval:
    estimate, low, high = percentile_bootstrap(samples, statistic, rng, confidence, n_resamples)
    return Interval(float(estimate), float(low), float(high))


def percentile_bounds(resampled: Array | Sequence[float], tail: float = 2.5) -> tuple[Any, Any]:
    """Low and high end of a percentile interval.

    Parameters
    ----------
    resampled : array_like (n_resamples, ...)
        A statistic of each resample.
    tail : float
        Percentage beyond each end; by default that of a 95 % interval.

    Returns
    -------
    low, high : ndarray (...)
    """
    low, high = np.percentile(resampled, [tail, 100.0 - tail], axis=0)
    return low, high


def percentile_bootstrap(
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
        # every resample equals the sample; computing them adds rounding errors
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
