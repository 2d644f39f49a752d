"""Camera models, their range noise, and the scans that they measure."""

from coopmap_env.sensing.camera import PlanarCamera
from coopmap_env.sensing.depth_camera import DepthCamera, PinholeIntrinsics
from coopmap_env.sensing.noise import NoiseParameters, RangeNoise, rotate_covariances
from coopmap_env.sensing.point_cloud import PointCloud, transform_cloud
from coopmap_env.sensing.scan import Scan

__all__ = [
    "DepthCamera",
    "NoiseParameters",
    "PinholeIntrinsics",
    "PlanarCamera",
    "PointCloud",
    "RangeNoise",
    "Scan",
    "rotate_covariances",
    "transform_cloud",
]
