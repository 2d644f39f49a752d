"""Training: the loop over segments with its files, and imitation of a planner."""

import coopmap_agents._require_rl  # noqa: F401
from coopmap_agents.training.checkpoints import load_checkpoint, save_checkpoint
from coopmap_agents.training.imitation import ImitationReport, behavior_clone
from coopmap_agents.training.loop import run_training

__all__ = [
    "ImitationReport",
    "behavior_clone",
    "load_checkpoint",
    "run_training",
    "save_checkpoint",
]
