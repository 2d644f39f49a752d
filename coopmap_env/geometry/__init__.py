"""Rigid transforms and exact voxel traversal."""

from coopmap_env.geometry.rotations import (
    displaced,
    displacement_between,
    nearest_rotation,
    rotation_of_vector,
    skew,
    vector_of_rotation,
)
from coopmap_env.geometry.transforms import Pose, to_camera_frame, to_world_frame, wrap_angle
from coopmap_env.geometry.traversal import Traversal, traverse

__all__ = [
    "Pose",
    "Traversal",
    "displaced",
    "displacement_between",
    "nearest_rotation",
    "rotation_of_vector",
    "skew",
    "to_camera_frame",
    "to_world_frame",
    "traverse",
    "vector_of_rotation",
    "wrap_angle",
]
