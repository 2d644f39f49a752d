"""Networks: features of an observation, a policy among candidates, a policy among poses.

A network is a policy object of Stable-Baselines3, with actor and critic. Both engines train it.
"""

import coopmap_agents._require_rl  # noqa: F401
from coopmap_agents.networks.candidate_scorer import CandidateScorer
from coopmap_agents.networks.factory import (
    actor_parameters,
    copy_weights,
    is_of_actor,
    make_network,
    network_class,
    parameter_shapes,
    set_actor_trainable,
)
from coopmap_agents.networks.features import ObservationFeatures
from coopmap_agents.networks.pose_policy import PosePolicy
from coopmap_agents.observations import stack

__all__ = [
    "CandidateScorer",
    "ObservationFeatures",
    "PosePolicy",
    "actor_parameters",
    "copy_weights",
    "is_of_actor",
    "make_network",
    "network_class",
    "parameter_shapes",
    "set_actor_trainable",
    "stack",
]
