"""Rigid transforms and exact voxel traversal."""

from coopmap_env.geometry.rotations import (
    apply_displacement,
    displacement_between,
    nearest_rotation,
    rotation_from_rotvec,
    rotvec_from_rotation,
    skew,
)
from coopmap_env.geometry.transforms import (
    Pose,
    RigidTransform,
    to_camera_frame,
    to_world_frame,
    wrap_angle,
)
from coopmap_env.geometry.traversal import Traversal, traverse

__all__ = [
    "Pose",
    "RigidTransform",
    "Traversal",
    "apply_displacement",
    "displacement_between",
    "nearest_rotation",
    "rotation_from_rotvec",
    "rotvec_from_rotation",
    "skew",
    "to_camera_frame",
    "to_world_frame",
    "traverse",
    "wrap_angle",
]
