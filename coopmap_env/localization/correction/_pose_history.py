"""Camera poses of all scans of an episode, by all that was measured until now."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.localization.correction._pose_state import PoseState
from coopmap_env.robots import PoseEstimate


class PastScan(NamedTuple):
    """A scan whose pose was estimated."""

    robot: int
    reading: NDArray[np.float64]
    """Shape (n,): of its encoders."""
    estimate: PoseEstimate
    """T_world_camera, as it was last estimated."""
    is_final: bool
    """Whether the estimate stays, as it has parts that the state has no more."""


class PoseHistory:
    """Scans of a team in the order in which their poses were estimated.

    The cameras of keyframes are part of the state, which revises them. A pose that no fiducials
    measured depends on the robot's base, offsets and springs alone: it is predicted again. Others
    stay as they were.

    Parameters
    ----------
    poses : PoseState
        In which the cameras are those of the keyframes, in their order.
    """

    def __init__(self, poses: PoseState) -> None:
        self._poses = poses
        self._scans: list[PastScan] = []
        self._keyframes: list[int] = []
        """Index of the scan of each camera of the state."""

    def __len__(self) -> int:
        return len(self._scans)

    def add(self, past: PastScan, is_keyframe: bool) -> None:
        """Append a scan; the camera of a keyframe is the last one of the state."""
        if is_keyframe:
            self._keyframes.append(len(self._scans))
        self._scans.append(past)

    def finish_oldest_keyframe(self) -> None:
        """Keep the pose of the oldest keyframe as it is: its camera is about to leave the state."""
        k = self._keyframes.pop(0)
        self._scans[k] = self._scans[k]._replace(estimate=self._poses.estimate(0), is_final=True)

    def estimates(self) -> list[PoseEstimate]:
        """T_world_camera of each scan as it is known now."""
        cameras = {scan: camera for camera, scan in enumerate(self._keyframes)}
        return [self._estimate(past, cameras.get(k)) for k, past in enumerate(self._scans)]

    def _estimate(self, past: PastScan, camera: int | None) -> PoseEstimate:
        if camera is not None:
            return self._poses.estimate(camera)
        if past.is_final:
            return past.estimate
        return self._poses.predict(past.robot, past.reading)
