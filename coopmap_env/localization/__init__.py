"""Where the robots and their cameras are: target registration (2.2) and motion correction (2.5)."""

from coopmap_env.localization.correction.corrector import Correction, Matches, MotionCorrection
from coopmap_env.localization.correction.fiducials import Fiducials, FiducialSettings, select
from coopmap_env.localization.correction.pose_estimators import (
    BadlyPlacedError,
    RecursiveMoments,
    camera_points,
    consistent,
    gaussian_transform,
    linear_pose,
    linear_transform,
    recursive_pose,
    rigid_transform,
)
from coopmap_env.localization.correction.settings import CorrectionSettings
from coopmap_env.localization.correction.tracking import TrackingSettings, Tracks, track
from coopmap_env.localization.registration.common_frame import agree_on_frame, in_frame
from coopmap_env.localization.registration.register import (
    Registration,
    RegistrationSettings,
    register,
)
from coopmap_env.localization.registration.views import View
from coopmap_env.localization.target import TargetModel

__all__ = [
    "BadlyPlacedError",
    "Correction",
    "CorrectionSettings",
    "FiducialSettings",
    "Fiducials",
    "Matches",
    "MotionCorrection",
    "RecursiveMoments",
    "Registration",
    "RegistrationSettings",
    "TargetModel",
    "TrackingSettings",
    "Tracks",
    "View",
    "agree_on_frame",
    "camera_points",
    "consistent",
    "gaussian_transform",
    "in_frame",
    "linear_pose",
    "linear_transform",
    "recursive_pose",
    "register",
    "rigid_transform",
    "select",
    "track",
]
