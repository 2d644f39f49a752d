"""Log-odds in fixed point: integers, so that sums are exact and the order of scans is irrelevant.

One step is 1/1024 nat. Sums of integers are associative, which floating-point sums are not: fusing
the scans of a team in any order gives the same map, bit for bit. Probability and entropy come from
tables. The clamp is not a sum: it is applied once, after the scans of one team step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.caches import freeze
from coopmap_env.core.elementary import exp_array, log_array
from coopmap_env.core.settings import Bounds, Settings

STEPS_PER_NAT = 1024
"""Fixed-point steps of one nat: finer than any probability of the sensor model is known."""


def to_log_odds_fixed(probability: float) -> int:
    """Log-odds of a probability in (0, 1), rounded to fixed point."""
    return round(math.log(probability / (1.0 - probability)) * STEPS_PER_NAT)


FREE_PROBABILITY = 0.05
"""Occupancy below which a sampled cell is known to be free: robots may move through it (the paper's
2 sigma). To be seen through, it need only be more probably free than not: P < 1/2, log-odds below
0."""
FREE_LOG_ODDS_FIXED = to_log_odds_fixed(FREE_PROBABILITY)


@dataclass(frozen=True)
class LogOddsRange(Settings):
    """The range to which a map clamps its log-odds, and tables over it: probability and entropy.

    Raises
    ------
    ValueError
        If `max_probability` does not lie in (0.5, 1).
    """

    max_probability: Annotated[float, Bounds(above=0.5, below=1)] = 0.999
    """Highest P of a cell; the lowest is one minus it. With this clamp, one or two contradicting
    scans can still change a cell, and a wrong cell has a log loss of at most 6.9 nats."""

    @cached_property
    def clamp(self) -> int:
        """Highest log-odds in fixed point; the lowest is its negative."""
        return to_log_odds_fixed(self.max_probability)

    @cached_property
    def probability(self) -> NDArray[np.float64]:
        """Probability of log-odds l at index l + clamp."""
        log_odds_fixed = np.arange(-self.clamp, self.clamp + 1)
        return freeze(1.0 / (1.0 + exp_array(-log_odds_fixed / STEPS_PER_NAT)))

    @cached_property
    def entropy(self) -> NDArray[np.float64]:
        """Entropy (Eq. 6 of the two outcomes), nats, of log-odds l at index l + clamp."""
        p = self.probability
        return freeze(-p * log_array(p) - (1 - p) * log_array(1 - p))
