"""Policies as files, as safetensors or ONNX: see `coopmap_agents.model_files`.

The metadata say how to make the network (actions, observations, settings) and how it was trained.
The weights are those of the actor, without the critic.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import coopmap_agents._require_rl  # noqa: F401

# isort: split
import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.policies import ActorCriticPolicy

from coopmap_agents.config import PPOSettings
from coopmap_agents.model_files import read_model, write_model
from coopmap_agents.networks import actor_parameters, is_of_actor, make_network, parameter_shapes
from coopmap_agents.pretrained.metadata import PolicyMetadata
from coopmap_agents.pretrained.onnx.file_kind import POLICIES
from coopmap_agents.weights import check_shapes, check_values
from coopmap_env.core.files import FileError


def save_policy(
    network: ActorCriticPolicy,
    settings: PPOSettings,
    path: str | os.PathLike[str],
    training: Mapping[str, Any] | None = None,
) -> None:
    """Write the actor of a network to a file, atomically.

    Parameters
    ----------
    network : ActorCriticPolicy
        From `make_network`, or the ``policy`` of a trained model.
    settings : PPOSettings
        Settings of the network.
    path : path
        Ends in ``.safetensors`` or in ``.onnx``.
    training : mapping, optional
        JSON values, the origin of the weights.

    Raises
    ------
    ValueError
        If the path has another suffix, the network was made with other settings, or a weight is
        not finite.
    """
    target = Path(path)
    metadata = _metadata_of(network, settings, training or {})
    weights = {
        name: values.detach().cpu().contiguous().numpy()
        for name, values in actor_parameters(network).items()
    }
    try:
        check_shapes(weights, _actor_shapes(metadata))
    except ValueError as error:
        raise ValueError(f"the network was made with other settings, {target}: {error}") from error
    try:
        check_values(weights)
    except ValueError as error:
        raise ValueError(f"{target} cannot be written: {error}") from error
    write_model(target, POLICIES, metadata, weights)


def convert_policy(source: str | os.PathLike[str], target: str | os.PathLike[str]) -> None:
    """Write the policy of a file in the format of another suffix, with the same metadata.

    Raises
    ------
    FileError
        As `load_policy`.
    ValueError
        If the target has another suffix than those of `save_policy`, or an entry of the
        observations a name that ONNX files cannot have.
    """
    load_policy(source)
    write_model(target, POLICIES, *read_model(source, POLICIES))


def read_metadata(path: str | os.PathLike[str]) -> PolicyMetadata:
    """Read the metadata of a policy's file.

    Raises
    ------
    FileError
        If it is not a policy's file, or one of another format.
    """
    return read_model(path, POLICIES)[0]


def load_policy(path: str | os.PathLike[str]) -> ActorCriticPolicy:
    """Read a network from a file of `save_policy`; its critic is untrained.

    Raises
    ------
    FileError
        As `read_metadata`, or if the weights do not belong to the network of the metadata, or are
        not finite.
    """
    metadata, weights = read_model(path, POLICIES)
    try:
        check_shapes(weights, _actor_shapes(metadata))
        check_values(weights)
        with torch.random.fork_rng(devices=[]):  # keeps the state of the global generator
            network = make_network(*metadata.spaces(), metadata.settings())
    except Exception as error:  # torch raises many types of exceptions for odd shapes
        raise FileError(f"{path}: {error}") from error
    for name, values in actor_parameters(network).items():
        values.data.copy_(torch.from_numpy(weights[name].copy()))
    network.set_training_mode(False)
    return network


def _metadata_of(
    network: ActorCriticPolicy, settings: PPOSettings, training: Mapping[str, Any]
) -> PolicyMetadata:
    observation_space, actions = network.observation_space, network.action_space
    assert isinstance(observation_space, spaces.Dict)
    is_discrete = isinstance(actions, spaces.Discrete)
    return PolicyMetadata(
        {
            key: [np.dtype(space.dtype).name, *(space.shape or ())]
            for key, space in observation_space.spaces.items()
            if key != "state"
        },
        int(actions.n) if isinstance(actions, spaces.Discrete) else None,
        None if is_discrete else int(np.prod(actions.shape or ())),
        asdict(settings),
        training,
    )


def _actor_shapes(metadata: PolicyMetadata) -> dict[str, tuple[int, ...]]:
    """Shapes of the actor's weights by name, before the network is made."""
    shapes = parameter_shapes(*metadata.spaces(), metadata.settings())
    return {name: shape for name, shape in shapes.items() if is_of_actor(name)}
