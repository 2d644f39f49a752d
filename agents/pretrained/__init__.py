"""Trained policies: as files, as policies of the evaluation, and those that ship with coopmap."""

import coopmap_agents._require_rl  # noqa: F401
from coopmap_agents.pretrained.learned_policy import LearnedPolicy, resolve_network
from coopmap_agents.pretrained.library import pretrained_names, pretrained_path, pretrained_record
from coopmap_agents.pretrained.metadata import PolicyMetadata
from coopmap_agents.pretrained.policy_file import load_policy, read_metadata, save_policy

__all__ = [
    "LearnedPolicy",
    "PolicyMetadata",
    "load_policy",
    "pretrained_names",
    "pretrained_path",
    "pretrained_record",
    "read_metadata",
    "resolve_network",
    "save_policy",
]
