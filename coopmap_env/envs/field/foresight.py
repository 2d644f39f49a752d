"""The field map as it may be after the next scans."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from coopmap_env.envs.field.belief import FieldBelief
from coopmap_env.envs.field.team_state import Joints
from coopmap_env.information import ReservedMask, joint_distance
from coopmap_env.information.predictions import checked_probabilities


@dataclass(frozen=True)
class FieldForesight:
    """See `Foresight`; views show voxels but open no new poses: vehicles stand still.

    What a view brings are all never-sampled voxels that it shows, or with predictions the number of
    them that are expected to be surface. Robots that are not located know nothing of the map of the
    predictions, and count all voxels of their own: some ten times more, so that motion weighs less.
    """

    belief: FieldBelief
    seen_mask: ReservedMask
    """Voxels that views will have shown (n_cells,); changed by `take`."""
    surface: NDArray[np.float32] | None = None
    """Probability that each voxel is surface and new (n_cells,)."""

    @classmethod
    def of_belief(
        cls, belief: FieldBelief, unknown_occupancy: NDArray[np.float32] | None = None
    ) -> FieldForesight:
        """The map as it is; predictions are those of never-sampled voxels.

        Raises
        ------
        ValueError
            If the predictions are not one probability for each voxel.
        """
        map_, surface = belief.map, None
        if unknown_occupancy is not None:
            predicted = checked_probabilities(unknown_occupancy, map_.grid.n_cells)
            surface = np.where(map_.sampled_mask == 0, predicted, np.float32(0.0))
        return cls(belief, np.zeros(map_.grid.n_cells, dtype=np.uint8), surface)

    def copy(self) -> FieldForesight:
        """See `Foresight.copy`."""
        return replace(self, seen_mask=self.seen_mask.copy())

    def gain(self, robot: int, poses: Joints) -> NDArray[np.float64]:
        """New voxels, or new surface, as a fraction of a full view; see `Foresight.gain`."""
        belief = self.belief
        if self.surface is None or not belief.located[robot]:
            return belief.unknown_fraction(robot, poses, self.seen_mask)
        rating = belief.rating_function
        new = np.where(self.seen_mask == 0, self.surface, np.float32(0.0))
        cameras = belief.vehicles[robot].camera_poses(poses)
        context = belief.view_context(robot)
        return rating.visible_weight(belief.map, cameras, new, context) / rating.max_visible_cells

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
