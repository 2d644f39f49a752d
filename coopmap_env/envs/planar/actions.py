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
from coopmap_env.core.kernels import kernel
from coopmap_env.envs.actions import InvalidActionError, parse_pose_action
from coopmap_env.envs.belief import Decoded
from coopmap_env.envs.planar.belief import PlanarBelief
from coopmap_env.envs.reasons import RejectedReason
from coopmap_env.geometry import to_camera_frame
from coopmap_env.robots import LatticeGeometry, pose_from_id
from coopmap_env.robots.planar.pose_lattice import nearest_pose_id

MASKED = int(RejectedReason.MASKED)
"""Rejection of an action that chooses a candidate which does not exist; other rejections are the
results of `feasibility`."""


@kernel
def requested_pose(
    pose_id: int,
    action: NDArray[np.float64],
    reach: float,
    shape: tuple[int, int, int],
    lattice: LatticeGeometry,
) -> int:
    """The lattice pose nearest to a "pose" action (3,) from a pose; -1 outside of the world."""
    x, y, heading = pose_from_id(pose_id, lattice)
    ahead, left = reach * action[0], reach * action[1]
    s, c = sin_cos(heading)
    return nearest_pose_id(
        x + (c * ahead - s * left),
        y + (s * ahead + c * left),
        heading + math.pi * action[2],
        shape,
        lattice,
    )


class PlanarPoseMode:
    """Continuous poses relative to the current one."""

    def __init__(self, reach: float) -> None:
        self._scale = np.array([reach, reach, math.pi])

    def space(self, robot: int) -> spaces.Box:
        """Box(-1, 1, (3,), float32)."""
        return spaces.Box(-1.0, 1.0, (3,), np.float32)

    def parse(self, agent: str, action: object) -> NDArray[np.float64]:
        """The numbers (3,) of an action.

        Raises
        ------
        InvalidActionError
            Naming the robot and the value.
        """
        return parse_pose_action(agent, action, ("ahead", "left", "turn"))

    def decode(self, agent: str, action: object, belief: PlanarBelief) -> Decoded:
        """Nearest lattice pose to the requested one."""
        robot, grid = belief.agents.index(agent), belief.map.grid
        pose_id = requested_pose(
            belief.pose_ids[robot], self.parse(agent, action), float(belief.reach), grid.shape_3d,
            belief.lattice.geometry,
        )  # fmt: skip
        return Decoded(pose_id, belief.rejected_reason(robot, pose_id))

    def encode(self, robot: int, pose_id: int, belief: PlanarBelief) -> NDArray[np.float32]:
        """The relative pose, as fractions of the reach and of half a turn."""
        relative = to_camera_frame(belief.lattice.poses(pose_id), belief.camera_poses[robot])
        action = relative / self._scale
        if np.abs(action).max() > 1 + 1e-6:
            raise InvalidActionError(
                f"{belief.agents[robot]}: pose {pose_id} is out of reach: {relative} from here"
            )
        return np.clip(action, -1, 1).astype(np.float32)
