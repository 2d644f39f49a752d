"""Training on Stable-Baselines3: a vectorised environment of teams, and PPO."""

import coopmap_agents._require_rl  # noqa: F401
from coopmap_agents.sb3.ppo import SB3Trainer, make_model, train
from coopmap_agents.sb3.vec_env import SharedPolicyVecEnv

__all__ = ["SB3Trainer", "SharedPolicyVecEnv", "make_model", "train"]
