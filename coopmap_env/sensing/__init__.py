"""Camera models, their range noise, and the scans that they measure."""

from coopmap_env.sensing.beam_fan import BeamFan
from coopmap_env.sensing.cameras import DepthCamera, PinholeIntrinsics, PlanarCamera
from coopmap_env.sensing.noise import NoiseParameters, RangeNoise, rotate_covariances
from coopmap_env.sensing.scan import (
    PointCloud,
    Scan,
    ScanArrays,
    pose_term,
    transform_cloud,
)

__all__ = [
    "BeamFan",
    "DepthCamera",
    "NoiseParameters",
    "PinholeIntrinsics",
    "PlanarCamera",
    "PointCloud",
    "RangeNoise",
    "Scan",
    "ScanArrays",
    "pose_term",
    "rotate_covariances",
    "transform_cloud",
]
