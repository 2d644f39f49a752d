"""Constants of the rating function, of Eqs. 5 to 9."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np

from coopmap_env.information.gray import Interpretation


@dataclass(frozen=True)
class RatingConstants:
    """Constants of Eqs. 6 to 9, which any rating needs; those of Eq. 5 depend on the mount.

    Raises
    ------
    ValueError
        If a value is outside of its range.
    """

    K: float
    """Weight of the motion, nats per unit of d**n."""
    exponent: float = 1.0
    """n of Eq. 9."""
    n_gray_bins: int = 64
    """Bins over the gray levels [0, 2] (Eq. 7): half of them tell unknown cells apart by
    distance, in steps of less than one cell in the plane, of less than two in space."""
    interpretation: Interpretation = "literal"
    """Of Eq. 8a: with the distance as printed, or distance free."""

    def __post_init__(self) -> None:
        kind = type(self).__name__
        for name in (field.name for field in fields(self)):
            value = getattr(self, name)
            if name in ("n_gray_bins", "interpretation"):
                continue
            if not (math.isfinite(value) and value >= 0):
                raise ValueError(f"{kind}.{name} must be finite and >= 0, got {value}")
        if not (isinstance(self.n_gray_bins, int | np.integer) and 2 <= self.n_gray_bins <= 256):
            raise ValueError(
                f"{kind}.n_gray_bins must be a whole number in 2 ... 256, got {self.n_gray_bins}"
            )
        if self.interpretation not in ("literal", "distance_free"):
            raise ValueError(
                f"{kind}.interpretation is 'literal' or 'distance_free', got {self.interpretation!r}"
            )


@dataclass(frozen=True)
class RatingSettings(RatingConstants):
    """Constants of Eqs. 5 to 9 in the plane.

    Raises
    ------
    ValueError
        If a value is outside of its range.
    """

    K: float = 0.2
    """Weight of the motion, nats per unit of d**n. Chosen on 150 training worlds: the trends of the
    paper's Section 3 hold. NI is at most ln(n_gray_bins), so 20 m of motion are hardly ever worth it."""
    alpha_position: float = 1.0
    """Weight of squared metres in Eq. 5."""
    alpha_heading: float = 0.0
    """Weight of squared radians in Eq. 5: turning a camera on its mount costs next to nothing."""


@dataclass(frozen=True)
class FieldRatingSettings(RatingConstants):
    """Constants of Eqs. 6 to 9 in space; the alphas of Eq. 5 are those of the mount's joints.

    Raises
    ------
    ValueError
        If a value is outside of its range.
    """

    K: float = 0.1
    """Weight of the motion, nats per unit of d**n. Chosen on 8 training worksites: the area under
    the surface coverage curve is that of K = 0 and 0.05, with two thirds of the motion of 0."""
