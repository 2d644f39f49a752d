"""The field world: camera mounts on stationary vehicles map a worksite in 3-D."""

from coopmap_env.envs.field.arguments import FieldArguments
from coopmap_env.envs.field.env import FieldEnv, FieldTeamEnv
from coopmap_env.envs.field.settings import FieldSettings

__all__ = ["FieldArguments", "FieldEnv", "FieldSettings", "FieldTeamEnv"]
