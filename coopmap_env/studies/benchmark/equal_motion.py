"""Comparison at equal motion: a method and a sweep of planners that pay more or less for motion.

A sweep gives points (mean motion, mean score), one for each planner. Planners that another one
beats with less motion are left out; lines join the others in the order of motion. A point on a line
is what a mixture of its two planners reaches on average, one or the other by lot in each world.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.evaluation.statistics import Interval, training_runs

Array = NDArray[np.float64]


@dataclass(frozen=True)
class EqualMotion:
    """A method minus the planners of a sweep at the same mean motion."""

    motion: float
    """Mean motion of the planners, that of the method if the sweep reaches it."""
    planners_score: float
    """Their mean score there."""
    difference: Interval
    """Of the method's score from it."""
    is_equal: bool
    """Whether the planners move as much as the method. If not, the one with the best score counts,
    which moves less."""


def difference_at_equal_motion(
    scores: ArrayLike, motions: ArrayLike, sweep_scores: ArrayLike, sweep_motions: ArrayLike
) -> EqualMotion | None:
    """Difference between a method and a sweep of planners at the method's mean motion.

    The interpolation is linear in the means. Its interval is that of `mean_difference`, paired by
    world, for the interpolation linearised at the estimates (the delta method): with slope b and
    weight w between the planners i and j, ours is s - b m and theirs is
    (1 - w) (s_i - b m_i) + w (s_j - b m_j), world by world. Where the method moves more than the
    best planner, it is compared with that one (b = 0).

    Parameters
    ----------
    scores, motions : array_like (n_runs, n_worlds)
        Of the method.
    sweep_scores, sweep_motions : array_like (n_planners, n_worlds)
        Of the planners, on the same worlds.

    Returns
    -------
    EqualMotion, optional
        None if every planner moves more than the method.

    Raises
    ------
    ValueError
        As in `training_runs.mean_difference`.
    """
    ours, ours_motion, theirs, motion = (
        np.asarray(values, dtype=np.float64)
        for values in (scores, motions, sweep_scores, sweep_motions)
    )
    rows = undominated(theirs.mean(axis=1), motion.mean(axis=1))
    theirs, motion = theirs[rows], motion[rows]
    target, means = float(ours_motion.mean()), motion.mean(axis=1)
    if target < means[0]:
        return None
    above = int(np.searchsorted(means, target))
    if above == len(means):
        difference = training_runs.mean_difference(ours, theirs[-1:])
        return EqualMotion(float(means[-1]), float(theirs[-1].mean()), difference, False)
    below = max(above - 1, 0)
    run = means[above] - means[below]  # 0 only at the first planner, whose motion is the target
    weight = (target - means[below]) / run if run else 0.0
    slope = (theirs[above].mean() - theirs[below].mean()) / run if run else 0.0
    adjusted = theirs - slope * motion
    mixture = (1 - weight) * adjusted[below] + weight * adjusted[above]
    difference = training_runs.mean_difference(ours - slope * ours_motion, mixture[None])
    return EqualMotion(target, float(ours.mean()) - difference.estimate, difference, True)


def undominated(scores: Array, motions: Array) -> NDArray[np.int64]:
    """Indices of the points (n,) that no point of less motion equals in score, by motion."""
    chosen: list[int] = []
    for row in np.lexsort((-scores, motions)):
        if not chosen or scores[row] > scores[chosen[-1]]:
            chosen.append(int(row))
    return np.array(chosen)
