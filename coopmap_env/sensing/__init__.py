"""Camera models, their range noise, and the scans that they measure."""

from coopmap_env.sensing.cameras import DepthCamera, PinholeIntrinsics, PlanarCamera
from coopmap_env.sensing.noise import NoiseParameters, RangeNoise, rotate_covariances
from coopmap_env.sensing.scan import PointCloud, Scan, ScanArrays, transform_cloud

__all__ = [
    "DepthCamera",
    "NoiseParameters",
    "PinholeIntrinsics",
    "PlanarCamera",
    "PointCloud",
    "RangeNoise",
    "Scan",
    "ScanArrays",
    "rotate_covariances",
    "transform_cloud",
]
