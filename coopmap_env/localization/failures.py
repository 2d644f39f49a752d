"""Why a robot is not located, and why a camera pose is not corrected."""

from coopmap_env.core.reasons import Reason


class LocalizationFailure(Reason):
    """Why a robot is not located; ``infos`` have the code."""

    NONE = 0
    NOT_SEARCHED = 1, "too little was in view so far"
    NOTHING_ALIKE = 2, "nothing in view could be the target"
    FEW_POINTS = 3, "too few points lie on the target"
    SMALL_AREA = 4, "points lie on too little of the target"
    UNCONFIRMED = 5, "too few of the expected target pixels see the target"
    SEEN_THROUGH = 6, "too many of the expected target pixels see through it"
    OFF_SURFACE = 7, "too many of the points in the target's box are not on it"
    LARGE_RESIDUALS = 8, "points are farther from the target than their noise explains"
    UNDETERMINED = 9, "visible shape does not determine the pose"
    AMBIGUOUS = 10, "another pose has nearly as much evidence"
    VIEW_UNCONFIRMED = 11, "too few of the expected target pixels of a view see the target"
    VIEWS_DISAGREE = 12, "views disagree"
    SYMMETRIC = 13, "the scene does not distinguish the poses of a symmetric target"
    OUTSIDE_MAP = 14, "what could be the target would put the camera outside of the map"


class CorrectionFailure(Reason):
    """Why fiducials corrected nothing; ``infos`` have the code."""

    NONE = 0
    FEW_FIDUCIALS = 1, "too few fiducials are in view"
