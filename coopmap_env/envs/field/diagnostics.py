"""What only the simulation knows of a field team, for scoring, studies and pictures."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.linear_algebra import length
from coopmap_env.envs.field._initial_knowledge import initial_free_voxels, make_vehicles
from coopmap_env.envs.field.belief import FieldBelief
from coopmap_env.geometry import Pose, displacement_between
from coopmap_env.robots import Mount, Vehicle
from coopmap_env.simulation import FieldSimulator
from coopmap_env.simulation.scenes.field import FieldWorld


@dataclass(frozen=True)
class FieldDiagnostics:
    """The truth of a field environment beside the belief of its team, at one time."""

    belief: FieldBelief
    simulator: FieldSimulator
    mounts: tuple[Mount, ...]
    initial_free_radius: float
    """Metres."""

    @property
    def world(self) -> FieldWorld:
        """The true world."""
        return self.simulator.world

    @property
    def true_vehicles(self) -> tuple[Vehicle, ...]:
        """The vehicles at their true base poses."""
        return make_vehicles(self.mounts, self.world.base_poses)

    @property
    def true_cameras(self) -> list[Pose]:
        """True T_world_camera of each robot."""
        return [self.simulator.true_camera_pose(k) for k in range(len(self.mounts))]

    @property
    def initial_free_mask(self) -> NDArray[np.bool_]:
        """Voxels, shape of the grid, that are known without a scan once all robots are located."""
        world = self.world
        mask = np.zeros(world.grid.n_cells, dtype=np.bool_)
        mask[initial_free_voxels(world.grid, world.base_poses, self.initial_free_radius)] = True
        return mask.reshape(world.grid.shape)

    def estimated_camera_pose(self, robot: int) -> Pose:
        """T_world_camera by the estimate of a robot.

        For one that is not located: the estimate in its own frame, with that frame at its true
        pose.
        """
        estimated = self.belief.estimates[robot].pose
        if self.belief.located[robot]:
            return estimated
        own = self.belief.vehicles[robot].T_world_base
        return self.world.base_poses[robot] @ own.inverse() @ estimated

    def pose_errors(self, robot: int) -> dict[str, float]:
        """Errors of a robot's estimated camera and base poses, metres and radians.

        Those of the base are infinite until the robot is located.
        """
        true_camera, true_base = self.true_cameras[robot], self.world.base_poses[robot]
        camera = displacement_between(self.estimated_camera_pose(robot), true_camera)
        base = displacement_between(self.belief.vehicles[robot].T_world_base, true_base)
        located = self.belief.located[robot]
        return {
            "camera_error": length(camera[:3]),
            "camera_angle_error": length(camera[3:]),
            "base_error": length(base[:3]) if located else math.inf,
            "base_angle_error": length(base[3:]) if located else math.inf,
        }
