"""The team in the field as one Gymnasium agent."""

from coopmap_env.envs.field.env import FieldEnv
from coopmap_env.envs.team import TeamEnv


class FieldTeamEnv(TeamEnv):
    """`FieldEnv` seen by a single agent; see `TeamEnv`."""

    metadata = FieldEnv.metadata
    parallel_env = FieldEnv
