"""Trained policies: as files, as policies of the evaluation, and those that ship with coopmap.

What reads and writes networks of torch is loaded on first use: without torch, policies act from
their ONNX files.
"""

from typing import TYPE_CHECKING

from coopmap_agents.pretrained.learned_policy import LearnedPolicy
from coopmap_agents.pretrained.library import pretrained_names, pretrained_path, pretrained_record
from coopmap_agents.pretrained.metadata import PolicyMetadata
from coopmap_env.core.lazy import load_on_first_use

if TYPE_CHECKING:
    from coopmap_agents.pretrained.policy_file import (
        convert_policy,
        load_policy,
        read_metadata,
        save_policy,
    )
    from coopmap_agents.pretrained.torch_network import resolve_network
else:
    __getattr__ = load_on_first_use(__name__)

__all__ = [
    "LearnedPolicy",
    "PolicyMetadata",
    "convert_policy",
    "load_policy",
    "pretrained_names",
    "pretrained_path",
    "pretrained_record",
    "read_metadata",
    "resolve_network",
    "save_policy",
]
