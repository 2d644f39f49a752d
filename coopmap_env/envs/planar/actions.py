"""The "pose" action of planar robots: a camera pose relative to the current one, in its frame.

``Box(-1, 1, (3,), float32)``; it is rounded to the nearest lattice pose.

=======  ==========================================
index    content
=======  ==========================================
0        ahead, as a fraction of `PlanarSettings.reach`
1        left, as a fraction of it
2        turn to the left, as a fraction of pi
=======  ==========================================
"""

from __future__ import annotations

import math

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from coopmap_env.core.elementary import sin_cos
from coopmap_env.envs.actions import InvalidActionError, parse_pose_action
from coopmap_env.envs.belief import Decoded
from coopmap_env.envs.planar.belief import PlanarBelief
from coopmap_env.geometry import to_camera_frame


class PlanarPoseMode:
    """Continuous poses relative to the current one."""

    def __init__(self, reach: float) -> None:
        self._scale = np.array([reach, reach, math.pi])

    def space(self, robot: int) -> spaces.Box:
        """Box(-1, 1, (3,), float32)."""
        return spaces.Box(-1.0, 1.0, (3,), np.float32)

    def decode(self, agent: str, action: object, belief: PlanarBelief) -> Decoded:
        """Nearest lattice pose to the requested one."""
        ahead, left, turn = parse_pose_action(agent, action, ("ahead", "left", "turn")).tolist()
        robot = belief.agents.index(agent)
        reach, _, half_turn = self._scale.tolist()
        x, y, heading = belief.lattice.pose(belief.pose_ids[robot])
        s, c = sin_cos(heading)
        target = (
            x + reach * (c * ahead - s * left),
            y + reach * (s * ahead + c * left),
            heading + half_turn * turn,
        )
        pose_id = belief.lattice.nearest_pose_id(target)
        return Decoded(pose_id, belief.infeasibility_reason(robot, pose_id))

    def encode(self, robot: int, pose_id: int, belief: PlanarBelief) -> NDArray[np.float32]:
        """The relative pose, as fractions of the reach and of half a turn."""
        relative = to_camera_frame(belief.lattice.poses(pose_id), belief.camera_poses[robot])
        action = relative / self._scale
        if np.abs(action).max() > 1 + 1e-6:
            raise InvalidActionError(
                f"{belief.agents[robot]}: pose {pose_id} is out of reach: {relative} from here"
            )
        return np.clip(action, -1, 1).astype(np.float32)
