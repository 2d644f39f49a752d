"""Training on RLlib, and so on Ray; needs the extra ``ray``."""

import coopmap_agents._require_ray  # noqa: F401
from coopmap_agents.rllib.env import RLlibRows
from coopmap_agents.rllib.network import SharedNetworkModule
from coopmap_agents.rllib.ppo import RLlibTrainer, make_config

__all__ = ["RLlibRows", "RLlibTrainer", "SharedNetworkModule", "make_config"]
