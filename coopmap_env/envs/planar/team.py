"""The planar team as one Gymnasium agent."""

from coopmap_env.envs.planar.env import PlanarEnv
from coopmap_env.envs.team import TeamEnv


class PlanarTeamEnv(TeamEnv):
    """`PlanarEnv` seen by a single agent; see `TeamEnv`."""

    metadata = PlanarEnv.metadata
    parallel_env = PlanarEnv
