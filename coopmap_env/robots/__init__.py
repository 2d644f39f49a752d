"""Where cameras can stand: cells of the plane, and articulated mounts on vehicles in space."""

from coopmap_env.robots.collision.checker import Contact, MotionSettings, Surroundings
from coopmap_env.robots.collision.clearance import Clearance, spheres_clear
from coopmap_env.robots.collision.planning import plan_path
from coopmap_env.robots.collision.self_filter import without_bodies
from coopmap_env.robots.kinematics.chain import Chain
from coopmap_env.robots.kinematics.collision_spheres import Body, SphereSettings
from coopmap_env.robots.lattice import PoseLattice
from coopmap_env.robots.mount import Mount, make_mount
from coopmap_env.robots.mount_library import wrap_urdf
from coopmap_env.robots.reach import Reach, free_cells, straight_path_is_free, why_not
from coopmap_env.robots.suspension import SUSPENSION_JOINTS, Suspension
from coopmap_env.robots.vehicle import CameraEstimate, Vehicle

__all__ = [
    "SUSPENSION_JOINTS",
    "Body",
    "CameraEstimate",
    "Chain",
    "Clearance",
    "Contact",
    "MotionSettings",
    "Mount",
    "PoseLattice",
    "Reach",
    "SphereSettings",
    "Surroundings",
    "Suspension",
    "Vehicle",
    "free_cells",
    "make_mount",
    "plan_path",
    "spheres_clear",
    "straight_path_is_free",
    "why_not",
    "without_bodies",
    "wrap_urdf",
]
