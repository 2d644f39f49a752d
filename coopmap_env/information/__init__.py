"""What a view would bring: visible cells, new information (Eqs. 6-8), rating (Eqs. 5 and 9)."""

from coopmap_env.information.entropy import entropy
from coopmap_env.information.field.frustum import Frustum
from coopmap_env.information.field.mutual_information import FieldMutualInformation
from coopmap_env.information.field.point_visibility import first_visible_point
from coopmap_env.information.field.rating import FieldRatingFunction
from coopmap_env.information.frontier import adjacent_to_unknown
from coopmap_env.information.gray_levels import gray_bin, sampled_gray_level, unknown_gray_level
from coopmap_env.information.near_surface import near_surface_hazards, near_surface_weights
from coopmap_env.information.planar.expected_views import ExpectedCells, PlanarExpectedViews
from coopmap_env.information.planar.information_cache import NewInformationCache
from coopmap_env.information.planar.mutual_information import PlanarMutualInformation
from coopmap_env.information.planar.rating import PlanarRatingFunction
from coopmap_env.information.ratings import (
    CameraPoses,
    Ratings,
    ReservedMask,
    ViewContext,
    joint_distance,
    motion_distance,
)
from coopmap_env.information.settings import (
    FieldRatingSettings,
    PlanarRatingSettings,
    RatingSettings,
)

__all__ = [
    "CameraPoses",
    "ExpectedCells",
    "FieldMutualInformation",
    "FieldRatingFunction",
    "FieldRatingSettings",
    "Frustum",
    "NewInformationCache",
    "PlanarExpectedViews",
    "PlanarMutualInformation",
    "PlanarRatingFunction",
    "PlanarRatingSettings",
    "RatingSettings",
    "Ratings",
    "ReservedMask",
    "ViewContext",
    "adjacent_to_unknown",
    "entropy",
    "first_visible_point",
    "gray_bin",
    "joint_distance",
    "motion_distance",
    "near_surface_hazards",
    "near_surface_weights",
    "sampled_gray_level",
    "unknown_gray_level",
]
