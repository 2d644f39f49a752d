"""The team in the field as one Gymnasium agent."""

from coopmap_env.envs.field.env import FieldEnv
from coopmap_env.envs.team import TeamEnv


class FieldTeamEnv(TeamEnv):
    """`FieldEnv` seen by a single agent; see `TeamEnv`.

    Stable-Baselines3 takes the smallest side of an image for its channels. With two robots and
    more, the layers of all maps together are more than the sides: give it the parallel environment
    through `coopmap_agents.sb3.vec_env.SharedPolicyVecEnv`, or a smaller `crop_cells[1]`.
    """

    metadata = FieldEnv.metadata
    parallel_env = FieldEnv
