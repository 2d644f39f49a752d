"""The form of the study's results as they are stored; others are computed again."""

from __future__ import annotations

from typing import Any, TypedDict

from coopmap_env.core.json_types import has_type
from coopmap_env.evaluation import Episode, is_episode

N_ROBOTS = 2
CORRECTION_KEYS = {"correction_ms", "n_fiducials", "n_outliers", "mean_points"}
"""Of a scan: all of them, or none if no correction was tried."""


class PoseErrors(TypedDict):
    """Metres, radians, and the normalised estimation error squared; NaN where undefined."""

    position: float
    angle: float
    nees: float


class LocatedRobot(PoseErrors):
    """A robot that has found its place after some scans."""

    n_scans: int


class SearchResult(TypedDict):
    """See `run_search_episode`."""

    robots: list[LocatedRobot | None]
    registration_ms: list[float]


class CameraErrors(PoseErrors):
    """Of the camera pose of a scan."""

    point_displacement: float


class MeanPointErrors(TypedDict):
    """Of a pose that was estimated from the regions' mean points."""

    position: float
    angle: float


class MeanPoints(TypedDict):
    """By estimator."""

    linear: MeanPointErrors
    rigid: MeanPointErrors


class ScanOfPose(TypedDict):
    """What every scan has."""

    corrected_directions: int
    correction_failure: str
    n_hits: int
    noise_floor: float
    encoders: CameraErrors
    kinematic: CameraErrors
    estimated: CameraErrors
    smoothed: CameraErrors


class ScanRecord(ScanOfPose, total=False):
    """A scan with its correction, if there was one."""

    correction_ms: float
    n_fiducials: int
    n_outliers: int
    mean_points: MeanPoints | None


class MapQuality(TypedDict):
    """Scores of a map; NaN where undefined."""

    f_score: float
    chamfer: float
    log_loss: float


class SameScans(TypedDict):
    """By kind of camera pose."""

    encoders: MapQuality
    kinematic: MapQuality
    estimated: MapQuality
    smoothed: MapQuality
    exact: MapQuality


class CorrectionResult(TypedDict):
    """See `run_correction_episode`."""

    episode: Episode
    scans: list[ScanRecord]
    same_scans: SameScans


def is_search_result(result: Any) -> bool:
    """Whether a stored result is one of a search."""
    return has_type(result, SearchResult) and len(result["robots"]) == N_ROBOTS


def is_correction_result(result: Any, n_scans: int | None = None) -> bool:
    """Whether a stored result is one of an episode with `n_scans` scans of each robot."""
    return (
        has_type(result, CorrectionResult)
        and is_episode(result["episode"], n_scans, with_surface=True)
        and all(len(CORRECTION_KEYS & set(scan)) in (0, 4) for scan in result["scans"])
    )
