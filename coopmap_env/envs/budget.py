"""What is left of an episode: in beliefs as numbers, in observations and states as fractions."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

BUDGET_SIZE = 2
"""Values of the entry ``budget``."""


class Budget(NamedTuple):
    """What is left of an episode."""

    scans: int
    """Of each robot."""
    time: float = math.inf
    """Seconds on the clock of the team; infinite without ``max_time``."""


def budget_space() -> spaces.Box:
    """Make a new space of the entry ``budget`` of an observation: (2,) float32 in [0, 1]."""
    return spaces.Box(0.0, 1.0, (BUDGET_SIZE,), np.float32)


def budget_fractions(
    n_scans: ArrayLike, seconds: ArrayLike, max_scans: int, max_time: float | None
) -> NDArray[np.float32]:
    """The entry ``budget`` (..., 2): which fractions of the scans and of the time are left.

    Parameters
    ----------
    n_scans : int or ndarray (...)
        Scans of each robot so far.
    seconds : float or ndarray (...)
        Seconds on the clock of the team so far.
    max_scans : int
        Scans of each robot in an episode.
    max_time : float or None
        Seconds of an episode. None if time does not end it: then the fraction is 1.
    """
    scans = np.asarray(n_scans)
    left = np.ones((*scans.shape, BUDGET_SIZE), dtype=np.float32)
    left[..., 0] = (max_scans - scans) / max_scans
    if max_time is not None:
        left[..., 1] = np.maximum(max_time - np.asarray(seconds), 0.0) / max_time
    return left
