"""Small networks and their files, made without an environment."""

import json

import numpy as np
import torch
from gymnasium import spaces
from safetensors.torch import load_file, save

from coopmap_agents.config import PPOSettings
from coopmap_agents.networks import make_network
from coopmap_agents.pretrained import save_policy
from coopmap_agents.pretrained.metadata import METADATA_KEY

SETTINGS = PPOSettings(hidden=(16, 8), image_features=8)
CANDIDATES, POSES = spaces.Discrete(6), spaces.Box(-1, 1, (3,), np.float32)


def observation_space(with_candidates):
    parts = {
        "map": spaces.Box(0, 255, (4, 8, 8), np.uint8),
        "pose": spaces.Box(-1, 1, (4,), np.float32),
        "teammates": spaces.Box(-1, 1, (1, 4), np.float32),
    }
    if with_candidates:
        parts["candidates"] = spaces.Box(-1, 1, (6, 9), np.float32)
        parts["action_mask"] = spaces.Box(0, 1, (6,), np.int8)
    return spaces.Dict(parts)


def tiny_network(actions=CANDIDATES, settings=SETTINGS, seed=0):
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        return make_network(observation_space(actions is CANDIDATES), actions, settings)


def tiny_policy_file(folder, actions=CANDIDATES):
    path = folder / "policy.safetensors"
    save_policy(tiny_network(actions), SETTINGS, path, {"steps": 64})
    return path


def metadata_of(path):
    content = path.read_bytes()
    header = json.loads(content[8 : 8 + int.from_bytes(content[:8], "little")])
    return json.loads(header["__metadata__"][METADATA_KEY])


def rewrite(path, metadata=None, **weights):
    """Write a policy's file again, with other metadata and other weights."""
    metadata = metadata_of(path) if metadata is None else metadata
    content = save({**load_file(path), **weights}, {METADATA_KEY: json.dumps(metadata)})
    path.write_bytes(content)
