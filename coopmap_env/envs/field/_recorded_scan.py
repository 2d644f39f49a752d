"""Scans as they were measured, to be fused again when more is known."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from typing import NamedTuple

from coopmap_env.core.linear_algebra import length
from coopmap_env.envs.field._initial_knowledge import initial_free_voxels
from coopmap_env.envs.field.belief import FieldBelief
from coopmap_env.envs.field.settings import FieldSettings
from coopmap_env.envs.field.team_state import Joints
from coopmap_env.geometry import Pose, Spheres, displacement_between
from coopmap_env.mapping import VoxelGrid
from coopmap_env.robots import PoseEstimate, filter_robot_points
from coopmap_env.sensing import PointCloud, RangeNoise, Scan, transform_cloud

REFERENCE_DEPTH = 3.0
"""Metres: the depth of a point by which the revision of a pose is measured."""


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
    robot_spheres: Spheres
    """Around the robots whose points are removed from the cloud, in the frame of `estimate`."""
    batch: int
    """Scans of one batch, which follow each other, are fused at once."""
    pose_index: int | None
    """Index among `PoseCorrector.revised_estimates`; None if the pose was not corrected."""

    def scan(self, noise: RangeNoise) -> Scan:
        """The scan at the estimated pose, without the points that lie on robots by that pose."""
        pose, covariance = self.estimate
        cloud = filter_robot_points(self.cloud, pose, *self.robot_spheres, noise, covariance)
        return transform_cloud(cloud, pose, noise, covariance)


def fuse_recorded_scans(
    belief: FieldBelief, recorded: Sequence[RecordedScan], settings: FieldSettings
) -> None:
    """Make the team's map from the scans of all located robots, batch by batch."""
    located = belief.located
    pairs = zip(belief.vehicles, located, strict=True)
    bases = [vehicle.T_world_base for vehicle, is_located in pairs if is_located]
    belief.map.clear()
    belief.map.mark_free(initial_free_voxels(belief.map.grid, bases, settings.initial_free_radius))
    shared = [record for record in recorded if located[record.robot]]
    for _, batch in groupby(shared, key=lambda record: record.batch):
        belief.map.integrate([record.scan(settings.noise) for record in batch])


def revise(
    recorded: Sequence[RecordedScan],
    revised: Sequence[PoseEstimate],
    min_revision: float,
    grid: VoxelGrid,
) -> list[RecordedScan] | None:
    """The scans with revised camera poses; None if none of them moved by enough.

    Nor are they revised if one of the cameras would leave the map.

    Parameters
    ----------
    recorded : sequence of RecordedScan
    revised : sequence of PoseEstimate
        By `RecordedScan.pose_index`.
    min_revision : float
        Metres, of a point at `REFERENCE_DEPTH`.
    grid : VoxelGrid
        Of the map.
    """
    estimates = [r.estimate if r.pose_index is None else revised[r.pose_index] for r in recorded]
    pairs = list(zip(recorded, estimates, strict=True))
    if not any(point_displacement(r.estimate.pose, new.pose) > min_revision for r, new in pairs):
        return None
    cameras = [new.pose.translation for new in estimates]
    if not grid.contains(grid.index(cameras)).all():
        return None
    return [r._replace(estimate=new) for r, new in pairs]


def point_displacement(old: Pose, new: Pose) -> float:
    """Metres by which a point `REFERENCE_DEPTH` ahead of a camera moves with it, at most."""
    moved = displacement_between(old, new)
    return length(moved[:3]) + REFERENCE_DEPTH * length(moved[3:])
