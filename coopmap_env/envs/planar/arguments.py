"""Arguments of the planar environment."""

from __future__ import annotations

import os
from dataclasses import dataclass

from coopmap_env.envs.arguments import MappingArguments
from coopmap_env.envs.planar.settings import PlanarSettings
from coopmap_env.envs.planar.task import PlanarTask
from coopmap_env.mapping import VoxelGrid
from coopmap_env.simulation.scenes.planar import PlanarScene


@dataclass(frozen=True)
class PlanarArguments(MappingArguments):
    """Arguments of `PlanarEnv`."""

    scene: str | os.PathLike[str] | PlanarScene = "obstacles"
    """"obstacles", "rooms", "corridors", "house", a ROS map_server YAML file, or an object."""
    settings: PlanarSettings | None = None
    """Camera, noise, map, rating function and reach; default: `PlanarSettings.for_resolution` of
    the scene."""

    def task(self, grid: VoxelGrid, settings: PlanarSettings) -> PlanarTask:
        """The task of a team on the grid of the scene, with settings that are not None."""
        return PlanarTask(
            grid,
            settings,
            self.n_robots,
            self.n_candidates if self.action_mode == "candidates" else 0,
            self.reward,
            self.team_reward == "shared",
            self.keeps_shown,
        )
