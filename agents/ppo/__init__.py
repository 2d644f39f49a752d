"""PPO without a library: one loop over a vector environment, for speed."""

import coopmap_agents._require_rl  # noqa: F401
from coopmap_agents.ppo.advantages import generalized_advantages
from coopmap_agents.ppo.rollout import Rollout
from coopmap_agents.ppo.trainer import PPOTrainer, train_network

__all__ = ["PPOTrainer", "Rollout", "generalized_advantages", "train_network"]
