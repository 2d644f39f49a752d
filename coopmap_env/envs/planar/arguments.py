"""Arguments of the planar environment."""

from __future__ import annotations

import os
from dataclasses import dataclass

from coopmap_env.envs.arguments import MappingArguments
from coopmap_env.envs.planar.settings import PlanarSettings
from coopmap_env.simulation.scenes.planar import PlanarScene


@dataclass(frozen=True)
class PlanarArguments(MappingArguments):
    """Arguments of `PlanarEnv`."""

    scene: str | os.PathLike[str] | PlanarScene = "obstacles"
    """"obstacles", "rooms", "house", a ROS map_server YAML file, or an object."""
    settings: PlanarSettings | None = None
    """Camera, noise, map, rating function and reach; default: `PlanarSettings.for_resolution` of
    the scene."""
