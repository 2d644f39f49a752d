"""Trained policies: as files, as policies of the evaluation, and those that ship with coopmap.

What reads and writes networks of torch is loaded on first use: without torch, policies act from
their ONNX files.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from coopmap_agents.pretrained.learned_policy import LearnedPolicy
from coopmap_agents.pretrained.library import pretrained_names, pretrained_path, pretrained_record
from coopmap_agents.pretrained.metadata import PolicyMetadata

if TYPE_CHECKING:
    from coopmap_agents.pretrained.policy_file import (
        convert_policy,
        load_policy,
        read_metadata,
        save_policy,
    )
    from coopmap_agents.pretrained.torch_network import resolve_network

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


def __getattr__(name: str) -> Any:
    if name in ("convert_policy", "load_policy", "read_metadata", "save_policy"):
        return getattr(import_module("coopmap_agents.pretrained.policy_file"), name)
    if name == "resolve_network":
        return import_module("coopmap_agents.pretrained.torch_network").resolve_network
    raise AttributeError(f"module 'coopmap_agents.pretrained' has no attribute {name!r}")
