"""How far our Table 1 is from the paper's: the mean absolute relative deviation of 18 numbers."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.evaluation.statistics import Interval, percentile_bounds
from coopmap_env.studies.section3.setting import PAPER_TABLE_1

PAPER_NUMBERS = np.array(list(PAPER_TABLE_1.values()))
"""Shape (n_searches, 3)."""


def relative_deviations(means: ArrayLike) -> NDArray[np.float64]:
    """Ours over the paper's, minus 1, of mean scores (..., n_searches, 3); the same shape."""
    ratios: NDArray[np.float64] = np.asarray(means, dtype=np.float64) / PAPER_NUMBERS
    return ratios - 1.0


def mean_deviation(means: ArrayLike) -> NDArray[np.float64]:
    """Mean absolute relative deviation of mean scores (..., n_searches, 3); shape (...)."""
    deviation: NDArray[np.float64] = np.abs(relative_deviations(means)).mean(axis=(-2, -1))
    return deviation


def deviation_interval(
    scores: ArrayLike, rng: np.random.Generator, n_resamples: int = 2000
) -> Interval:
    """Mean deviation of the means over worlds, with its 95 % bootstrap interval.

    Noise moves single numbers away from the paper's and towards it, and away counts as much as
    towards only far from zero: so the interval of a good table lies a little too high.

    Parameters
    ----------
    scores : array_like (n_worlds, n_searches, 3)
        Of the same worlds for all searches: a resample draws worlds.
    rng : numpy.random.Generator
        Draws the resamples.
    n_resamples : int
    """
    values = np.asarray(scores, dtype=np.float64)
    draws = rng.integers(len(values), size=(n_resamples, len(values)))
    resampled = [float(mean_deviation(values[draw].mean(axis=0))) for draw in draws]
    low, high = percentile_bounds(resampled)
    return Interval(float(mean_deviation(values.mean(axis=0))), float(low), float(high))
