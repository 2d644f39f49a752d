"""The "pose" action of field robots: the joints of the camera mount.

``Box(-1, 1, (n,), float32)``: joint i goes to the middle of its limits plus ``action[i]`` times
half their range; a joint without limits turns from -pi to pi.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from coopmap_env.envs.actions import parse_pose_action
from coopmap_env.envs.belief import Decoded
from coopmap_env.envs.field._joint_space import JointSpace
from coopmap_env.envs.field.belief import FieldBelief


class FieldPoseMode:
    """Joints of the mounts, normalized to their limits."""

    def __init__(
        self, joint_spaces: Sequence[JointSpace], joint_names: Sequence[tuple[str, ...]]
    ) -> None:
        self._spaces = tuple(joint_spaces)
        self._names = tuple(joint_names)

    def space(self, robot: int) -> spaces.Box:
        """Box(-1, 1, (n,), float32)."""
        return spaces.Box(-1.0, 1.0, (self._spaces[robot].n,), np.float32)

    def decode(self, agent: str, action: object, belief: FieldBelief) -> Decoded:
        """The requested joints."""
        robot = belief.agents.index(agent)
        q = self._spaces[robot].denormalize(parse_pose_action(agent, action, self._names[robot]))
        return Decoded(q, belief.rejected_reason(robot, q))

    def encode(
        self, robot: int, pose: NDArray[np.float64], belief: FieldBelief
    ) -> NDArray[np.float32]:
        """Joints normalized to their limits."""
        return self._spaces[robot].normalize(pose)
