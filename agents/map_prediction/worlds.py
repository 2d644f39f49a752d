"""The worlds of a training of a map network, and the examples of their maps."""

from __future__ import annotations

from contextlib import closing

import numpy as np

from coopmap_agents.map_config import PLAYED_POLICIES, MapTrainingConfig
from coopmap_agents.map_prediction.examples import MapExamples, collect_examples
from coopmap_env import families
from coopmap_env.envs.planar import PlanarEnv
from coopmap_env.evaluation import make_env, make_policy


def make_world(name: str, config: MapTrainingConfig, split: str) -> PlanarEnv:
    """The environment of a family or a scene of a training.

    Raises
    ------
    ValueError
        If the name is unknown, or is not of planar worlds.
    """
    if name in config.scenes:
        env = make_env("planar", {"scene": name, "split": split}, None)
    else:
        env = families.make(name, split)
    if not isinstance(env, PlanarEnv):
        env.close()
        raise ValueError(f"map networks are of planar worlds, and the family {name!r} is not")
    return env


def world_examples(name: str, config: MapTrainingConfig, split: str) -> MapExamples:
    """Examples of a family or a scene; the same for the same configuration."""
    n = config.episodes if split == "train" else config.validation_episodes
    draws = np.random.SeedSequence([config.seed, {"train": 0, "validation": 1}[split]])
    seeds = draws.generate_state(n).tolist()
    with closing(make_world(name, config, split)) as env:
        policies = [make_policy(spec) for spec in PLAYED_POLICIES]
        return collect_examples(env, policies, seeds, config.maps_per_episode)
