"""True poses in localization, for two uses only: exact camera poses, and the choice of a frame."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from coopmap_env.core.linear_algebra import length
from coopmap_env.envs.field.belief import FieldBelief
from coopmap_env.geometry import Pose, displacement_between
from coopmap_env.robots import PoseEstimate

ZERO_COVARIANCE = np.zeros((6, 6))


class TruePoses:
    """True base poses of a team.

    Parameters
    ----------
    bases : sequence of Pose
        T_world_base of each robot.
    """

    def __init__(self, bases: Sequence[Pose]) -> None:
        self._bases = tuple(bases)

    def exact_camera(self, belief: FieldBelief, robot: int, true_camera: Pose) -> PoseEstimate:
        """A camera's true pose as an estimate, for ``motion_correction="exact"``.

        Until the robot is located, it is that in the robot's own frame.
        """
        pose = true_camera
        if not belief.located[robot]:
            own = belief.vehicles[robot].T_world_base
            pose = own @ self._bases[robot].inverse() @ true_camera
        return PoseEstimate(pose, ZERO_COVARIANCE)

    def nearest_to_base(self, robot: int, poses: Sequence[Pose]) -> Pose:
        """Of the base poses that a symmetric target leaves, the one nearest to the true one.

        The first located robot takes it. Every choice would be right; this one makes the maps
        comparable with the true world.
        """
        base = self._bases[robot]
        return min(poses, key=lambda pose: length(displacement_between(pose, base)))
