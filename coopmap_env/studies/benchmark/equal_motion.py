"""Comparison at equal motion: a method and a line of planners that pay more or less for motion.

A sweep gives points (mean motion, mean score), one for each planner. What a mixture of two planners
reaches on average, one or the other by lot in each world, is a point on the line between them. So
the strongest opponents of a sweep are its upper concave hull (`concave_hull`): no mixture of other
planners has a larger score with as much motion.

The planners of the hull are chosen on training worlds. Chosen on the worlds of the comparison, they
would be those that had luck there, and beat an equal method far too often.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.evaluation.statistics import Interval, training_runs

Array = NDArray[np.float64]


@dataclass(frozen=True)
class EqualMotion:
    """A method minus the planners of a line at the same mean motion."""

    motion: float
    """Mean motion of the planners, that of the method if the line reaches it."""
    planners_score: float
    """Their mean score there."""
    difference: Interval
    """Of the method's score from it."""
    is_equal: bool
    """Whether the planners move as much as the method. If not, the one that has the best score on
    training worlds counts, which moves less."""


def difference_at_equal_motion(
    scores: ArrayLike, motions: ArrayLike, line_scores: ArrayLike, line_motions: ArrayLike
) -> EqualMotion | None:
    """Difference between a method and a line of planners at the method's mean motion.

    The interpolation is linear in the means, between the planners that are next to each other by
    their mean motion. Its interval is that of `mean_difference`, paired by world, for the
    interpolation linearised at the estimates (the delta method): with slope b and weight w between
    the planners i and j, ours is s - b m and theirs is (1 - w) (s_i - b m_i) + w (s_j - b m_j),
    world by world. Where the method moves more than all planners, it is compared with the last one
    (b = 0).

    Parameters
    ----------
    scores, motions : array_like (n_runs, n_worlds)
        Of the method.
    line_scores, line_motions : array_like (n_planners, n_worlds)
        Of the planners, on the same worlds. Other worlds have chosen them; the last one has the
        largest score there.

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
        for values in (scores, motions, line_scores, line_motions)
    )
    means, target = motion.mean(axis=1), float(ours_motion.mean())
    if target < means.min():
        return None
    if target > means.max():
        difference = training_runs.mean_difference(ours, theirs[-1:])
        return EqualMotion(float(means[-1]), float(theirs[-1].mean()), difference, False)
    order = np.argsort(means, kind="stable")
    place = int(np.searchsorted(means[order], target))
    below, above = order[max(place - 1, 0)], order[place]
    run = means[above] - means[below]  # 0 only at the first planner, whose motion is the target
    weight = (target - means[below]) / run if run else 0.0
    slope = (theirs[above].mean() - theirs[below].mean()) / run if run else 0.0
    adjusted = theirs - slope * motion
    mixture = (1 - weight) * adjusted[below] + weight * adjusted[above]
    difference = training_runs.mean_difference(ours - slope * ours_motion, mixture[None])
    return EqualMotion(target, float(ours.mean()) - difference.estimate, difference, True)


def concave_hull(scores: ArrayLike, motions: ArrayLike) -> list[int]:
    """Indices of the points (n,) of the upper concave hull, from least motion to best score.

    No mixture of the points has a larger score with as much motion or less.
    """
    score, motion = (np.asarray(values, dtype=np.float64) for values in (scores, motions))
    hull: list[int] = []
    for row in map(int, np.lexsort((-score, motion))):
        if hull and score[row] <= score[hull[-1]]:
            continue
        while len(hull) > 1 and _is_on_or_below(score, motion, hull[-2], hull[-1], row):
            hull.pop()
        hull.append(row)
    return hull


def _is_on_or_below(score: Array, motion: Array, left: int, middle: int, right: int) -> bool:
    """Whether the middle point is on the line between its neighbours, or below it."""
    rise, run = score[right] - score[left], motion[right] - motion[left]
    return bool((score[middle] - score[left]) * run <= rise * (motion[middle] - motion[left]))
