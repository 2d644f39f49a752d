"""Training on RLlib, and so on Ray; needs the extra ``ray``.

RLlib's own ``ParallelPettingZooEnv`` runs the environments with the connector
``FlattenObservations(multi_agent=True)``; without it, RLlib has "no default encoder config" for a
dict. It takes masked candidates, and forgets that robots are cut off and not at an end: train with
`RLlibTrainer`, or with the `make_config` that it uses.
"""

import coopmap_agents._require_ray  # noqa: F401
from coopmap_agents.rllib.env import RLlibRows
from coopmap_agents.rllib.network import SharedNetworkModule
from coopmap_agents.rllib.ppo import RLlibTrainer, make_config

__all__ = ["RLlibRows", "RLlibTrainer", "SharedNetworkModule", "make_config"]
