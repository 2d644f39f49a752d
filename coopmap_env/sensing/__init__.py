"""What a camera is, how uncertain it is, and what it hands to the map."""

from coopmap_env.sensing.camera import PlanarCamera
from coopmap_env.sensing.depth_camera import DepthCamera
from coopmap_env.sensing.noise import RangeNoise, rotate_covariances
from coopmap_env.sensing.point_cloud import PointCloud, transform_cloud
from coopmap_env.sensing.scan import Scan

__all__ = [
    "DepthCamera",
    "PlanarCamera",
    "PointCloud",
    "RangeNoise",
    "Scan",
    "rotate_covariances",
    "transform_cloud",
]
