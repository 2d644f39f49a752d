"""Policies in files: weights by name and a page of JSON, in safetensors' format; no code inside.

The page says how to make the network (kind of actions, what is observed, its settings) and where it
comes from. The file holds what acting needs: without the critic.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from coopmap_agents import RL_EXTRA_HINT
from gymnasium import spaces

from coopmap_env.core.files import atomic_path
from coopmap_env.core.serial import settings_from_dict
from coopmap_env.core.version import __version__

try:
    import torch
    from safetensors import SafetensorError, safe_open
    from safetensors.torch import save_file
    from stable_baselines3.common.policies import ActorCriticPolicy
except ImportError as error:
    raise ImportError(RL_EXTRA_HINT) from error

from coopmap_agents.networks.networks import actor_parameters, make_network
from coopmap_agents.settings import PPOSettings

FORMAT = 1
"""Raised when the networks, or what the environments' observations mean, change: older files then
cannot be read any more."""
METADATA_KEY = "coopmap"
"""Key of the JSON among the file's metadata."""


@dataclass(frozen=True)
class PolicyMetadata:
    """What a policy's file says about itself."""

    observations: Mapping[str, Any]
    """Shape and type of each entry that the network sees, such as ["float32", 4]."""
    n_candidates: int | None
    """m in training, in "candidates" mode."""
    action_size: int | None
    """Length of an action, in "pose" mode."""
    ppo: Mapping[str, Any]
    """`PPOSettings` of the training."""
    training: Mapping[str, Any] = field(default_factory=dict)
    """EnvConfig, seed and steps; whatever the training says."""
    version: str = __version__
    format: int = FORMAT

    @classmethod
    def from_network(
        cls, network: ActorCriticPolicy, settings: PPOSettings, training: Mapping[str, Any]
    ) -> PolicyMetadata:
        """What is to be said of a network."""
        observation_space, actions = network.observation_space, network.action_space
        assert isinstance(observation_space, spaces.Dict)
        discrete = isinstance(actions, spaces.Discrete)
        return cls(
            {
                key: [np.dtype(space.dtype).name, *(space.shape or ())]
                for key, space in observation_space.spaces.items()
                if key != "state"
            },
            int(actions.n) if isinstance(actions, spaces.Discrete) else None,
            None if discrete else int(np.prod(actions.shape or ())),
            asdict(settings),
            training,
        )

    def make(self) -> ActorCriticPolicy:
        """The network with the weights that chance gives it, and a critic of its own."""
        actions: spaces.Space[Any]
        if self.n_candidates is not None:
            actions = spaces.Discrete(self.n_candidates)
        else:
            actions = spaces.Box(-1.0, 1.0, (self.action_size or 0,), np.float32)
        boxes: dict[str, spaces.Space[Any]] = {
            key: _box(*entry) for key, entry in self.observations.items()
        }
        settings = settings_from_dict({**self.ppo, "critic": "local", "device": "cpu"}, PPOSettings)
        return make_network(spaces.Dict(boxes), actions, settings)


def save_policy(
    network: ActorCriticPolicy,
    settings: PPOSettings,
    path: str | os.PathLike[str],
    training: Mapping[str, Any] | None = None,
) -> None:
    """Write what acting needs of a network; the file is there whole or not at all.

    Parameters
    ----------
    network : ActorCriticPolicy
        Of `make_network`, or the ``policy`` of a model that was trained.
    settings : PPOSettings
        Those it was made with.
    path : path
        Ends in ``.safetensors``.
    trained : mapping, optional
        JSON values that say where it comes from.

    Raises
    ------
    ValueError
        If the path has another ending, or the network was made with other settings.
    """
    target = Path(path)
    if target.suffix != ".safetensors":
        raise ValueError(f"a policy's file ends in .safetensors, got {target}")
    metadata = PolicyMetadata.from_network(network, settings, training or {})
    weights = {
        name: values.detach().cpu().contiguous()
        for name, values in actor_parameters(network).items()
    }
    _check_shapes(
        weights, _untrained_network(metadata), f"the network is not one of these settings, {target}"
    )
    target.parent.mkdir(parents=True, exist_ok=True)
    with atomic_path(target) as temporary:
        save_file(weights, temporary, {METADATA_KEY: json.dumps(asdict(metadata))})
        temporary.chmod(0o644)  # the library's own mode would lock out everybody else


def read_metadata(path: str | os.PathLike[str]) -> PolicyMetadata:
    """What a policy's file says about itself, without its weights.

    Raises
    ------
    ValueError
        If it is no policy's file, or one of another format.
    """
    try:
        with safe_open(path, "pt") as file:
            values = json.loads((file.metadata() or {})[METADATA_KEY])
        if values["format"] == FORMAT:
            return PolicyMetadata(**values)
    except (SafetensorError, json.JSONDecodeError, KeyError, TypeError) as error:
        raise ValueError(
            f"{path} is no policy that `coopmap train` or `save_policy` wrote: {error}"
        ) from error
    raise ValueError(
        f"{path} was written by coopmap {values.get('version')} in format {values['format']}, "
        f"this is {__version__} and reads format {FORMAT}: train the policy anew, or "
        "install the version that wrote it"
    )


def load_policy(path: str | os.PathLike[str]) -> ActorCriticPolicy:
    """Read a network that `save_policy` wrote; its critic has learned nothing.

    Raises
    ------
    ValueError
        As `read_metadata`, or if the weights are not those of the network that the page tells of.
    """
    network = _untrained_network(read_metadata(path))
    with safe_open(path, "pt") as file:
        weights = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118  # no mapping
    _check_shapes(weights, network, f"{path} does not hold the weights that it tells of")
    for name, values in actor_parameters(network).items():
        values.data.copy_(weights[name])
    network.set_training_mode(False)
    return network


def _untrained_network(metadata: PolicyMetadata) -> ActorCriticPolicy:
    with torch.random.fork_rng(devices=[]):  # leaves no trace in what is drawn later
        return metadata.make()


def _check_shapes(
    weights: Mapping[str, torch.Tensor], network: ActorCriticPolicy, what: str
) -> None:
    own, needed = (
        {name: tuple(values.shape) for name, values in part.items()}
        for part in (weights, actor_parameters(network))
    )
    if own != needed:
        other = min(name for name in own | needed if own.get(name) != needed.get(name))
        raise ValueError(f"{what}: {other} has the shape {own.get(other)}, not {needed.get(other)}")


def _box(dtype: str, *shape: int) -> spaces.Box:
    low, high = (0, 255) if dtype == "uint8" else (-1, 1)
    return spaces.Box(low, high, shape, np.dtype(dtype).type)
