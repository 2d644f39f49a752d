"""The field map as it may be after the next scans."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from coopmap_env.envs.field.belief import FieldBelief
from coopmap_env.envs.field.team_state import Joints
from coopmap_env.information import ReservedMask, joint_distance


@dataclass(frozen=True)
class FieldForesight:
    """See `Foresight`; views show voxels but open no new poses: vehicles stand still."""

    belief: FieldBelief
    seen_mask: ReservedMask
    """Voxels that views will have shown (n_cells,); changed by `take`."""

    @classmethod
    def of_belief(cls, belief: FieldBelief) -> FieldForesight:
        """The map as it is."""
        return cls(belief, np.zeros(belief.map.grid.n_cells, dtype=np.uint8))

    def copy(self) -> FieldForesight:
        """See `Foresight.copy`."""
        return replace(self, seen_mask=self.seen_mask.copy())

    def gain(self, robot: int, poses: Joints) -> NDArray[np.float64]:
        """See `FieldBelief.unknown_fraction`."""
        return self.belief.unknown_fraction(robot, poses, self.seen_mask)

    def take(self, robot: int, pose: Joints) -> None:
        """See `Foresight.take`."""
        self.seen_mask[self.belief.visible_cells(robot, pose)] = 1

    def random_poses(self, robot: int, pose: Joints, m: int, rng: np.random.Generator) -> Joints:
        """Feasible poses of the belief."""
        return self.belief.random_poses(robot, m, rng)

    def distance(self, robot: int, poses: Joints, pose: Joints) -> NDArray[np.float64]:
        """See `joint_distance`."""
        vehicle = self.belief.vehicles[robot]
        joints, start = vehicle.chain.as_joint_values(poses), vehicle.chain.as_joint_values(pose)
        return joint_distance(joints, start, np.array(vehicle.mount.alpha))
