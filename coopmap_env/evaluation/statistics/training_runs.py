"""Statistics over worlds and training runs, of learned policies and planners on the same worlds.

The scores of an algorithm are a matrix (n_runs, n_worlds) with a row for each training run. A
planner is not trained and has one row. A bootstrap resample

- draws worlds with replacement, once for all algorithms. So a comparison stays paired, and a
  planner's interval is the uncertainty due to the worlds;
- draws training runs of each algorithm with replacement, once for all worlds. Agarwal et al. (2021)
  draw other runs for each task, because each of their runs was trained on one task. Here every run
  is evaluated on all worlds; with other runs for each world, the variance of training would average
  out;
- draws n - 1 of n runs (Rao and Wu 1988): a mean of n draws from n runs has only (n - 1)/n of the
  true variance, a third too little with three runs. All n worlds are drawn, as they are many.

Resampling rows and columns is Owen's (2007) pigeonhole bootstrap. Its intervals over worlds are
conservative. Few training runs carry little information: where runs differ more than worlds, the
interval of three runs is the range of their means, which contains the true mean in three of four
cases. So reports also give the mean of each run, and verdicts use t intervals, those of
`mean_difference`.

Intervals are percentiles of the resamples. The same generator state draws the same worlds for every
statistic over equally many worlds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from coopmap_env.evaluation.statistics._samples import check_finite
from coopmap_env.evaluation.statistics.bootstrap import percentile_bounds
from coopmap_env.evaluation.statistics.interval import Interval

Array = NDArray[Any]
Statistic = Callable[..., Array]
"""Reduces arrays (n_resamples, n_runs, n_worlds, ...) to (n_resamples, ...)."""
N_RESAMPLES = 2000
"""Resamples for a number: 50 of them lie beyond each end of a 95 % interval."""
N_BAND_RESAMPLES = 500
"""Resamples for a curve, whose bands are drawn and not quoted."""


@dataclass(frozen=True)
class ConfidenceBand:
    """A curve and its pointwise confidence intervals, each of shape (n,)."""

    estimate: Array
    low: Array
    high: Array

    def as_dict(self) -> dict[str, list[float]]:
        """Lists by name, ready for JSON."""
        return {name: getattr(self, name).tolist() for name in ("estimate", "low", "high")}


def mean(scores: ArrayLike, rng: np.random.Generator, n_resamples: int = N_RESAMPLES) -> Interval:
    """Mean over runs and worlds with its 95 % interval.

    Parameters
    ----------
    scores : array_like (n_runs, n_worlds)
        One run or more, two worlds or more.
    rng : numpy.random.Generator
        Draws the resamples.
    n_resamples : int
        Bootstrap resamples.

    Raises
    ------
    ValueError
        If the matrix is too small, or a value is not finite (its index is named).
    """
    return _interval([_check_scores(scores, "scores")], _mean, rng, n_resamples)


def interquartile_mean(
    scores: ArrayLike, rng: np.random.Generator, n_resamples: int = N_RESAMPLES
) -> Interval:
    """Mean of the middle half of all scores, runs and worlds together; otherwise as `mean`."""
    return _interval([_check_scores(scores, "scores")], _interquartile_mean, rng, n_resamples)


def mean_difference(ours: ArrayLike, theirs: ArrayLike) -> Interval:
    """Mean of ours minus mean of theirs, paired by world, with its 95 % t interval.

    Verdicts use this interval, as the bootstrap's is too narrow with few runs. The variance has two
    parts: that of the mean difference over worlds (all runs together), and for each algorithm that
    of its mean over runs. The degrees of freedom are Welch-Satterthwaite's. The interaction of runs
    and worlds counts in both parts, so the interval is conservative.

    Parameters
    ----------
    ours, theirs : array_like (n_runs, n_worlds)
        Two algorithms on the same worlds, in the same order; the numbers of runs may differ.

    Raises
    ------
    ValueError
        As in `mean`, or if the numbers of worlds differ.
    """
    pair = _check_paired(ours, theirs)
    by_world = pair[0].mean(axis=0) - pair[1].mean(axis=0)
    samples = [by_world, *(scores.mean(axis=1) for scores in pair if len(scores) > 1)]
    parts = np.array([sample.var(ddof=1) / len(sample) for sample in samples])
    degrees_of_freedom = np.array([len(sample) - 1 for sample in samples])
    estimate, variance = float(by_world.mean()), float(parts.sum())
    if variance == 0:
        return Interval(estimate, estimate, estimate)
    total_freedom = variance**2 / (parts**2 / degrees_of_freedom).sum()
    half_width = stats.t.ppf(0.975, total_freedom) * np.sqrt(variance)
    return Interval(estimate, float(estimate - half_width), float(estimate + half_width))


def ratio_of_means(
    ours: ArrayLike,
    theirs: ArrayLike,
    rng: np.random.Generator,
    n_resamples: int = N_RESAMPLES,
) -> Interval:
    """Mean of ours divided by mean of theirs, paired by world; theirs must be positive."""
    pair = _check_paired(ours, theirs)
    if (pair[1] <= 0).any():
        raise ValueError(f"the denominators of a ratio must be positive, got {pair[1].min()}")
    return _interval(pair, lambda a, b: _mean(a) / _mean(b), rng, n_resamples)


def probability_of_improvement(
    ours: ArrayLike,
    theirs: ArrayLike,
    rng: np.random.Generator,
    n_resamples: int = N_RESAMPLES,
) -> Interval:
    """Probability that a run of ours beats a run of theirs on a world; a tie counts as half.

    Every run is compared with every run of the other algorithm, on the same world.
    """
    return _interval(_check_paired(ours, theirs), _improvement, rng, n_resamples)


def mean_curve(
    curves: ArrayLike, rng: np.random.Generator, n_resamples: int = N_BAND_RESAMPLES
) -> ConfidenceBand:
    """Mean of curves over runs and worlds with its pointwise 95 % band.

    Parameters
    ----------
    curves : array_like (n_runs, n_worlds, n)
        A curve for each run and world.
    rng, n_resamples
        As in `mean`.

    Raises
    ------
    ValueError
        As in `mean`.
    """
    values = _check_scores(curves, "curves", n_axes=3)
    return ConfidenceBand(*_bootstrap([values], _mean, rng, n_resamples))


def performance_profile(
    scores: ArrayLike,
    thresholds: ArrayLike,
    rng: np.random.Generator,
    n_resamples: int = N_BAND_RESAMPLES,
) -> ConfidenceBand:
    """Fraction of runs and worlds with a score above each threshold, with its pointwise 95 % band.

    Parameters
    ----------
    scores : array_like (n_runs, n_worlds)
    thresholds : array_like (n,)
    rng, n_resamples
        As in `mean`.

    Raises
    ------
    ValueError
        As in `mean`.
    """
    above = _check_scores(scores, "scores")[..., None] > np.asarray(thresholds, dtype=np.float64)
    return ConfidenceBand(*_bootstrap([above], _mean, rng, n_resamples))


def resample(samples: Sequence[Array], rng: np.random.Generator, n_resamples: int) -> list[Array]:
    """Resamples of the scores of algorithms on the same worlds; see the module.

    Parameters
    ----------
    samples : sequence of arrays (n_runs_i, n_worlds, ...)
    rng : numpy.random.Generator
    n_resamples : int

    Returns
    -------
    list of arrays (n_resamples, max(n_runs_i - 1, 1), n_worlds, ...)
    """
    n_worlds = samples[0].shape[1]
    worlds = rng.integers(n_worlds, size=(n_resamples, 1, n_worlds))
    resampled = []
    for sample in samples:
        n_drawn = max(len(sample) - 1, 1)
        runs = rng.integers(len(sample), size=(n_resamples, n_drawn, 1))
        resampled.append(sample[runs, worlds])
    return resampled


def _mean(values: Array) -> Array:
    return np.asarray(values.mean(axis=(1, 2)))


def _interquartile_mean(values: Array) -> Array:
    return np.asarray(stats.trim_mean(values.reshape(len(values), -1), 0.25, axis=1))


def _improvement(ours: Array, theirs: Array) -> Array:
    a, b = ours[:, :, None], theirs[:, None]
    return np.asarray(((a > b) + 0.5 * (a == b)).mean(axis=(1, 2, 3)))


def _interval(
    samples: list[Array], statistic: Statistic, rng: np.random.Generator, n_resamples: int
) -> Interval:
    return Interval(*map(float, _bootstrap(samples, statistic, rng, n_resamples)))


def _bootstrap(
    samples: list[Array], statistic: Statistic, rng: np.random.Generator, n_resamples: int
) -> tuple[Array, Array, Array]:
    """Estimate, low and high end."""
    if n_resamples < 1:
        raise ValueError(f"n_resamples must be at least 1, got {n_resamples}")
    estimate = statistic(*(sample[None] for sample in samples))[0]
    resampled = statistic(*resample(samples, rng, n_resamples))
    return estimate, *percentile_bounds(resampled)


def _check_paired(ours: ArrayLike, theirs: ArrayLike) -> list[Array]:
    a, b = _check_scores(ours, "ours"), _check_scores(theirs, "theirs")
    if a.shape[1] != b.shape[1]:
        raise ValueError(
            f"ours and theirs must cover the same worlds, got {a.shape[1]} and {b.shape[1]} of them"
        )
    return [a, b]


def _check_scores(values: ArrayLike, name: str, n_axes: int = 2) -> Array:
    """Check finite scores of one run or more on two worlds or more."""
    array = np.asarray(values, dtype=np.float64)
    if array.ndim != n_axes:
        wanted = "(n_runs, n_worlds)" if n_axes == 2 else "(n_runs, n_worlds, n)"
        raise ValueError(f"{name} must have the axes {wanted}, got shape {array.shape}")
    if array.shape[0] < 1 or array.shape[1] < 2:
        raise ValueError(
            f"{name} needs at least 1 run and 2 worlds, got {array.shape[0]} and {array.shape[1]}"
        )
    check_finite(array, name)
    return array
