"""Where cameras can stand: cells of the plane, and articulated mounts on vehicles in space."""

from coopmap_env.robots.collision.checker import CollisionChecker, CollisionSettings, Contact
from coopmap_env.robots.collision.clearance import VoxelStates, are_spheres_free
from coopmap_env.robots.collision.planning import plan_path
from coopmap_env.robots.collision.self_filter import filter_robot_points
from coopmap_env.robots.kinematics.chain import Chain
from coopmap_env.robots.kinematics.collision_spheres import (
    CollisionSpheres,
    CollisionSphereSettings,
)
from coopmap_env.robots.lattice import PoseLattice
from coopmap_env.robots.mount import Mount, make_mount
from coopmap_env.robots.mount_library import mount_from_urdf
from coopmap_env.robots.reach import (
    ReachableCells,
    free_mask,
    infeasibility_reason,
    is_straight_path_free,
)
from coopmap_env.robots.suspension import SUSPENSION_JOINTS, Suspension
from coopmap_env.robots.vehicle import PoseEstimate, Vehicle

__all__ = [
    "SUSPENSION_JOINTS",
    "Chain",
    "CollisionChecker",
    "CollisionSettings",
    "CollisionSphereSettings",
    "CollisionSpheres",
    "Contact",
    "Mount",
    "PoseEstimate",
    "PoseLattice",
    "ReachableCells",
    "Suspension",
    "Vehicle",
    "VoxelStates",
    "are_spheres_free",
    "filter_robot_points",
    "free_mask",
    "infeasibility_reason",
    "is_straight_path_free",
    "make_mount",
    "mount_from_urdf",
    "plan_path",
]
