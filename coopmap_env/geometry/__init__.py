"""Rigid transforms, rotations, spheres, and exact voxel traversal."""

from coopmap_env.geometry.rotations import (
    Z_AXIS,
    apply_displacement,
    displacement_between,
    nearest_rotation,
    random_rotation,
    rotation_about_axis,
    rotation_about_z,
    rotation_from_quaternion,
    rotation_from_rotvec,
    rotation_from_rpy,
    rotvec_from_rotation,
    skew,
)
from coopmap_env.geometry.spheres import NO_SPHERES, Spheres, join_spheres
from coopmap_env.geometry.transforms import (
    Pose,
    RigidTransform,
    to_camera_frame,
    to_world_frame,
    wrap_angle,
    wrap_scalar_angle,
)
from coopmap_env.geometry.traversal import (
    Ray,
    RayPosition,
    Traversal,
    start_ray,
    step_ray,
    traverse,
)

__all__ = [
    "NO_SPHERES",
    "Z_AXIS",
    "Pose",
    "Ray",
    "RayPosition",
    "RigidTransform",
    "Spheres",
    "Traversal",
    "apply_displacement",
    "displacement_between",
    "join_spheres",
    "nearest_rotation",
    "random_rotation",
    "rotation_about_axis",
    "rotation_about_z",
    "rotation_from_quaternion",
    "rotation_from_rotvec",
    "rotation_from_rpy",
    "rotvec_from_rotation",
    "skew",
    "start_ray",
    "step_ray",
    "to_camera_frame",
    "to_world_frame",
    "traverse",
    "wrap_angle",
    "wrap_scalar_angle",
]
