"""Poses of robots and cameras: registration (Section 2.2), correction by fiducials (2.5)."""

from coopmap_env.localization.correction.corrector import (
    FiducialMatches,
    PoseCorrection,
    PoseCorrector,
)
from coopmap_env.localization.correction.fiducials import (
    Fiducials,
    FiducialSettings,
    select_fiducials,
)
from coopmap_env.localization.correction.pose_estimators import (
    DegenerateGeometryError,
    GaussianPose,
    RecursiveMoments,
    back_project,
    consistent_subset,
    gaussian_pose,
    linear_pose,
    linear_transform,
    recursive_pose,
    rigid_pose,
)
from coopmap_env.localization.correction.settings import CorrectionSettings
from coopmap_env.localization.correction.tracking import (
    FiducialTracks,
    TrackingSettings,
    track_fiducials,
)
from coopmap_env.localization.failures import CorrectionFailure, LocalizationFailure
from coopmap_env.localization.registration.acceptance import AcceptanceSettings, Fitness
from coopmap_env.localization.registration.alignment import AlignmentSettings
from coopmap_env.localization.registration.icp import Refiner, SmallGicp
from coopmap_env.localization.registration.register import (
    Registration,
    RegistrationSettings,
    register,
)
from coopmap_env.localization.registration.search import SearchSettings
from coopmap_env.localization.registration.symmetry import in_equivalent_frame, resolve_symmetry
from coopmap_env.localization.registration.views import View
from coopmap_env.localization.target import TargetModel

__all__ = [
    "AcceptanceSettings",
    "AlignmentSettings",
    "CorrectionFailure",
    "CorrectionSettings",
    "DegenerateGeometryError",
    "FiducialMatches",
    "FiducialSettings",
    "FiducialTracks",
    "Fiducials",
    "Fitness",
    "GaussianPose",
    "LocalizationFailure",
    "PoseCorrection",
    "PoseCorrector",
    "RecursiveMoments",
    "Refiner",
    "Registration",
    "RegistrationSettings",
    "SearchSettings",
    "SmallGicp",
    "TargetModel",
    "TrackingSettings",
    "View",
    "back_project",
    "consistent_subset",
    "gaussian_pose",
    "in_equivalent_frame",
    "linear_pose",
    "linear_transform",
    "recursive_pose",
    "register",
    "resolve_symmetry",
    "rigid_pose",
    "select_fiducials",
    "track_fiducials",
]
