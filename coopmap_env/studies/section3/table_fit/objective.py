"""What the search minimises: deviation from the paper's numbers, and T1 and T2 as constraints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.studies.section3.deviation import mean_deviation
from coopmap_env.studies.section3.setting import PAPER_OBSERVED, RASTER, SEARCHES

OBSERVED_TOLERANCE = 0.1
"""Relative difference of the mean observed fraction from the paper's that costs nothing."""
EQUAL_TOLERANCE = 0.1
"""T1 on few worlds: a search's observed fraction may lie this far from the mean of all. The
verdict allows 0.15, intervals included."""
RASTER_TOLERANCE = 0.68
"""T2 on few worlds; the verdict allows 0.75, its interval included."""


@dataclass(frozen=True)
class Fit:
    """How some constants fit the table; numbers, or arrays (...) of many tables."""

    deviation: Any
    """Mean absolute relative deviation from the paper's 18 numbers."""
    observed: Any
    """Observed fraction, mean of all searches but the raster scan."""
    unequal: Any
    """T1: largest relative distance of a search's observed fraction from their mean."""
    raster: Any
    """T2: observed fraction of the raster scan over the smallest of the searches."""

    @classmethod
    def from_means(cls, means: Mapping[Any, NDArray[np.float64]]) -> Fit:
        """The fit of the mean columns (..., 4) of each search, as `episodes.COLUMNS` names them."""
        table = np.stack([means[search] for search in SEARCHES], axis=-2)
        observed = table[..., 3]
        mean = observed.mean(axis=-1)
        return cls(
            deviation=mean_deviation(table[..., :3]),
            observed=mean,
            unequal=np.abs(observed / mean[..., None] - 1.0).max(axis=-1),
            raster=means[RASTER][..., 3] / observed.min(axis=-1),
        )

    @property
    def missed(self) -> dict[str, Any]:
        """By constraint, what it is missed by; 0 if it is kept."""
        missed = {
            "observed": np.abs(self.observed / PAPER_OBSERVED - 1.0) - OBSERVED_TOLERANCE,
            "unequal": self.unequal - EQUAL_TOLERANCE,
            "raster": self.raster - RASTER_TOLERANCE,
        }
        return {name: np.maximum(one, 0.0) for name, one in missed.items()}

    @property
    def penalty(self) -> Any:
        """Sum of what the constraints are missed by."""
        return sum(self.missed.values())

    @property
    def value(self) -> Any:
        """What the search minimises."""
        return self.deviation + self.penalty

    def as_dict(self) -> dict[str, float]:
        """The numbers of one table, as JSON values."""
        return {name: float(value) for name, value in vars(self).items()}
