"""The search for the target by robots that are not located, in all of their scans (Section 2.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from coopmap_env.envs.field._recorded_scan import RecordedScan
from coopmap_env.envs.field.belief import FieldBelief
from coopmap_env.envs.field.settings import FieldSettings
from coopmap_env.envs.field.true_poses import TruePoses
from coopmap_env.localization import (
    LocalizationFailure,
    Registration,
    TargetModel,
    View,
    in_equivalent_frame,
    register,
    resolve_symmetry,
)
from coopmap_env.mapping import VoxelGrid
from coopmap_env.robots import PoseEstimate

MAX_SEARCHED_SCANS = 8
"""Scans at most in which the target is searched for at once, the last ones: more take longer."""
MIN_HITS = 50
"""Points at least of a scan that takes part in the search."""


class TargetSearch:
    """Registers the scans of one robot to the target model.

    Parameters
    ----------
    settings : FieldSettings
    target : TargetModel
    true_poses : TruePoses
        They select one of the frames that a symmetric target has.
    """

    def __init__(self, settings: FieldSettings, target: TargetModel, true_poses: TruePoses) -> None:
        self._settings = settings
        self._target = target
        self._true_poses = true_poses

    def register(
        self, belief: FieldBelief, robot: int, recorded: Sequence[RecordedScan]
    ) -> Registration | None:
        """Base pose of a robot in the frame of the target; None without new points to search.

        `recorded` are the scans of this robot so far.
        """
        if not recorded or int(recorded[-1].cloud.hit.sum()) < MIN_HITS:
            return None
        own = belief.vehicles[robot].T_world_base
        s, to_base = self._settings, own.inverse()
        usable = [record for record in recorded if record.cloud.hit.sum() >= MIN_HITS]
        views = []
        for record in usable[-MAX_SEARCHED_SCANS:]:
            past_belief, (pose, covariance) = belief.with_poses(record.joints), record.estimate
            cloud = past_belief.remove_robot_points(robot, record.cloud, record.estimate, s.noise)
            views.append(View(cloud, PoseEstimate(to_base @ pose, covariance)))
        found = register(self._target, views, s.camera, s.noise, s.registration)
        if found.located and len(found.equivalent_poses) > 1:
            found = self._resolve_symmetry(belief, robot, found, views)
        return _reject_outside_map(belief.map.grid, found, views)

    def _resolve_symmetry(
        self, belief: FieldBelief, robot: int, found: Registration, views: list[View]
    ) -> Registration:
        """Of the poses that a symmetric target leaves, the one in the team's common frame.

        The first robot defines that frame. The others compare what they see besides the target
        with the team's map.
        """
        if any(belief.located):
            return resolve_symmetry(belief.map, found, views, self._target)
        nearest = self._true_poses.nearest_to_base(robot, found.equivalent_poses)
        return in_equivalent_frame(found, nearest)


def _reject_outside_map(grid: VoxelGrid, found: Registration, views: list[View]) -> Registration:
    """The registration, rejected if it would put a camera outside of the map."""
    if found.T_target_base is None:
        return found
    cameras = [found.T_target_base.transform(v.estimate.pose.translation) for v in views]
    if grid.contains(grid.index(cameras)).all():
        return found
    outside = LocalizationFailure.OUTSIDE_MAP
    return replace(
        found, failure=outside, reason=outside.words, T_target_base=None, covariance=None
    )
