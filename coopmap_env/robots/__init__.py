"""Where cameras can stand: the poses of a planar lattice, and articulated mounts on vehicles."""

from coopmap_env.robots.collision.checker import (
    CollisionChecker,
    CollisionSettings,
    PredictedContact,
)
from coopmap_env.robots.collision.planning import plan_path
from coopmap_env.robots.collision.self_filter import filter_robot_points
from coopmap_env.robots.collision.voxel_states import VoxelStates, are_spheres_free
from coopmap_env.robots.equilibrium import GRAVITY, Equilibrium
from coopmap_env.robots.kinematics.chain import Chain
from coopmap_env.robots.kinematics.collision_spheres import (
    CollisionSpheres,
    CollisionSphereSettings,
)
from coopmap_env.robots.kinematics.forward import (
    BodyPoses,
    KinematicTree,
    allocate_body_poses,
    body_poses,
    mounted_frame_poses,
)
from coopmap_env.robots.kinematics.mesh_paths import resolve_mesh
from coopmap_env.robots.kinematics.urdf import UrdfModel
from coopmap_env.robots.kinematics.urdf_elements import UrdfJoint, UrdfLink, UrdfShape
from coopmap_env.robots.kinematics.urdf_xml import UrdfError
from coopmap_env.robots.mount import Mount
from coopmap_env.robots.mount_json import MountFields, mount_files, mount_from_json
from coopmap_env.robots.mount_library import R_OPTICAL_CAMERA, make_mount, mount_from_urdf
from coopmap_env.robots.planar.pose_lattice import LatticeGeometry, PoseLattice, pose_from_id
from coopmap_env.robots.planar.reachable_cells import (
    ReachableCells,
    free_mask,
)
from coopmap_env.robots.suspension import SUSPENSION_JOINTS, Suspension
from coopmap_env.robots.vehicle import PoseEstimate, Vehicle

__all__ = [
    "GRAVITY",
    "R_OPTICAL_CAMERA",
    "SUSPENSION_JOINTS",
    "BodyPoses",
    "Chain",
    "CollisionChecker",
    "CollisionSettings",
    "CollisionSphereSettings",
    "CollisionSpheres",
    "Equilibrium",
    "KinematicTree",
    "LatticeGeometry",
    "Mount",
    "MountFields",
    "PoseEstimate",
    "PoseLattice",
    "PredictedContact",
    "ReachableCells",
    "Suspension",
    "UrdfError",
    "UrdfJoint",
    "UrdfLink",
    "UrdfModel",
    "UrdfShape",
    "Vehicle",
    "VoxelStates",
    "allocate_body_poses",
    "are_spheres_free",
    "body_poses",
    "filter_robot_points",
    "free_mask",
    "make_mount",
    "mount_files",
    "mount_from_json",
    "mount_from_urdf",
    "mounted_frame_poses",
    "plan_path",
    "pose_from_id",
    "resolve_mesh",
]
