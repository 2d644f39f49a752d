"""What a view would tell: visible voxels, new information (Eqs. 6-8), rating (Eqs. 5 and 9)."""

from coopmap_env.information.entropy import entropy
from coopmap_env.information.field.frustum import Frustum
from coopmap_env.information.field.line_of_sight import first_seen
from coopmap_env.information.field.mutual_information import FieldBeamInformation
from coopmap_env.information.field.rating import FieldRatingFunction
from coopmap_env.information.frontier import beside_unknown
from coopmap_env.information.gray import gray_bin, gray_of_sampled, gray_of_unknown
from coopmap_env.information.motion_cost import joint_distance, motion_distance
from coopmap_env.information.planar.fan import Fan
from coopmap_env.information.planar.mutual_information import BeamInformation
from coopmap_env.information.planar.rating import RatingFunction, Ratings
from coopmap_env.information.settings import FieldRatingSettings, RatingConstants, RatingSettings

__all__ = [
    "BeamInformation",
    "Fan",
    "FieldBeamInformation",
    "FieldRatingFunction",
    "FieldRatingSettings",
    "Frustum",
    "RatingConstants",
    "RatingFunction",
    "RatingSettings",
    "Ratings",
    "beside_unknown",
    "entropy",
    "first_seen",
    "gray_bin",
    "gray_of_sampled",
    "gray_of_unknown",
    "joint_distance",
    "motion_distance",
]
