"""The planar world: cameras that stand and turn on a plane."""

from coopmap_env.envs.planar.arguments import PlanarArguments
from coopmap_env.envs.planar.env import PlanarEnv, PlanarTeamEnv
from coopmap_env.envs.planar.settings import PlanarSettings

__all__ = ["PlanarArguments", "PlanarEnv", "PlanarSettings", "PlanarTeamEnv"]
