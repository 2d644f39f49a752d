"""The planar world: cameras that stand and turn on a plane."""

from coopmap_env.envs.planar.env import PlanarEnv
from coopmap_env.envs.planar.settings import PlanarSettings
from coopmap_env.envs.planar.team import PlanarTeamEnv

__all__ = ["PlanarEnv", "PlanarSettings", "PlanarTeamEnv"]
