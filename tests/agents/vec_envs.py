"""Vector environments of Stable-Baselines3 from factories of parallel environments."""

from coopmap_agents.sb3 import SharedPolicyVecEnv
from coopmap_agents.trainer import make_rows


def shared(env_factory, n_envs, workers=0, with_state=False):
    return SharedPolicyVecEnv(make_rows(env_factory, n_envs, workers, with_state))
