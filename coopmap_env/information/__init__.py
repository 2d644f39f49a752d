"""What a view would tell: visible voxels, new information (Eqs. 6-8), rating (Eqs. 5 and 9)."""

from coopmap_env.information.entropy import entropy
from coopmap_env.information.fan import Fan
from coopmap_env.information.frontier import beside_unknown
from coopmap_env.information.gray import gray_bin, gray_of_sampled, gray_of_unknown
from coopmap_env.information.rating import (
    RatingFunction,
    Ratings,
    RatingSettings,
    motion_distance,
)
from coopmap_env.information.shannon import BeamInformation

__all__ = [
    "BeamInformation",
    "Fan",
    "RatingFunction",
    "RatingSettings",
    "Ratings",
    "beside_unknown",
    "entropy",
    "gray_bin",
    "gray_of_sampled",
    "gray_of_unknown",
    "motion_distance",
]
