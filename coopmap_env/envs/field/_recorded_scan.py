"""Scans as they were measured, to be fused again when more is known."""

from __future__ import annotations

from typing import NamedTuple

from coopmap_env.envs.field.team_state import Joints
from coopmap_env.geometry import Pose
from coopmap_env.robots import PoseEstimate
from coopmap_env.sensing import PointCloud


class RecordedScan(NamedTuple):
    """One scan of one robot, with all that its pose is estimated from."""

    robot: int
    cloud: PointCloud
    """As measured, including points on robots."""
    joints: tuple[Joints, ...]
    """Encoder readings of all mounts."""
    true_camera: Pose
    """T_world_camera; only `TruePoses` may use it."""
    estimate: PoseEstimate
    """Camera pose in the world frame, or in the robot's own frame until it is located."""
