"""What is read off a sweep of the constants of the rating function."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from coopmap_env.evaluation import BOOTSTRAP_SEED
from coopmap_env.evaluation.statistics import Interval, bootstrap_paired_difference
from coopmap_env.information import RatingSettings

GOOD_ENOUGH = 0.98
"""Area under the coverage curve of a K that is large enough, as a fraction of the best one's."""


@dataclass(frozen=True, eq=False)
class Trial:
    """Scores of one set of constants on each world."""

    constants: RatingSettings
    area: NDArray[np.float64]
    """Area under the coverage curve of each world, as a fraction."""
    motion: NDArray[np.float64]
    """d of Eq. 5, summed over an episode, of each world."""


def best_area(trials: list[Trial]) -> Trial:
    """The trial with the largest mean area."""
    return max(trials, key=lambda trial: float(trial.area.mean()))


def largest_good(trials: list[Trial]) -> Trial:
    """The trial of the largest K whose mean area is at least `GOOD_ENOUGH` of the best one's."""
    limit = GOOD_ENOUGH * best_area(trials).area.mean()
    good = [trial for trial in trials if trial.area.mean() >= limit]
    return max(good, key=lambda trial: trial.constants.K)


def area_at_motion(trials: list[Trial], motion: float) -> NDArray[np.float64] | None:
    """Area of each world at a mean motion, between the two trials of a sweep of K next to it.

    Linear in the mean motion. None if the sweep does not reach the motion from both sides.
    """
    ordered = sorted(trials, key=lambda trial: float(trial.motion.mean()))
    for less, more in pairwise(ordered):
        low, high = float(less.motion.mean()), float(more.motion.mean())
        if low <= motion <= high and low < high:
            weight = (motion - low) / (high - low)
            return np.asarray((1 - weight) * less.area + weight * more.area)
    return None


def difference(area: NDArray[np.float64], reference: NDArray[np.float64]) -> Interval:
    """Mean difference on the same worlds, with its paired 95 % bootstrap interval."""
    rng = np.random.default_rng(BOOTSTRAP_SEED)
    return bootstrap_paired_difference(area, reference, rng)
