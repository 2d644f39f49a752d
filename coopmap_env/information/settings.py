"""Constants of the rating functions, Eqs. 5 to 9."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from coopmap_env.core.settings import Bounds, NonNegative, Settings

Interpretation = Literal["literal", "distance_free"]
"""Readings of Eq. 8a."""
Hidden = Literal["empty", "printed"]
"""Readings of Eq. 7."""


@dataclass(frozen=True)
class RatingSettings(Settings):
    """Constants of Eqs. 6 to 9, which every rating needs; those of Eq. 5 depend on the mount.

    Raises
    ------
    ValueError
        If a value is outside of its range.
    """

    K: NonNegative
    """Weight of the motion, nats per unit of d**n."""
    exponent: Annotated[float, Bounds(at_least=0, largest=10)] = 1.0
    """n of Eq. 9."""
    n_gray_bins: Annotated[int, Bounds(at_least=2, at_most=256)] = 64
    """Bins over the gray levels [0, 2] (Eq. 7). Half of them tell unknown cells apart by their
    distance, in steps of less than one cell in 2-D and of less than two in 3-D."""
    interpretation: Interpretation = "distance_free"
    """Interpretation of Eq. 8a: without the distance, or with it as printed ("literal"). As
    printed, from two voxels on a voxel with p = 0.49 counts like one with p = 0.001."""
    hidden: Hidden = "empty"
    """What Eq. 7 makes of voxels of N that a view does not count, because they are hidden, outside
    of the map, or reserved for a teammate. "empty": they count as known and empty, so that the q
    sum to one, and a view of known and empty voxels brings nothing wherever it ends. To hide voxels
    does not raise NI as long as no bin of theirs keeps more voxels than there were empty ones; so
    it is for known voxels where most are empty. It can raise NI where a view is full of voxels that
    are known with doubt: if all of N have p = 0.3, NI is 0, and ln 2 once a half is reserved.
    "printed": they are left out, and a known map that hides a part of a view still pays up to 1/e
    nats."""


@dataclass(frozen=True)
class PlanarRatingSettings(RatingSettings):
    """Constants of Eqs. 5 to 9 of the 2-D (planar) environment.

    Raises
    ------
    ValueError
        If a value is outside of its range.
    """

    K: NonNegative = 0.005
    """Weight of the motion, nats per unit of d**n: the largest one whose area under the coverage
    curve is within 2 % of the best, on training worlds; see `studies.rating_constants`. Robots move
    a quarter less than with K = 0."""
    n_gray_bins: Annotated[int, Bounds(at_least=2, at_most=256)] = 128
    """Bins over the gray levels [0, 2] (Eq. 7). With 128 the area under the coverage curve is 3 %
    larger than with 64, and 9 % larger than with 32; see `studies.rating_constants`."""
    alpha_position: NonNegative = 1.0
    """Weight of squared metres in Eq. 5."""
    alpha_heading: NonNegative = 0.0
    """Weight of squared radians in Eq. 5: a camera turns on its mount at almost no cost."""


@dataclass(frozen=True)
class FieldRatingSettings(RatingSettings):
    """Constants of Eqs. 6 to 9 of the 3-D (field) environment; `Mount.alpha` has those of Eq. 5.

    Raises
    ------
    ValueError
        If a value is outside of its range.
    """

    K: NonNegative = 0.2
    """Weight of the motion, nats per unit of d**n: the largest one whose area under the curve of
    the covered surface is within 2 % of the best, on training scenes; see
    `studies.rating_constants`. Mounts then move little more than half as much as with K = 0."""
