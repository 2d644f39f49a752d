"""Rigid transforms and exact voxel traversal."""

from coopmap_env.geometry.transforms import Pose, to_camera_frame, to_world_frame, wrap_angle
from coopmap_env.geometry.traversal import Traversal, traverse

__all__ = ["Pose", "Traversal", "to_camera_frame", "to_world_frame", "traverse", "wrap_angle"]
