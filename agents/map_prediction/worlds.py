"""The worlds of a training of a map network, and the examples of their maps."""

from __future__ import annotations

from contextlib import closing
from typing import Any

import numpy as np

from coopmap_agents.map_config import USUAL_TRAININGS, MapTrainingConfig
from coopmap_agents.map_prediction.examples import MapExamples, collect_examples
from coopmap_env import families
from coopmap_env.envs import MappingEnv
from coopmap_env.evaluation import make_env, make_policy


def make_world(name: str, config: MapTrainingConfig, split: str) -> MappingEnv[Any]:
    """The environment of a family or a scene of a training.

    Raises
    ------
    ValueError
        If the name is unknown, or is not of the environment of the training.
    """
    if name in config.scenes:
        return make_env(config.env_name, {"scene": name, "split": split}, None)
    found = families.get(name).env_name
    if found != config.env_name:
        raise ValueError(
            f"this training is of {config.env_name} worlds, and {name!r} of {found}: choose other "
            "families, or another env_name"
        )
    return families.make(name, split)


def world_examples(name: str, config: MapTrainingConfig, split: str) -> MapExamples:
    """Examples of a family or a scene; the same for the same configuration."""
    n = config.episodes if split == "train" else config.validation_episodes
    draws = np.random.SeedSequence([config.seed, {"train": 0, "validation": 1}[split]])
    seeds = draws.generate_state(n).tolist()
    with closing(make_world(name, config, split)) as env:
        specs = USUAL_TRAININGS[config.env_name].example_policies
        policies = [make_policy(spec) for spec in specs]
        return collect_examples(env, policies, seeds, config.maps_per_episode)
